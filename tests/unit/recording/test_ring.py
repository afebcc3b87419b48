"""What is kept of robots: the newest, within the time and the room."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.recording.channel import EVENTS
from hostlink.recording.ring import ENTRY_BYTES, MOST_AT_ONCE, Entry, Rings

SECOND_NS = 1_000_000_000
KEEP_S = 10.0


def entry(at_s: float, size_bytes: int = 0) -> Entry:
    return Entry(EVENTS, int(at_s * SECOND_NS), bytes(size_bytes), at_s)


def kept_of(rings: Rings, robot: str) -> list[Entry]:
    return list(itertools.chain(*rings.copies(robot)))


def test_what_is_older_than_the_time_goes() -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=10**6)
    for second in range(30):
        rings.add("robot_0", *entry(second))
    assert [each.stamp_ns // SECOND_NS for each in kept_of(rings, "robot_0")] == list(range(19, 30))
    assert rings.dropped == 0


def test_a_robot_has_what_is_nobodys_too_and_nothing_of_another() -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=10**6)
    for robot in ("robot_0", "robot_1", ""):
        rings.add(robot, *entry(1.0, len(robot)))
    assert [len(each.payload) for each in kept_of(rings, "robot_0")] == [7, 0]
    assert [len(each.payload) for each in kept_of(rings, "")] == [0]
    rings.forget("robot_0")
    assert [len(each.payload) for each in kept_of(rings, "robot_0")] == [0]


def test_a_robot_that_floods_leaves_the_others_their_part() -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=100 * (ENTRY_BYTES + 100))
    for number in range(10):
        rings.add("quiet", *entry(number / 10, 100))
    for number in range(10_000):
        rings.add("loud", *entry(1 + number / 10_000, 100))
    assert len(kept_of(rings, "quiet")) == 10
    assert len(kept_of(rings, "loud")) == 50
    assert rings.dropped == 10_000 - 50


@given(st.lists(st.tuples(st.sampled_from(("a", "b", "")), st.floats(0, 100), st.integers(0, 5000)), max_size=200))
def test_the_room_is_never_exceeded_and_the_newest_stays_if_it_fits(drawn: list[tuple[str, float, int]]) -> None:
    max_bytes = 30_000
    rings = Rings(keep_s=KEEP_S, max_bytes=max_bytes)
    for robot, at_s, size_bytes in drawn:
        newest = entry(at_s, size_bytes)
        rings.add(robot, *newest)
        assert newest in kept_of(rings, robot) or newest.at_s < max(each.at_s for each in kept_of(rings, robot))
    for robot in {robot for robot, _, _ in drawn}:
        rings.add(robot, *entry(200.0))
    assert rings.size_bytes <= max_bytes


@pytest.mark.parametrize("jump_s", [-1000, 1000])
def test_a_clock_that_is_set_loses_nothing_that_is_new_and_keeps_nothing_that_is_old(jump_s: int) -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=10**6)
    stamps_s = [2000 + second + (second >= 15) * jump_s for second in range(20)]
    for second, stamp_s in enumerate(stamps_s):
        rings.add("robot_0", *Entry(EVENTS, stamp_s * SECOND_NS, b"", second))
    assert [each.stamp_ns // SECOND_NS for each in kept_of(rings, "robot_0")] == stamps_s[9:]


def test_a_message_that_is_larger_than_the_room_is_not_kept() -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=1000)
    rings.add("robot_0", *entry(1.0, 2000))
    assert (kept_of(rings, "robot_0"), rings.size_bytes, rings.dropped) == ([], 0, 1)


def test_robots_that_come_make_the_room_of_another_less_piece_by_piece() -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=10_000 * ENTRY_BYTES)
    for number in range(10_000):
        rings.add("loud", *entry(number / 10_000))
    for number in range(9):
        rings.add(f"robot_{number}", *entry(1.0))
    dropped, kept = [], len(kept_of(rings, "loud"))
    for number in range(9_000 // (MOST_AT_ONCE - 1) + 1):
        rings.add("loud", *entry(1.0 + number / 10_000))
        dropped.append(kept + 1 - len(kept_of(rings, "loud")))
        kept = len(kept_of(rings, "loud"))
    assert max(dropped) == MOST_AT_ONCE
    assert kept == 1000


def test_a_copy_for_another_thread_is_not_changed_by_what_comes() -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=10**6)
    rings.add("robot_0", *entry(1.0))
    (copy,) = rings.copies("robot_0")
    rings.add("robot_0", *entry(2.0))
    assert list(copy) == [entry(1.0)]


def test_names_that_nobody_uses_any_more_leave_the_room_to_the_others() -> None:
    """A name may be that of a topic, or of a robot that was forgotten a moment before its last line."""
    rings = Rings(keep_s=KEEP_S, max_bytes=1000 * (ENTRY_BYTES + 100))
    for number in range(1000):
        rings.add(f"name {number}", *entry(number / 100, 100))
    for number in range(400):
        rings.add("robot_0", *entry(30 + number / 100, 100))
    assert len(kept_of(rings, "robot_0")) == 400
    assert rings.size_bytes == 400 * (ENTRY_BYTES + 100)


def test_a_message_that_is_larger_than_the_room_leaves_nothing_behind() -> None:
    rings = Rings(keep_s=KEEP_S, max_bytes=1000)
    rings.add("robot_0", *entry(1.0, 5000))
    rings.add("robot_1", *entry(2.0))
    assert [len(kept_of(rings, robot)) for robot in ("robot_0", "robot_1")] == [0, 1]
