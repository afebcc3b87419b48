"""Standstill: whether a robot that is driven does not move, by its own odometry. Pure: time comes in."""

from hostlink.client import RobotState

PATIENCE_S = 1.0  # a heavy robot has begun to move by then
STILL_M_S = 0.005  # what noise makes of a robot that stands
STILL_RAD_S = 0.02
OLD_S = 1.0  # odometry comes ten times a second and more


class Standstill:
    """Observes the robot's state; `warning` is empty while all is well."""

    def __init__(self) -> None:
        self.warning = ""
        self._still_since_s: float | None = None

    def observe(self, state: RobotState, now_s: float) -> None:
        """The state as it is now."""
        if not _is_driven(state):
            self._still_since_s = None
            self.warning = ""
            return
        cause = _why_still(state)
        if not cause:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = now_s
        is_long = self._still_since_s is not None and now_s >= self._still_since_s + PATIENCE_S
        self.warning = cause if is_long else ""


def _is_driven(state: RobotState) -> bool:
    velocity = state["velocity"]
    return abs(velocity["linear_m_s"]) > STILL_M_S or abs(velocity["angular_rad_s"]) > STILL_RAD_S


def _why_still(state: RobotState) -> str:
    odometry = state["odometry"]
    if odometry is None or odometry["age_s"] > OLD_S:
        return "it is driven and sends no odometry: is its link alive? `hostlink doctor` knows more"
    twist = odometry["twist"]
    if abs(twist["linear_m_s"]) > STILL_M_S or abs(twist["angular_rad_s"]) > STILL_RAD_S:
        return ""
    return "it is driven and its odometry stands still: motors without power, or a wheel blocked?"
