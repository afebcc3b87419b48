"""Which events are incidents: what somebody will want to look at afterwards. Pure."""

from dataclasses import dataclass
from typing import Literal

from hostlink.hub.robot_events import EventKind, RobotEvent
from hostlink.robot.velocity import ZERO

Cause = Literal["locked", "lease", "gone", "diagnosed", "device_error", "watchdog", "wish"]

AGAIN_S = 60.0  # the same cause at the same robot is one incident
ERROR_LEVEL = 3
WATCHDOG_TEXT = "no command for"  # of the project's firmware, when its own watchdog has stopped it
LEASE_ENDED = "no command came"
_ENDS = (EventKind.STOPPED, EventKind.LOCKED, EventKind.GONE)  # of a drive


@dataclass(frozen=True, slots=True)
class Incident:
    """What happened, to which robot."""

    robot: str
    cause: Cause
    detail: str
    stamp_ns: int


class IncidentRules:
    """Decides for each event. It keeps how fast each robot was last told to be, and what was an incident lately."""

    def __init__(self) -> None:
        self._is_driven: dict[str, bool] = {}
        self._last_s: dict[tuple[str, Cause], float] = {}

    def observe(self, event: RobotEvent) -> Incident | None:
        """The incident that this event is, if it is one."""
        cause, detail = self._cause(event)
        if cause is None or not event.robot:
            return None
        key = (event.robot, cause)
        if event.at_s < self._last_s.get(key, float("-inf")) + AGAIN_S:
            return None
        self._last_s[key] = event.at_s
        return Incident(event.robot, cause, detail, event.stamp_ns)

    def forget(self, robot: str) -> None:
        """The robot is forgotten."""
        self._is_driven.pop(robot, None)
        self._last_s = {key: at_s for key, at_s in self._last_s.items() if key[0] != robot}

    def _cause(self, event: RobotEvent) -> tuple[Cause | None, str]:
        """(cause, detail); no cause: it is no incident."""
        facts = event.facts
        was_driven = self._is_driven.pop(event.robot, False) if event.kind in _ENDS else False
        match event.kind:
            case EventKind.COMMANDED:
                self._is_driven[event.robot] = facts["limited"] != ZERO
            case EventKind.STOPPED if was_driven and facts["reason"] == LEASE_ENDED:
                return "lease", f"no command of {facts['owner']} came"
            case EventKind.LOCKED:
                return "locked", str(facts["reason"])
            case EventKind.GONE if facts["was_moving"]:
                return "gone", "its link ended while it was driven"
            case EventKind.DIAGNOSED:
                return "diagnosed", f"{facts['cause']} {facts['detail']}".strip()
            case EventKind.LOGGED:
                return _cause_of_line(str(facts["text"]), facts["level"])
        return None, ""


def _cause_of_line(text: str, level: object) -> tuple[Cause | None, str]:
    if WATCHDOG_TEXT in text:
        return "watchdog", text
    return ("device_error", text) if isinstance(level, int) and level >= ERROR_LEVEL else (None, "")
