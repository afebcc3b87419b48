"""Velocities that wait: the newest, and the newest zero before it, matter."""

import math

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.newest import is_zero_twist, newest
from hostlink.core.robot.velocity import Twist


@given(waiting=st.lists(st.tuples(st.integers(), st.booleans()), max_size=12))
def test_newest_zero_and_newest_velocity_stay_in_their_order(waiting: list[tuple[int, bool]]) -> None:
    kept = newest(waiting, lambda each: each[1])
    assert kept[-1:] == waiting[-1:]
    assert len(kept) <= 2
    assert any(zero for _, zero in kept) == any(zero for _, zero in waiting)
    places = [place for place, (_, is_zero) in enumerate(waiting) if is_zero]
    if places and places[-1] != len(waiting) - 1:
        assert kept == [waiting[places[-1]], waiting[-1]]


@given(waiting=st.lists(st.booleans(), max_size=12))
def test_one_by_one_as_all_at_once(waiting: list[bool]) -> None:
    numbered, kept = list(enumerate(waiting)), list[tuple[int, bool]]()
    for each in numbered:
        kept = newest([*kept, each], lambda one: one[1])
    assert kept == newest(numbered, lambda one: one[1]) or [z for _, z in kept] == [True, True]


def test_zero_of_a_payload_is_that_of_the_twist_at_its_end() -> None:
    assert is_zero_twist(Twist().encode())
    assert is_zero_twist(b"\x00\x01\x00\x00" + Twist(-0.0).encode())  # of ROS 2
    assert not is_zero_twist(Twist(angular_z_rad_s=0.1).encode())
    assert not is_zero_twist(Twist(math.nan).encode())
    assert not is_zero_twist(bytes(47))
