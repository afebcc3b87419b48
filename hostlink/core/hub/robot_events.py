"""RobotEvents: events of robots and links for observers: commands, stops, locks, connections."""

import asyncio
import time
from collections.abc import Callable, Hashable, Mapping
from enum import Enum
from typing import NamedTuple

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


class RobotEvents:
    """Observers of events. Without observers, no event is created."""

    def __init__(self, wall_ns: Callable[[], int] = time.time_ns) -> None:
        """`wall_ns` returns the time of day for the events."""
        self._wall_ns = wall_ns
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
            event = RobotEvent(kind, robot, asyncio.get_running_loop().time(), self._wall_ns(), facts)
            for receive in tuple(self._observers.values()):
                receive(event)
