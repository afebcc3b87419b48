"""What the configuration says of a robot: its limits, and what others of its name have of it."""

import dataclasses

from hostlink.config import RobotConfig
from hostlink.robot.velocity_gate import Limits


def of_namesake(config: RobotConfig | None) -> RobotConfig:
    """The limits that hold for a robot hold for others that call themselves the same; its names are its own."""
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
    )


def limits_of(config: RobotConfig) -> Limits:
    """ConfigError for one that could not hold."""
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
