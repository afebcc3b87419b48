"""PlanarVelocity, and the six numbers of a Twist."""

import math

import pytest

from hostlink.core.robot.velocity import TWIST_TYPE, ZERO, PlanarVelocity, Twist
from hostlink.errors import BadPayload
from tests.support.fake_device import message_type

FIELDS = {"linear": {"x": 1.0, "y": 2.0, "z": 2.0}, "angular": {"x": 2.0, "y": 3.0, "z": 6.0}}
TWIST = Twist(1.0, 2.0, 2.0, 2.0, 3.0, 6.0)
VELOCITY = PlanarVelocity(3.0, 4.0, -0.5)


def test_twist_has_the_fields_and_the_bytes_of_the_message() -> None:
    type_ = message_type(TWIST_TYPE)
    assert Twist.from_fields(FIELDS) == TWIST
    assert TWIST.encode() == type_.encode(FIELDS)
    assert Twist.decode(type_.encode(FIELDS)) == TWIST


@pytest.mark.parametrize("size", [0, 47, 49])
def test_twist_of_another_length_is_refused(size: int) -> None:
    with pytest.raises(BadPayload, match=f"{size} bytes instead of 48"):
        Twist.decode(bytes(size))


def test_planar_velocity_is_encoded_as_a_twist() -> None:
    assert Twist.decode(VELOCITY.encode()) == VELOCITY.twist == Twist(3.0, 4.0, 0.0, 0.0, 0.0, -0.5)
    assert VELOCITY.twist.planar == VELOCITY


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("value", [0.1, math.nan])
def test_twist_is_planar_unless_z_roll_or_pitch_is_not_zero(axis: int, value: float) -> None:
    twist = Twist(*(value if number == axis else 0.0 for number in range(6)))
    assert twist.is_planar is (axis in (0, 1, 5))


def test_speed_is_the_length_of_the_linear_components() -> None:
    assert (VELOCITY.speed_m_s, VELOCITY.turn_rad_s) == (5.0, 0.5)
    assert (TWIST.speed_m_s, TWIST.turn_rad_s) == (3.0, 7.0)


@pytest.mark.parametrize("kind", [PlanarVelocity, Twist])
def test_one_component_is_enough_to_move_or_to_be_no_number(kind: type[PlanarVelocity | Twist]) -> None:
    for name in kind._fields:
        assert not kind(**{name: 0.1}).is_zero
        for wrong in (math.nan, math.inf, -math.inf):
            assert not kind(**{name: wrong}).is_finite


@pytest.mark.parametrize("kind", [PlanarVelocity, Twist])
def test_zero_is_zero_with_either_sign(kind: type[PlanarVelocity | Twist]) -> None:
    assert kind().is_zero
    assert kind(*(-0.0 for _ in kind._fields)).is_zero
    assert kind().is_finite


def test_the_way_between_two_velocities_is_straight() -> None:
    assert ZERO.toward(VELOCITY, 0.5) == VELOCITY.scaled(0.5)
    assert VELOCITY.toward(ZERO, 1.0) == ZERO
    assert VELOCITY.toward(ZERO, 0.0) == VELOCITY


def test_there_is_a_way_between_the_largest_numbers() -> None:
    huge = PlanarVelocity(1e308, -1e308)
    assert huge.toward(huge.scaled(-1), 0.5) == ZERO
