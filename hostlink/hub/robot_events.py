"""RobotEvents: what happens to robots and links, for whoever keeps it: commands, stops, locks, comings and goings."""

import asyncio
import time
from collections.abc import Callable, Hashable, Mapping
from enum import Enum
from typing import NamedTuple

LET_GO = "let go"  # why a drive stopped: its last velocity was a zero
LEASE_ENDED = "no command came"  # why a drive stopped: its last velocity is too old
OWNER_LEFT = "owner left"  # why a drive stopped: its source has ended its connection
WAS_STOPPED = "stopped"  # why a drive stopped: by a stop
HOST_AWAY = "hostlink did not run"  # the same, but nothing could come: the process was paused


class EventKind(Enum):
    """What happened."""

    COMMANDED = "commanded"  # a velocity was accepted: owner, address, priority, velocity, limited
    REFUSED = "refused"  # a velocity was not: owner, address, priority, velocity, reason
    STOPPED = "stopped"  # what it drove stops: reason, owner
    LOCKED = "locked"  # reason
    UNLOCKED = "unlocked"
    APPEARED = "appeared"  # its device is connected: link, peer
    GONE = "gone"  # its device is connected no more: was_moving
    FORGOTTEN = "forgotten"  # it was away for long
    DIAGNOSED = "diagnosed"  # doctor found something: link, code, cause, next_step, detail
    LOGGED = "logged"  # its device logged a line: link, level (0 debug to 4 fatal), text
    LINK_OPENED = "link_opened"  # of a device, robot or not: link, peer
    LINK_CLOSED = "link_closed"  # link, peer, reason


class RobotEvent(NamedTuple):
    """`robot` is empty for a device that is none, or not known yet. The facts of each kind are named with it."""

    kind: EventKind
    robot: str
    at_s: float  # loop time
    stamp_ns: int  # wall time
    facts: Mapping[str, object]


Observe = Callable[[RobotEvent], None]


class RobotEvents:
    """Who observes them. What nobody observes is not made."""

    def __init__(self) -> None:
        self._observers: dict[Hashable, Observe] = {}

    def observe(self, key: Hashable, receive: Observe) -> None:
        """Call `receive` for each event from now on; a key has one observer."""
        self._observers[key] = receive

    def leave(self, key: Hashable) -> None:
        """End the observation of a key; one that observes nothing is no error."""
        self._observers.pop(key, None)

    def note(self, kind: EventKind, robot: str, **facts: object) -> None:
        """Something has happened now."""
        if self._observers:
            event = RobotEvent(kind, robot, asyncio.get_running_loop().time(), time.time_ns(), facts)
            for receive in tuple(self._observers.values()):
                receive(event)
