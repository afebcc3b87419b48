"""The kinematics of drives against closed forms, other methods and their own inverse."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.robot.kinematics import (
    SMALL_ANGLE_RAD,
    AckermannDrive,
    DifferentialDrive,
    Drive,
    MecanumDrive,
    Omni4Drive,
    OmniDrive,
    Pose,
    SkidSteerDrive,
    Steering,
    chord_per_arc,
    frame_of,
    placed,
    wrap_angle,
)
from hostlink.core.robot.velocity import PlanarVelocity

speeds = st.floats(-2, 2)
angles = st.floats(-math.pi, math.pi, exclude_min=True)
poses = st.builds(Pose, st.floats(-10, 10), st.floats(-10, 10), angles)
drives = st.builds(
    DifferentialDrive,
    wheel_radius_m=st.floats(0.01, 0.5),
    wheel_separation_m=st.floats(0.05, 2),
    ticks_per_turn=st.floats(10, 10_000),
)


def assert_near(ours: Pose, theirs: Pose, tolerance: float = 1e-9) -> None:
    assert ours.x_m == pytest.approx(theirs.x_m, abs=tolerance)
    assert ours.y_m == pytest.approx(theirs.y_m, abs=tolerance)
    assert abs(wrap_angle(ours.theta_rad - theirs.theta_rad)) <= tolerance


def by_the_book(drive: DifferentialDrive, pose: Pose, left_m: float, right_m: float) -> Pose:
    """The step of docs/paper-robot.md#equations, letter by letter."""
    d, turned = (left_m + right_m) / 2, (right_m - left_m) / drive.wheel_separation_m
    if abs(turned) < 1e-5:
        dx, dy = d * math.cos(turned / 2), d * math.sin(turned / 2)
    else:
        dx, dy = d / turned * math.sin(turned), d / turned * (1 - math.cos(turned))
    cos, sin = math.cos(pose.theta_rad), math.sin(pose.theta_rad)
    theta = wrap_angle(pose.theta_rad + turned)
    return Pose(pose.x_m + dx * cos - dy * sin, pose.y_m + dx * sin + dy * cos, theta)


@given(drives, speeds, speeds)
def test_wheel_speeds_give_the_body_its_velocity(
    drive: DifferentialDrive, linear_m_s: float, angular_rad_s: float
) -> None:
    left_m_s, right_m_s = drive.wheel_speeds(PlanarVelocity(linear_m_s, yaw_rad_s=angular_rad_s))
    assert (left_m_s + right_m_s) / 2 == pytest.approx(linear_m_s, abs=1e-12)
    assert (right_m_s - left_m_s) / drive.wheel_separation_m == pytest.approx(angular_rad_s, abs=1e-12)


@given(drives, poses, st.floats(-3, 3), st.floats(-3, 3))
def test_a_step_is_that_of_the_book(drive: DifferentialDrive, pose: Pose, left_m: float, right_m: float) -> None:
    assert_near(drive.integrate(pose, (left_m, right_m)), by_the_book(drive, pose, left_m, right_m), 1e-7)


@given(drives, poses, st.floats(-5, 5))
def test_equal_wheels_go_straight(drive: DifferentialDrive, pose: Pose, distance_m: float) -> None:
    x_m = pose.x_m + distance_m * math.cos(pose.theta_rad)
    y_m = pose.y_m + distance_m * math.sin(pose.theta_rad)
    assert_near(drive.integrate(pose, (distance_m, distance_m)), Pose(x_m, y_m, pose.theta_rad))


@given(drives, poses, st.floats(-10, 10))
def test_opposite_wheels_spin_on_the_spot(drive: DifferentialDrive, pose: Pose, turned_rad: float) -> None:
    rolled_m = turned_rad * drive.wheel_separation_m / 2
    there = drive.integrate(pose, (-rolled_m, rolled_m))
    assert_near(there, Pose(pose.x_m, pose.y_m, wrap_angle(pose.theta_rad + turned_rad)))


@given(drives, poses, st.floats(0.1, 3) | st.floats(-3, -0.1), st.integers(3, 60))
def test_a_whole_circle_ends_where_it_began(drive: DifferentialDrive, start: Pose, radius_m: float, steps: int) -> None:
    turn_rad = math.tau / steps
    left_m, right_m = drive.wheel_speeds(PlanarVelocity(radius_m * turn_rad, yaw_rad_s=turn_rad))
    centre = (start.x_m - radius_m * math.sin(start.theta_rad), start.y_m + radius_m * math.cos(start.theta_rad))
    pose = start
    for _ in range(steps):
        pose = drive.integrate(pose, (left_m, right_m))
        assert math.dist(pose[:2], centre) == pytest.approx(abs(radius_m))
    assert_near(pose, start)


