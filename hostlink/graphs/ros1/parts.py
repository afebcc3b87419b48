"""Parts: what the publications, publishers and services of this node have in common, and their counts."""

from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Protocol

from hostlink.graphs.ros1.rpc import Master, Rpc
from hostlink.hub.hub import Hub
from hostlink.hub.participant import Participant
from hostlink.mirror.log_once import LogOnce

GROUP = "ros1"
TIMEOUT_S = 5.0  # to connect to another node, and for its header


class Kind(StrEnum):
    """What can be registered; the value is the master's word for it."""

    PUBLISHER = "Publisher"
    SUBSCRIBER = "Subscriber"
    SERVICE = "Service"

    __hash__ = str.__hash__  # an Enum's own is in Python: a tenth of a second for a thousand robots


@dataclass(slots=True)
class Counts:
    """Since the start. What a limit or a policy has cost has a name here."""

    messages_from_ros: int = 0
    messages_to_ros: int = 0
    dropped_to_slow_subscribers: int = 0
    superseded_velocities: int = 0  # a newer one was in the same piece of the stream
    refused_messages: int = 0  # by a robot, a gate or a lock
    malformed_messages: int = 0  # bytes that are not of the type that was agreed upon
    too_large_messages: int = 0
    refused_connections: int = 0  # too many, or from where nobody may connect
    refused_headers: int = 0  # no header, or one for what is not here
    refused_calls: int = 0  # of the slave API: no XML-RPC, or unknown
    failed_services: int = 0
    re_registrations: int = 0  # the master had forgotten this node
    crowded_out: int = 0  # publishers and services of the graph over a bound

    def as_dict(self) -> dict[str, int]:
        """By name."""
        return {name: getattr(self, name) for name in Counts.__slots__}


class Spawned(Protocol):
    """What runs beside all else, and can be ended."""

    def cancel(self) -> object: ...


class Spawn(Protocol):
    """Run something at most as long as the node; its crash ends nothing else."""

    def __call__(self, work: Coroutine[Any, Any, object], *, name: str) -> Spawned: ...


@dataclass(frozen=True, slots=True)
class Parts:
    """`node`: its full name; `uri`: where its slave API answers."""

    hub: Hub
    rpc: Rpc
    master: Master
    node: str
    uri: str
    counts: Counts
    spawn: Spawn
    max_message_bytes: int
    max_publishers: int  # connections to other nodes, of all topics
    log_once: LogOnce = field(default_factory=LogOnce)

    def join(self, who: str, on_end: Callable[[], None] = lambda: None) -> Participant:
        """Another node takes part in the hub, until it leaves."""
        return self.hub.join(f"{GROUP} {who}"[:64], group=GROUP, on_end=on_end)
