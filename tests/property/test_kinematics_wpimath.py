"""The drives against WPILib's kinematics, the library of the FIRST robotics competition: another author's equations."""

import math
import random
from collections.abc import Iterator

import pytest
from wpimath.geometry import Pose2d, Rotation2d, Translation2d, Twist2d
from wpimath.kinematics import (
    ChassisSpeeds,
    DifferentialDriveKinematics,
    MecanumDriveKinematics,
    MecanumDriveWheelPositions,
    MecanumDriveWheelSpeeds,
    SwerveDrive3Kinematics,
    SwerveDrive4Kinematics,
    SwerveModulePosition,
)

from hostlink.core.robot.kinematics import (
    DifferentialDrive,
    Drive,
    MecanumDrive,
    Omni4Drive,
    OmniDrive,
    Pose,
    SkidSteerDrive,
    wrap_angle,
)
from hostlink.core.robot.velocity import PlanarVelocity

COMMANDS, SEED, STEP_S, TOLERANCE = 2_000, 1, 0.1, 1e-9


def commands(*, has_y: bool) -> Iterator[PlanarVelocity]:
    drawn = random.Random(SEED)
    for number in range(COMMANDS):
        y_m_s = drawn.uniform(-2, 2) if has_y else 0.0
        yaw_rad_s = 0.0 if number % 10 == 0 else drawn.uniform(-6, 6)
        yield PlanarVelocity(drawn.uniform(-2, 2), y_m_s, yaw_rad_s)


def chassis(velocity: PlanarVelocity) -> ChassisSpeeds:
    return ChassisSpeeds(*velocity)


def assert_speeds(ours: PlanarVelocity, theirs: ChassisSpeeds) -> None:
    assert ours == pytest.approx((theirs.vx, theirs.vy, theirs.omega), abs=TOLERANCE, rel=0)


def assert_pose(ours: Pose, theirs: Pose2d) -> None:
    assert ours[:2] == pytest.approx((theirs.x, theirs.y), abs=TOLERANCE, rel=0)
    assert abs(wrap_angle(ours.theta_rad - theirs.rotation().radians())) <= TOLERANCE


def moved(pose: Pose, twist: Twist2d) -> Pose2d:
    """WPILib's pose exponential from our pose: the errors of 2,000 steps do not add up to a false difference."""
    return Pose2d(pose.x_m, pose.y_m, Rotation2d(pose.theta_rad)).exp(twist)


@pytest.mark.parametrize("drive", [DifferentialDrive(), SkidSteerDrive(wheel_separation_m=0.3, separation_factor=1.7)])
def test_wheels_and_odometry_of_two_sides_are_those_of_wpilib(drive: Drive) -> None:
    separation_m = 0.21 if isinstance(drive, DifferentialDrive) else 0.3 * 1.7
    theirs, pose = DifferentialDriveKinematics(separation_m), Pose()
    for velocity in commands(has_y=False):
        wheels = theirs.toWheelSpeeds(chassis(velocity))
        speeds = drive.wheel_speeds(velocity)
        expected = (wheels.left, wheels.right) * (len(speeds) // 2)
        assert speeds == pytest.approx(expected, abs=TOLERANCE, rel=0)
        assert_speeds(drive.velocity(speeds), theirs.toChassisSpeeds(wheels))
        rolled = [speed * STEP_S for speed in speeds]
        twist = theirs.toTwist2d(rolled[0], rolled[1])
        after = drive.integrate(pose, rolled)
        assert_pose(after, moved(pose, twist))
        pose = after


def test_wheels_and_odometry_of_mecanum_are_those_of_wpilib() -> None:
    drive, pose, drawn = MecanumDrive(wheel_separation_m=0.44, wheelbase_m=0.3), Pose(), random.Random(SEED)
    theirs = MecanumDriveKinematics(*(Translation2d(x, y) for x in (0.15, -0.15) for y in (0.22, -0.22)))
    for velocity in commands(has_y=True):
        wheels = theirs.toWheelSpeeds(chassis(velocity))
        speeds = drive.wheel_speeds(velocity)
        expected = (wheels.frontLeft, wheels.frontRight, wheels.rearLeft, wheels.rearRight)
        assert speeds == pytest.approx(expected, abs=TOLERANCE, rel=0)
        slipping = [speed + drawn.uniform(-0.2, 0.2) for speed in speeds]  # no velocity has these: the least squares
        assert_speeds(drive.velocity(slipping), theirs.toChassisSpeeds(MecanumDriveWheelSpeeds(*slipping)))
        rolled = [speed * STEP_S for speed in slipping]
        positions = MecanumDriveWheelPositions()
        positions.frontLeft, positions.frontRight, positions.rearLeft, positions.rearRight = rolled
        after = drive.integrate(pose, rolled)
        assert_pose(after, moved(pose, theirs.toTwist2d(MecanumDriveWheelPositions(), positions)))
        pose = after


@pytest.mark.parametrize("drive", [OmniDrive(wheel_distance_m=0.2), Omni4Drive(wheel_distance_m=0.2)])
def test_wheels_and_odometry_of_omni_are_those_of_swerve_modules(drive: OmniDrive) -> None:
    """An omni wheel has the part of a swerve module's velocity along its circle; the rollers have the rest."""
    angles_rad = [math.radians(angle_deg) for angle_deg in drive.wheel_angles_deg]
    places = [Translation2d(0.2 * math.cos(each), 0.2 * math.sin(each)) for each in angles_rad]
    theirs = (SwerveDrive3Kinematics if len(places) == 3 else SwerveDrive4Kinematics)(*places)
    pose = Pose()
    for velocity in commands(has_y=True):
        modules = theirs.toSwerveModuleStates(chassis(velocity))
        speeds = drive.wheel_speeds(velocity)
        expected = [
            module.speed * math.cos(module.angle.radians() - (angle_rad + math.pi / 2))
            for module, angle_rad in zip(modules, angles_rad, strict=True)
        ]
        assert speeds == pytest.approx(expected, abs=TOLERANCE, rel=0)
        assert_speeds(drive.velocity(speeds), theirs.toChassisSpeeds(modules))
        ends = tuple(SwerveModulePosition(module.speed * STEP_S, module.angle) for module in modules)
        begins = tuple(SwerveModulePosition(0, module.angle) for module in modules)
        after = drive.integrate(pose, [speed * STEP_S for speed in speeds])
        assert_pose(after, moved(pose, theirs.toTwist2d(begins, ends)))
        pose = after
