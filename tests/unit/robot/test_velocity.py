"""Velocity: a Twist as a value."""

import math

import pytest

from hostlink.errors import BadPayload
from hostlink.robot.velocity import TWIST_TYPE, ZERO, Velocity
from tests.support.fake_device import CATALOG

TWIST = {"linear": {"x": 1.0, "y": 2.0, "z": 2.0}, "angular": {"x": 2.0, "y": 3.0, "z": 6.0}}
VELOCITY = Velocity(1.0, 2.0, 2.0, 2.0, 3.0, 6.0)


def test_it_is_a_twist_and_back() -> None:
    type_ = CATALOG.message(TWIST_TYPE)
    assert type_ is not None
    assert Velocity.from_twist(TWIST) == VELOCITY
    assert VELOCITY.encode() == type_.encode(TWIST)
    assert Velocity.decode(type_.encode(TWIST)) == VELOCITY


@pytest.mark.parametrize("size", [0, 47, 49])
def test_bytes_of_another_length_are_no_twist(size: int) -> None:
    with pytest.raises(BadPayload, match=f"{size} bytes instead of 48"):
        Velocity.decode(bytes(size))


def test_speeds_are_of_all_axes() -> None:
    assert (VELOCITY.linear_m_s, VELOCITY.angular_rad_s) == (3.0, 7.0)


@pytest.mark.parametrize("axis", range(6))
def test_one_axis_is_enough_to_move_or_to_be_no_number(axis: int) -> None:
    assert not Velocity(*(0.1 * (number == axis) for number in range(6))).is_zero
    for wrong in (math.nan, math.inf, -math.inf):
        assert not Velocity(*(wrong if number == axis else 0.0 for number in range(6))).is_finite


def test_zero_is_zero_with_either_sign() -> None:
    assert ZERO.is_zero
    assert Velocity(-0.0, angular_z_rad_s=-0.0).is_zero
    assert ZERO.is_finite


def test_the_way_between_two_velocities_is_straight() -> None:
    assert ZERO.toward(VELOCITY, 0.5) == VELOCITY.scaled(0.5)
    assert VELOCITY.toward(ZERO, 1.0) == ZERO
    assert VELOCITY.toward(ZERO, 0.0) == VELOCITY


def test_there_is_a_way_between_the_largest_numbers() -> None:
    huge = Velocity(1e308, -1e308)
    assert huge.toward(huge.scaled(-1), 0.5) == ZERO
