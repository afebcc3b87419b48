"""Rosout: logs of devices in the daemon's log and as rosgraph_msgs/Log on /rosout; also warnings of the daemon."""

import contextlib
from collections.abc import Callable

import structlog

from hostlink.core.hub.participant import Participant
from hostlink.core.messages.catalog import to_time
from hostlink.core.protocol.events import LOG_LEVELS, DeviceLogged
from hostlink.core.runtime.logs import printable
from hostlink.errors import HostlinkError

log = structlog.get_logger()

TOPIC, TYPE = "/rosout", "rosgraph_msgs/Log"
_WARNING = 2  # of LOG_LEVELS
_METHODS = ("debug", "info", "warning", "error", "error")  # methods of the log, for each of LOG_LEVELS


class Rosout:
    """Publisher of /rosout for all devices."""

    def __init__(self, participant: Participant, wall_ns: Callable[[], int]) -> None:
        """`wall_ns` returns the time of day for the stamps."""
        self._participant, self._wall_ns = participant, wall_ns
        self._topic = participant.advertise(TOPIC, TYPE)

    def log(self, name: str, event: DeviceLogged) -> None:
        """Log a line of a device. `name` is that of its robot, or the device's address."""
        level, text = event.level, printable(event.text)
        getattr(log, _METHODS[level])("device.logged", level_name=LOG_LEVELS[level], text=text)
        self._publish(level, name, event.text)

    def warn(self, name: str, text: str) -> None:
        """Publish a warning as node `name`. The caller writes the daemon's own log."""
        self._publish(_WARNING, name, text)

    def _publish(self, level: int, name: str, text: str) -> None:
        if self._topic.has_subscribers and self._topic.type is not None:
            line = {"level": 1 << level, "name": name, "msg": text}
            header = {"stamp": to_time(self._wall_ns())}
            with contextlib.suppress(HostlinkError):  # a device that subscribes may not take it
                self._participant.publish(TOPIC, self._topic.type.encode({"header": header, **line}))
