"""Angles, arcs and drives at their edges; everything drawn is in tests/property/test_kinematics.py."""

import dataclasses
import math
from typing import Any

import pytest

from hostlink.core.robot.kinematics import (
    DRIVES,
    PLANAR,
    SETTINGS,
    AckermannDrive,
    DifferentialDrive,
    Drive,
    MecanumDrive,
    Omni4Drive,
    OmniDrive,
    PlanarDrive,
    Pose,
    SkidSteerDrive,
    Steering,
    drive_of,
    wrap_angle,
)
from hostlink.core.robot.velocity import Kinematics, PlanarVelocity
from hostlink.errors import ConfigError

DIAGONAL = math.sqrt(0.5)
CAR = AckermannDrive(wheelbase_m=0.5, max_steering_rad=math.atan(0.5), wheel_separation_m=0.4)  # a curve of 1 m at most
KNOWN: tuple[Drive, ...] = (
    DifferentialDrive(),
    SkidSteerDrive(wheel_separation_m=0.4, separation_factor=1.5),
    MecanumDrive(wheel_separation_m=0.4, wheelbase_m=0.2),
    OmniDrive(wheel_distance_m=0.2),
    Omni4Drive(wheel_distance_m=0.2),
    CAR,
)


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
    speeds = drive.wheel_speeds(PlanarVelocity(0.25, 0.0, 0.8))
    assert speeds == pytest.approx((0.25 - 0.8 * 0.105, 0.25 + 0.8 * 0.105))


@pytest.mark.parametrize(
    ("drive", "velocity", "speeds"),
    [
        (KNOWN[0], PlanarVelocity(yaw_rad_s=1.0), (-0.105, 0.105)),
        (KNOWN[1], PlanarVelocity(1.0, 0.0, 1.0), (0.7, 1.3, 0.7, 1.3)),
        (KNOWN[2], PlanarVelocity(1.0), (1.0, 1.0, 1.0, 1.0)),
        (KNOWN[2], PlanarVelocity(y_m_s=1.0), (-1.0, 1.0, 1.0, -1.0)),  # to the left: the front left wheel rolls back
        (KNOWN[2], PlanarVelocity(yaw_rad_s=1.0), (-0.3, 0.3, -0.3, 0.3)),
        (KNOWN[3], PlanarVelocity(y_m_s=1.0), (0.5, -1.0, 0.5)),
        (KNOWN[3], PlanarVelocity(1.0), (-math.sqrt(0.75), 0.0, math.sqrt(0.75))),
        (KNOWN[3], PlanarVelocity(yaw_rad_s=1.0), (0.2, 0.2, 0.2)),
        (KNOWN[4], PlanarVelocity(1.0), (-DIAGONAL, -DIAGONAL, DIAGONAL, DIAGONAL)),
        (KNOWN[4], PlanarVelocity(y_m_s=1.0), (DIAGONAL, -DIAGONAL, -DIAGONAL, DIAGONAL)),
        (KNOWN[5], PlanarVelocity(1.0, 0.0, 1.0), (0.8, 1.2)),
    ],
)
def test_each_rim_has_its_speed_and_the_speeds_give_the_velocity(
    drive: Drive, velocity: PlanarVelocity, speeds: tuple[float, ...]
) -> None:
    assert drive.wheel_speeds(velocity) == pytest.approx(speeds)
    assert drive.velocity(speeds) == pytest.approx(velocity)
    assert drive.fastest_wheel_m_s(velocity) == pytest.approx(max(map(abs, speeds)))


def test_wheels_have_names_in_the_order_of_their_speeds() -> None:
    four = ("front_left", "front_right", "rear_left", "rear_right")
    assert [drive.wheels for drive in KNOWN] == [
        ("left", "right"),
        four,
        four,
        ("wheel_1", "wheel_2", "wheel_3"),
        ("wheel_1", "wheel_2", "wheel_3", "wheel_4"),
        ("rear_left", "rear_right"),
    ]


def test_a_wheel_more_than_needed_that_slips_counts_by_least_squares() -> None:
    assert KNOWN[1].velocity((1.0, 1.0, 0.0, 0.0)) == pytest.approx(PlanarVelocity(0.5))
    assert KNOWN[2].velocity((1.0, 0.0, 0.0, 0.0)) == pytest.approx(PlanarVelocity(0.25, -0.25, -1 / 1.2))


@pytest.mark.parametrize(
    ("drive", "speeds"), [(PLANAR, ()), (DifferentialDrive(wheel_separation_m=0), ()), (KNOWN[0], (1.0, 1.0, 1.0))]
)
def test_no_velocity_is_made_of_wheels_that_are_not_known(drive: Drive, speeds: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match=rf"{len(speeds)} wheel speeds for a .* drive of {len(drive.wheels)} known"):
        drive.velocity(speeds)


