"""A robot's state for the tests of this folder."""

from typing import Any

from hostlink.core.host import PlanarVelocity, RobotState


def robot(name: str, **changed: Any) -> RobotState:
    """State of a connected robot that tells much of itself."""
    told: dict[str, Any] = {
        "link": 1,
        "velocity_topic": f"/{name}/cmd_vel",
        "velocity": PlanarVelocity(0.2, 0.0, -0.5),
        "battery_v": 11.87,
        "battery_percent": 71.2,
        "signal_dbm": -67,
        "firmware": "rover 1.4.2",
        "device_errors": ("battery_low",),
    }
    return RobotState(name=name, **{**told, **changed})
