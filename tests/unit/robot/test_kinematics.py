"""Angles and arcs at their edges; everything drawn is in tests/property/test_kinematics.py."""

import math

import pytest

from hostlink.robot.kinematics import DifferentialDrive, wrap_angle


@pytest.mark.parametrize(
    ("angle_rad", "wrapped_rad"), [(0.0, 0.0), (math.pi, math.pi), (-math.pi, math.pi), (2.5 * math.pi, math.pi / 2)]
)
def test_an_angle_is_wrapped_into_one_turn(angle_rad: float, wrapped_rad: float) -> None:
    assert wrap_angle(angle_rad) == pytest.approx(wrapped_rad)


@pytest.mark.parametrize("angle_rad", [math.inf, -math.inf, math.nan])
def test_an_angle_that_is_not_finite_is_nan(angle_rad: float) -> None:
    assert math.isnan(wrap_angle(angle_rad))


def test_the_defaults_are_the_papers_wheels() -> None:
    drive = DifferentialDrive()
    assert drive.metres_per_tick * drive.ticks_per_turn == pytest.approx(2 * math.pi * 0.045)
    assert drive.wheel_speeds(0.25, 0.8) == pytest.approx((0.25 - 0.8 * 0.105, 0.25 + 0.8 * 0.105))