@pytest.mark.parametrize("drive", [each(**({"wheel_separation_m": 0.0} if name == "differential" else {}))
                                   for name, each in DRIVES.items()])  # fmt: skip
def test_a_drive_without_dimensions_knows_no_wheels_and_limits_the_speed_of_the_body(drive: Drive) -> None:
    assert drive.wheels == drive.wheel_speeds(PlanarVelocity(1.0)) == ()
    assert drive.limited(PlanarVelocity(2.0, 0.0, 1.0), 0.5) == PlanarVelocity(0.5, 0.0, 0.25)
    assert drive.limited(PlanarVelocity(0.4), 0.5) == PlanarVelocity(0.4)


def test_half_a_circle_ends_on_the_left() -> None:
    assert KNOWN[0].integrate(Pose(1.0, 1.0, math.pi / 2), (0.895 * math.pi, 1.105 * math.pi)) == pytest.approx(
        Pose(-1.0, 1.0, -math.pi / 2)
    )


def test_strafing_while_turning_is_an_arc_to_the_side() -> None:
    quarter = PlanarVelocity(y_m_s=math.pi / 2, yaw_rad_s=math.pi / 2)
    there = KNOWN[3].integrate(Pose(), KNOWN[3].wheel_speeds(quarter))
    assert there == pytest.approx(Pose(-1.0, 1.0, math.pi / 2))


@pytest.mark.parametrize("drive", [*KNOWN, PLANAR, PlanarDrive(wheel_separation_m=0.3)])
def test_a_limit_of_the_wheels_holds_for_the_largest_numbers_and_for_no_numbers(drive: Drive) -> None:
    largest = drive.limited(PlanarVelocity(1.7e308, -1.7e308 if drive.has_y else 0.0, 1.7e308), 0.5)
    assert drive.fastest_wheel_m_s(largest) <= 0.5 * (1 + 1e-9)
    assert drive.limited(PlanarVelocity(), 0.0) == PlanarVelocity()
    for wrong in (math.inf, -math.inf, math.nan):
        assert drive.fastest_wheel_m_s(PlanarVelocity(wrong)) == math.inf
        assert not drive.limited(PlanarVelocity(wrong), 0.5).is_finite  # as before: the admission refuses it


def test_planar_drive_counts_its_turn_at_the_edge() -> None:
    assert PlanarDrive(wheel_separation_m=0.2).fastest_wheel_m_s(PlanarVelocity(0.3, 0.4, -2.0)) == pytest.approx(0.7)


@pytest.mark.parametrize("drive", KNOWN)
def test_sideways_is_impossible_for_wheels_without_rollers(drive: Drive) -> None:
    reason = drive.why_impossible(PlanarVelocity(0.2, -0.1, 0.0))
    assert (reason is None) is drive.has_y
    if reason is not None:
        assert reason == (
            f"{drive.label} cannot move sideways: send 0 as linear.y; if this robot can, remove "
            f'kinematics = "{drive.kinematics.value}" from its settings'
        )
    assert drive.why_impossible(PlanarVelocity(0.2, 0.0, 0.5)) is None
    assert (drive.why_impossible(PlanarVelocity(yaw_rad_s=0.5)) is None) is drive.turns_in_place


def test_a_car_cannot_turn_in_place_and_a_planar_drive_can_do_everything() -> None:
    assert CAR.why_impossible(PlanarVelocity(yaw_rad_s=0.5)) == (
        "a car with steered wheels cannot turn in place: send a linear.x that is not 0 together with angular.z"
    )
    assert CAR.why_impossible(PlanarVelocity()) is None
    assert PLANAR.why_impossible(PlanarVelocity(1.0, 2.0, 3.0)) is None


@pytest.mark.parametrize(
    ("velocity", "steering"),
    [
        (PlanarVelocity(), Steering()),
        (PlanarVelocity(0.5), Steering(0.5, 0.0)),
        (PlanarVelocity(0.5, 0.0, 0.25), Steering(0.5, math.atan(0.25))),
        (PlanarVelocity(-0.5, 0.0, 0.25), Steering(-0.5, -math.atan(0.25))),  # back and counter-clockwise: to the right
        (PlanarVelocity(-0.5, 0.0, -0.25), Steering(-0.5, math.atan(0.25))),
        (PlanarVelocity(0.5, 0.0, 0.5), Steering(0.5, math.atan(0.5))),
    ],
)
def test_a_car_steers_for_its_yaw_and_back(velocity: PlanarVelocity, steering: Steering) -> None:
    assert CAR.steering(velocity) == pytest.approx(steering)
    assert CAR.velocity_of(steering) == pytest.approx(velocity)
    assert CAR.possible(velocity) == pytest.approx(velocity)


