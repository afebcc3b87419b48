"""RobotEvents: the observers of the events of robots and links."""

import asyncio
import time
from collections.abc import Callable, Hashable

from hostlink.core.robot.events import EventKind, RobotEvent

Observe = Callable[[RobotEvent], None]


class RobotEvents:
    """Observers of events. Without observers, no event is created."""

    def __init__(self) -> None:
        self._observers: dict[Hashable, Observe] = {}

    def observe(self, key: Hashable, receive: Observe) -> None:
        """Call `receive` with each event from now on. A key has one observer."""
        self._observers[key] = receive

    def leave(self, key: Hashable) -> None:
        """Remove the observer of a key. Do nothing if it has none."""
        self._observers.pop(key, None)

    def note(self, kind: EventKind, robot: str, **facts: object) -> None:
        """Pass an event of this moment to all observers."""
        if self._observers:
            event = RobotEvent(kind, robot, asyncio.get_running_loop().time(), time.time_ns(), facts)
            for receive in tuple(self._observers.values()):
                receive(event)
