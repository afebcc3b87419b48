"""RobotEvents: the observers of the events of robots and links."""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

from hostlink.core.hub.node import address_of
from hostlink.core.robot.admission import Command
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.robot.velocity import AnyVelocity

Observe = Callable[[RobotEvent], None]


MAX_LATER = 256  # commands that wait for `flush`


class _Commanded(NamedTuple):
    """A command whose event waits, and the velocity after the limits."""

    robot: str
    at_s: float
    stamp_ns: int
    command: Command[Any]
    limited: AnyVelocity


def facts_of(command: Command[Any]) -> dict[str, object]:
    """Return what the event of a command tells of it."""
    source = command.source
    return {
        "owner": str(source),
        "address": address_of(source),
        "priority": command.priority,
        "velocity": command.velocity,
    }


class RobotEvents:
    """Observers of events. Without observers, no event is created.

    The commands that continue a drive wait for `flush`, which the clock of the gates calls at each tick: one after the
    other they cost a third. No observer notices more than the delay, because every other event flushes first.
    """

    def __init__(self, wall_ns: Callable[[], int] = time.time_ns) -> None:
        """`wall_ns` returns the time of day for the events."""
        self._wall_ns = wall_ns
        self._observers: dict[Hashable, Observe] = {}
        self._later: deque[_Commanded | RobotEvent] = deque()
        self._is_flushing = False

    def observe(self, key: Hashable, receive: Observe) -> None:
        """Call `receive` with each event from now on. A key has one observer."""
        self.flush()
        self._observers[key] = receive

    def leave(self, key: Hashable) -> None:
        """Remove the observer of a key. Do nothing if it has none."""
        if key in self._observers:
            self.flush()
            self._observers.pop(key, None)

    def note_commanded(
        self, robot: str, command: Command[Any], limited: AnyVelocity, now_s: float, *, is_continued: bool
    ) -> None:
        """Pass an admitted command to all observers; one that continues a drive soon."""
        if self._observers:
            self._later.append(_Commanded(robot, now_s, self._wall_ns(), command, limited))
            if not is_continued or len(self._later) >= MAX_LATER:
                self.flush()

    def note(self, kind: EventKind, robot: str, **facts: object) -> None:
        """Pass an event of this moment to all observers, after those that wait."""
        if self._observers:
            self._later.append(RobotEvent(kind, robot, asyncio.get_running_loop().time(), self._wall_ns(), facts))
            self.flush()

    def flush(self) -> None:
        """Pass what waits to all observers. Events that they cause meanwhile follow in their order."""
        if self._is_flushing:
            return
        self._is_flushing = True
        try:
            while self._later:
                event = self._later.popleft()
                if isinstance(event, _Commanded):
                    facts = facts_of(event.command) | {"limited": event.limited}
                    event = RobotEvent(EventKind.COMMANDED, event.robot, event.at_s, event.stamp_ns, facts)
                for receive in tuple(self._observers.values()):
                    receive(event)
        finally:
            self._is_flushing = False