@given(drives, poses, speeds, speeds, st.integers(1, 20))
def test_one_long_step_is_many_short_ones(
    drive: DifferentialDrive, start: Pose, left_m: float, right_m: float, steps: int
) -> None:
    pose = start
    for _ in range(steps):
        pose = drive.integrate(pose, (left_m / steps, right_m / steps))
    assert_near(pose, drive.integrate(start, (left_m, right_m)), 1e-8)


@given(poses, st.floats(-3, 3), st.floats(0.5, 2))
def test_step_is_continuous_at_the_small_angle(pose: Pose, distance_m: float, factor: float) -> None:
    drive = DifferentialDrive()
    apart_m = SMALL_ANGLE_RAD * factor * drive.wheel_separation_m
    straight = drive.integrate(pose, (distance_m, distance_m))
    bent = drive.integrate(pose, (distance_m - apart_m / 2, distance_m + apart_m / 2))
    assert_near(bent, straight, 4 * SMALL_ANGLE_RAD)


def test_the_chord_is_as_long_as_the_arc_on_both_sides_of_the_small_angle() -> None:
    assert chord_per_arc(math.nextafter(SMALL_ANGLE_RAD, 1)) == chord_per_arc(SMALL_ANGLE_RAD / 2) == 1
    assert chord_per_arc(0.0) == 1
    assert chord_per_arc(math.pi) == chord_per_arc(-math.pi) == pytest.approx(2 / math.pi)


@given(st.floats(-1e6, 1e6))
def test_a_wrapped_angle_is_the_same_direction_within_bounds(angle_rad: float) -> None:
    wrapped = wrap_angle(angle_rad)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle_rad), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle_rad), abs=1e-9)
    assert wrap_angle(wrapped) == wrapped


def test_half_a_turn_is_plus_pi_either_way() -> None:
    assert wrap_angle(math.pi) == wrap_angle(-math.pi) == wrap_angle(3 * math.pi) == math.pi


@pytest.mark.parametrize("angle_rad", [math.inf, -math.inf, math.nan])
def test_wrapped_angle_that_is_not_finite_is_nan(angle_rad: float) -> None:
    assert math.isnan(wrap_angle(angle_rad))


def test_the_robot_of_the_paper() -> None:
    drive = DifferentialDrive()
    assert drive.metres_per_tick == pytest.approx(0.0012272, abs=5e-8)
    assert 280 * drive.metres_per_tick == pytest.approx(0.3436, abs=5e-5)
    assert drive.wheel_speeds(PlanarVelocity(0.0, yaw_rad_s=1.0)) == pytest.approx((-0.105, 0.105))


@given(poses, poses)
def test_a_frame_puts_a_pose_where_it_shall_be(outer: Pose, inner: Pose) -> None:
    assert_near(placed(frame_of(outer, inner), inner), outer)


@given(drives, poses, poses, speeds, speeds)
def test_a_robot_moves_the_same_way_in_every_frame(
    drive: DifferentialDrive, frame: Pose, pose: Pose, left_m: float, right_m: float
) -> None:
    assert_near(
        placed(frame, drive.integrate(pose, (left_m, right_m))),
        drive.integrate(placed(frame, pose), (left_m, right_m)),
        1e-8,
    )


@given(poses)
def test_the_frame_of_a_device_that_never_restarted_changes_nothing(pose: Pose) -> None:
    assert placed(Pose(), pose) == pose


# -- every drive ----------------------------------------------------------------------------------------------------

lengths = st.floats(0.05, 2)
jitters = st.tuples(*[st.floats(-20, 20)] * 4)  # degrees: no wheel is mounted exactly
every_drive = (
    drives
    | st.builds(SkidSteerDrive, wheel_separation_m=lengths, separation_factor=st.floats(0.5, 3))
    | st.builds(MecanumDrive, wheel_separation_m=lengths, wheelbase_m=lengths)
    | st.builds(
        lambda distance_m, turned: OmniDrive(
            wheel_distance_m=distance_m, wheel_angles_deg=(60 + turned[0], 180 + turned[1], 300 + turned[2])
        ),
        lengths,
        jitters,
    )
    | st.builds(
        lambda distance_m, turned: Omni4Drive(
            wheel_distance_m=distance_m,
            wheel_angles_deg=(45 + turned[0], 135 + turned[1], 225 + turned[2], 315 + turned[3]),
        ),
        lengths,
        jitters,
    )
    | st.builds(AckermannDrive, wheel_separation_m=lengths, wheelbase_m=lengths, max_steering_rad=st.floats(0.05, 1.5))
)
wanted = st.builds(PlanarVelocity, speeds, speeds, st.floats(-6, 6))