@pytest.mark.parametrize(("x_m_s", "yaw_rad_s"), [(0.5, 3.0), (0.5, -3.0), (-0.5, 3.0), (-0.5, -3.0)])
def test_a_curve_that_is_too_tight_keeps_its_speed_and_becomes_the_tightest(x_m_s: float, yaw_rad_s: float) -> None:
    possible = CAR.possible(PlanarVelocity(x_m_s, 0.0, yaw_rad_s))
    assert possible == pytest.approx(PlanarVelocity(x_m_s, 0.0, math.copysign(0.5, yaw_rad_s)))
    steering = CAR.steering(PlanarVelocity(x_m_s, 0.0, yaw_rad_s))
    assert steering == pytest.approx(CAR.steering(possible))
    assert CAR.velocity_of(Steering(x_m_s, 3 * steering.angle_rad)) == pytest.approx(possible)


def test_drives_but_the_car_have_no_tightest_curve() -> None:
    for drive in KNOWN[:-1]:
        assert drive.possible(PlanarVelocity(0.01, 0.0, 9.0)) == PlanarVelocity(0.01, 0.0, 9.0)


# -- settings -------------------------------------------------------------------------------------------------------


def test_each_kind_of_drive_has_its_settings() -> None:
    assert {name: drive_of(name, {}).kinematics for name in DRIVES if name not in ("planar", "spatial")} == {
        each.value: each for each in Kinematics if each is not Kinematics.SPATIAL
    }
    for drive in DRIVES.values():
        own = {each.name for each in dataclasses.fields(drive) if each.init}
        assert own - {"wheel_radius_m", "ticks_per_turn"} <= set(SETTINGS)


@pytest.mark.parametrize(
    ("kinematics", "given", "drive"),
    [
        ("", {}, PLANAR),
        ("planar", {"wheel_separation_m": 0.2}, PlanarDrive(wheel_separation_m=0.2)),
        ("differential", {}, DifferentialDrive(wheel_separation_m=0.0)),
        ("differential", {"wheel_separation_m": 0.2}, DifferentialDrive(wheel_separation_m=0.2)),
        ("mecanum", {"wheel_separation_m": 0.4, "wheelbase_m": 0.2}, KNOWN[2]),
        ("omni4", {"wheel_distance_m": 0.2}, KNOWN[4]),
        ("ackermann", {"max_steering_rad": 0.3}, AckermannDrive(max_steering_rad=0.3)),
    ],
)
def test_settings_make_the_drive(kinematics: str, given: dict[str, Any], drive: Drive) -> None:
    assert drive_of(kinematics, {**dict.fromkeys(SETTINGS), **given}) == drive


@pytest.mark.parametrize(
    ("kinematics", "given", "problem"),
    [
        ("mecanum", {"wheelbase_m": -0.2}, "wheelbase_m must be a finite number, zero (unknown) or more, not -0.2"),
        ("omni3", {"wheel_distance_m": math.nan}, "wheel_distance_m must be a finite number, zero (unknown) or more"),
        ("omni3", {"wheel_angles_deg": (0.0, 90.0)}, "wheel_angles_deg must be 3 angles in degrees, not [0.0, 90.0]"),
        ("omni4", {"wheel_angles_deg": (0.0, 9.0, 90.0, math.inf)}, "wheel_angles_deg must be 4 angles in degrees"),
        (
            "omni3",
            {"wheel_distance_m": 0.2, "wheel_angles_deg": (90.0, 90.0, -90.0)},
            "the wheels push in too few directions to move and turn; check their angles",
        ),
        ("ackermann", {"wheelbase_m": 0.0}, "wheelbase_m must be above zero"),
        ("ackermann", {"max_steering_rad": 1.6}, "max_steering_rad must be above zero and below 1.5708, not 1.6"),
        ("ackermann", {"max_steering_rad": 0.0}, "max_steering_rad must be above zero and below 1.5708, not 0.0"),
        (
            "mecanum",
            {"wheel_angles_deg": (1.0,)},
            'wheel_angles_deg is not a setting of kinematics = "mecanum", which takes wheel_separation_m, wheelbase_m',
        ),
    ],
)
def test_a_dimension_that_is_wrong_is_refused(kinematics: str, given: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError) as refused:
        drive_of(kinematics, given)
    assert refused.value.problem.startswith(problem)


def test_drive_of_a_command_without_a_field_cannot_move_that_way() -> None:
    drive = PlanarDrive().without(["linear.y", "angular.z"])
    assert drive.why_impossible(PlanarVelocity(x_m_s=0.1)) is None
    assert (
        drive.why_impossible(PlanarVelocity(y_m_s=0.1)) == "the robot's command has no field for linear.y: send 0 there"
    )
    assert "angular.z" in str(drive.why_impossible(PlanarVelocity(yaw_rad_s=0.1)))
    assert drive != PlanarDrive()
