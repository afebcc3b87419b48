"""Conversion of a robot's state to the JSON that REST, the events and `hostlink doctor` show. Pure."""

from typing import cast

import msgspec

from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.views import OdometryView, RobotView, StoppedRobotView, VelocityView


def robot_view(state: RobotState) -> RobotView:
    """Return the state of one robot."""
    fields = msgspec.structs.asdict(state)
    del fields["odometry_type"], fields["reset_topic"], fields["is_played"]
    view = {
        "name": state.name,
        "connected": state.link is not None,
        **fields,
        "also_at": list(state.also_at),
        "played": state.is_played,
        "locked": state.lock_reason is not None,
        "velocity": velocity_view(state.velocity),
        "odometry": None if state.odometry is None else odometry_view(state.odometry),
        "device_errors": list(state.device_errors),
    }
    return cast(RobotView, view)


def stopped_view(state: RobotState, measured: Standstill) -> StoppedRobotView:
    """Return the state of one robot, and what was measured after a stop."""
    return {
        **robot_view(state),
        "standstill": {
            "state": measured.state.value,
            "speed_m_s": rounded(measured.speed_m_s, 4),
            "turn_rad_s": rounded(measured.turn_rad_s, 4),
            "after_s": rounded(measured.after_s, 3),
            "reason": measured.reason,
        },
    }


def velocity_view(velocity: PlanarVelocity) -> VelocityView:
    """Return the three components of a velocity."""
    return {
        "linear_m_s": velocity.x_m_s,
        "linear_y_m_s": velocity.y_m_s,
        "angular_rad_s": velocity.yaw_rad_s,
    }


def odometry_view(known: OdometrySnapshot) -> OdometryView:
    """Return the newest pose with its age."""
    pose = known.pose
    return {
        "pose": None if pose is None else {"x_m": pose.x_m, "y_m": pose.y_m, "theta_rad": pose.theta_rad},
        "twist": None if known.twist is None else velocity_view(known.twist),
        "is_moving": known.is_moving,
        "stamp_ns": known.stamp_ns,
        "age_s": round(known.age_s, 6),
        "rate_hz": round(known.rate_hz, 2),
        "count": known.count,
        "restarts": known.restarts,
        "ignored": known.ignored,
    }


def rounded(value: float | None, digits: int) -> float | None:
    """Round a value that may be unknown."""
    return None if value is None else round(value, digits)