def possible(drive: Drive, velocity: PlanarVelocity) -> PlanarVelocity:
    """Return what a drive can do of a velocity."""
    return drive.possible(velocity if drive.has_y else velocity._replace(y_m_s=0.0))


@given(every_drive, wanted)
def test_wheel_speeds_and_velocity_are_inverse(drive: Drive, velocity: PlanarVelocity) -> None:
    velocity = possible(drive, velocity)
    assert drive.velocity(drive.wheel_speeds(velocity)) == pytest.approx(velocity, abs=1e-9)
    if velocity.x_m_s:
        assert drive.why_impossible(velocity) is None


@given(every_drive, st.tuples(*[speeds] * 4), st.tuples(*[speeds] * 3))
def test_velocity_of_wheels_is_the_nearest_of_all(
    drive: Drive, rims: tuple[float, ...], other: tuple[float, float, float]
) -> None:
    rims = rims[: len(drive.wheels)]
    found = drive.velocity(rims)
    other_velocity = PlanarVelocity(*other) if drive.has_y else PlanarVelocity(other[0], 0.0, other[2])
    assert math.dist(drive.wheel_speeds(found), rims) <= math.dist(drive.wheel_speeds(other_velocity), rims) + 1e-9


@given(every_drive, wanted, st.floats(0.01, 1))
def test_limited_velocity_keeps_direction_and_curvature_and_every_wheel_its_limit(
    drive: Drive, velocity: PlanarVelocity, max_wheel_m_s: float
) -> None:
    velocity = possible(drive, velocity)
    limited = drive.limited(velocity, max_wheel_m_s)
    fastest_m_s = max(map(abs, drive.wheel_speeds(velocity)))
    factor = min(1.0, max_wheel_m_s / fastest_m_s) if fastest_m_s else 1.0
    assert limited == pytest.approx(velocity.scaled(factor), rel=1e-9)
    assert max(map(abs, drive.wheel_speeds(limited))) <= max_wheel_m_s * (1 + 1e-9)
    assert drive.possible(limited) == pytest.approx(limited, rel=1e-9)


@given(every_drive, poses, wanted, st.integers(1, 50))
def test_many_small_steps_of_a_drive_are_one_large_one(
    drive: Drive, start: Pose, velocity: PlanarVelocity, steps: int
) -> None:
    rolled = drive.wheel_speeds(possible(drive, velocity))
    pose = start
    for _ in range(steps):
        pose = drive.integrate(pose, [metres / steps for metres in rolled])
    assert_near(pose, drive.integrate(start, rolled), 1e-8)


@given(every_drive, poses, wanted)
def test_a_large_step_is_many_straight_ones(drive: Drive, start: Pose, velocity: PlanarVelocity) -> None:
    """Against Euler's method: the arc is the limit of straight steps."""
    velocity, steps = possible(drive, velocity), 2_000
    x_m, y_m = start.x_m, start.y_m
    for number in range(steps):
        heading_rad = start.theta_rad + velocity.yaw_rad_s * (number + 0.5) / steps
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        x_m += (cos * velocity.x_m_s - sin * velocity.y_m_s) / steps
        y_m += (sin * velocity.x_m_s + cos * velocity.y_m_s) / steps
    there = drive.integrate(start, drive.wheel_speeds(velocity))
    assert_near(there, Pose(x_m, y_m, wrap_angle(start.theta_rad + velocity.yaw_rad_s)), 1e-5)


@given(lengths, st.floats(0.05, 1.5), speeds, st.floats(-2, 2))
def test_a_car_is_on_the_circle_of_its_steering(
    wheelbase_m: float, max_steering_rad: float, speed_m_s: float, angle_rad: float
) -> None:
    """Both axles' lines meet in the centre of the turn, wheelbase / tan(steering) to the left of the rear axle.

    R. Rajamani, Vehicle Dynamics and Control, section 2.2 (kinematic model, rear slip 0): yaw = v tan(steering) / L.
    """
    car = AckermannDrive(wheelbase_m=wheelbase_m, max_steering_rad=max_steering_rad)
    velocity = car.velocity_of(Steering(speed_m_s, angle_rad))
    steered_rad = max(-max_steering_rad, min(angle_rad, max_steering_rad))
    assert velocity.yaw_rad_s == pytest.approx(speed_m_s * math.tan(steered_rad) / wheelbase_m)
    assert car.velocity_of(car.steering(velocity)) == pytest.approx(velocity, abs=1e-9)
    assert car.possible(velocity) == pytest.approx(velocity)
    if velocity.yaw_rad_s:
        to_centre_m = speed_m_s / velocity.yaw_rad_s
        assert math.atan2(wheelbase_m, abs(to_centre_m)) == pytest.approx(abs(steered_rad))
