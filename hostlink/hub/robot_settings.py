"""The configuration of a robot: its limits, and which of them apply to others of its name."""

import dataclasses

from hostlink.config import CalibrationConfig, RobotConfig
from hostlink.robot.odometry_correction import OdometryCorrection
from hostlink.robot.velocity_gate import Limits


def of_namesake(config: RobotConfig | None) -> RobotConfig:
    """The limits of a robot apply to others that announce the same name; its topics and wheels are its own."""
    if config is None:
        return RobotConfig()
    return dataclasses.replace(
        config,
        address=None,
        odom_topic=None,
        cmd_vel_topic=None,
        cmd_vel_stamped_topic=None,
        odom_frame=None,
        base_frame=None,
        calibration=CalibrationConfig(),
    )


def correction_of(config: RobotConfig) -> OdometryCorrection | None:
    """The correction of the robot's odometry; None: it has none."""
    calibration = config.calibration
    if calibration == CalibrationConfig():
        return None
    return OdometryCorrection(
        calibration.left_factor,
        calibration.right_factor,
        calibration.nominal_separation_m,
        calibration.separation_m,
    )


def limits_of(config: RobotConfig) -> Limits:
    """The limits as the gate has them.

    Raises:
        ConfigError: one of them cannot be kept.
    """
    return Limits(
        max_linear_m_s=config.max_linear_m_s,
        max_angular_rad_s=config.max_angular_rad_s,
        max_wheel_m_s=config.max_wheel_m_s,
        wheel_separation_m=config.wheel_separation_m,
        max_linear_acceleration_m_s2=config.max_linear_acceleration_m_s2,
        max_angular_acceleration_rad_s2=config.max_angular_acceleration_rad_s2,
        max_linear_deceleration_m_s2=config.max_linear_deceleration_m_s2,
        max_angular_deceleration_rad_s2=config.max_angular_deceleration_rad_s2,
    )
