"""RobotEvents: events of robots and links for observers: commands, stops, locks, connections."""

import asyncio
import time
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from enum import Enum
from typing import Any, NamedTuple

from hostlink.core.hub.node import address_of
from hostlink.core.robot.admission import Command
from hostlink.core.robot.velocity import AnyVelocity

LET_GO = "let go"  # reason of a stop: the last velocity was zero
LEASE_ENDED = "no command came"  # reason of a stop: the last velocity is too old
OWNER_LEFT = "the driver left"  # reason of a stop: the source disconnected
WAS_STOPPED = "stopped"  # reason of a stop: a stop was requested
OVERRULED = "overruled"  # reason of a stop: another source has taken the robot over, by another velocity topic of it
NOT_TAKEN = "a command does not fit its device"  # reason of a stop
OTHER_TOPICS = "its device announced other topics"  # reason of a stop
HOST_AWAY = "hostlink did not run"  # reason of a stop: the process was paused, and no command was read
ORDERLY = frozenset({LET_GO, OWNER_LEFT, WAS_STOPPED, OVERRULED})  # a person or a program meant the robot to stop


class EventKind(Enum):
    """Kind of an event. The comment lists its facts."""

    COMMANDED = "commanded"  # a velocity was admitted: owner, address, priority, velocity, limited
    REFUSED = "refused"  # a velocity was refused: owner, address, priority, velocity, reason
    STOPPED = "stopped"  # a driven robot stops: reason, owner
    LOCKED = "locked"  # reason
    UNLOCKED = "unlocked"
    APPEARED = "appeared"  # its device connected: link, peer
    GONE = "gone"  # its device disconnected: link, was_moving
    FORGOTTEN = "forgotten"  # it was disconnected for long
    DIAGNOSED = "diagnosed"  # a finding of the diagnosis: link, code, cause, next_step, detail
    LOGGED = "logged"  # its device logged a line: link, level (0 debug to 4 fatal), text
    LINK_OPENED = "link_opened"  # a device connected, robot or not: link, peer
    LINK_CLOSED = "link_closed"  # a device disconnected: link, peer, reason


class RobotEvent(NamedTuple):
    """Event of a robot or link. `robot` is empty for a device that is not known to be a robot."""

    kind: EventKind
    robot: str
    at_s: float  # loop time
    stamp_ns: int  # wall time
    facts: Mapping[str, object]


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

    def __init__(self) -> None:
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
            self._later.append(_Commanded(robot, now_s, time.time_ns(), command, limited))
            if not is_continued or len(self._later) >= MAX_LATER:
                self.flush()

    def note(self, kind: EventKind, robot: str, **facts: object) -> None:
        """Pass an event of this moment to all observers, after those that wait."""
        if self._observers:
            self._later.append(RobotEvent(kind, robot, asyncio.get_running_loop().time(), time.time_ns(), facts))
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
