"""Which events are incidents: what somebody will want to look at afterwards. Pure."""

from dataclasses import dataclass
from typing import Any, Literal

from hostlink.hub.robot_events import HOST_AWAY, LEASE_ENDED, EventKind, RobotEvent
from hostlink.robot.velocity import ZERO

Cause = Literal["locked", "lease", "gone", "diagnosed", "device_error", "watchdog", "requested", "daemon_died"]

AGAIN_S = 60.0  # the same cause at the same robot is one incident
MAX_NAMES = 4096  # of robots, and of topics by which devices are driven that are none; the oldest go
ERROR_LEVEL = 3
WATCHDOG_TEXT = "no command for"  # of the project's firmware, when its own watchdog has stopped it
SILENCES = ("went_silent", "time_stopped")  # findings for which a link ends
_ENDS = (EventKind.STOPPED, EventKind.LOCKED, EventKind.GONE)  # of a drive


@dataclass(frozen=True, slots=True)
class Incident:
    """What happened, to which robot."""

    robot: str
    cause: Cause
    detail: str
    stamp_ns: int
    at_s: float = 0.0  # loop time, which nobody sets; 0: it is of a file


class IncidentRules:
    """Decides for each event. It keeps how fast each robot was last told to be, and what was an incident lately."""

    def __init__(self) -> None:
        self._is_driven: dict[str, bool] = {}
        self._last_s: dict[str, dict[Cause, float]] = {}

    def __len__(self) -> int:
        """Of how many names it knows something."""
        return max(len(self._is_driven), len(self._last_s))

    def observe(self, event: RobotEvent) -> Incident | None:
        """The incident that this event is, if it is one."""
        cause, detail = self._cause(event)
        if cause is None or not event.robot:
            return None
        of_robot = self._last_s.setdefault(event.robot, {})
        _drop_oldest(self._last_s)
        causes = (cause, *_same_silence(event))
        if any(event.at_s < of_robot.get(each, float("-inf")) + AGAIN_S for each in causes):
            return None
        of_robot |= dict.fromkeys(causes, event.at_s)
        return Incident(event.robot, cause, detail, event.stamp_ns, event.at_s)

    def forget(self, robot: str) -> None:
        """The robot is forgotten."""
        self._is_driven.pop(robot, None)
        self._last_s.pop(robot, None)

    def _cause(self, event: RobotEvent) -> tuple[Cause | None, str]:
        """(cause, detail); no cause: it is no incident."""
        facts = event.facts
        was_driven = self._is_driven.pop(event.robot, False) if event.kind in _ENDS else False
        match event.kind:
            case EventKind.COMMANDED:
                self._is_driven[event.robot] = facts["limited"] != ZERO
                _drop_oldest(self._is_driven)
            case EventKind.STOPPED if was_driven and facts["reason"] == LEASE_ENDED:
                return "lease", f"no command of {facts['owner']} came"
            case EventKind.STOPPED if was_driven and facts["reason"] == HOST_AWAY:
                return "lease", f"{HOST_AWAY} while {facts['owner']} drove"
            case EventKind.LOCKED:
                return "locked", str(facts["reason"])
            case EventKind.GONE if facts["was_moving"]:
                return "gone", "its link ended while it was driven"
            case EventKind.DIAGNOSED:
                return "diagnosed", f"{facts['cause']} {facts['detail']}".strip()
            case EventKind.LOGGED:
                return _cause_of_line(str(facts["text"]), facts["level"])
        return None, ""


def _same_silence(event: RobotEvent) -> tuple[Cause, ...]:
    """The causes by which the same silence shows as well: its link ends, or the robot's own watchdog stops it."""
    if event.kind is EventKind.DIAGNOSED and event.facts["code"] in SILENCES:
        return ("gone",)
    return ("watchdog",) if event.kind is EventKind.STOPPED and event.facts["reason"] == HOST_AWAY else ()


def _drop_oldest(names: dict[str, Any]) -> None:
    if len(names) > MAX_NAMES:
        del names[next(iter(names))]


def _cause_of_line(text: str, level: object) -> tuple[Cause | None, str]:
    if WATCHDOG_TEXT in text:
        return "watchdog", text
    return ("device_error", text) if isinstance(level, int) and level >= ERROR_LEVEL else (None, "")
