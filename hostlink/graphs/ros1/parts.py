"""Parts: what the publications, subscriptions and services of this node have in common."""

from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, Protocol

import structlog

from hostlink.graphs.ros1.counts import Counts
from hostlink.graphs.ros1.rpc import Master, Rpc
from hostlink.hub.hub import Hub
from hostlink.hub.participant import Participant

log = structlog.get_logger()

GROUP = "ros1"
TIMEOUT_S = 5.0  # to connect to another node, and for its header
MAX_LOGGED = 512  # lines that are written once, each for a name


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
    publishers: set[object] = field(default_factory=set)
    _logged: set[tuple[str, ...]] = field(default_factory=set)

    def join(self, who: str, on_end: Callable[[], None] = lambda: None) -> Participant:
        """Another node takes part in the hub, until it leaves."""
        return self.hub.join(f"{GROUP} {who}"[:64], group=GROUP, on_end=on_end)

    def log_once(self, event: str, **facts: str) -> None:
        """A line that is not repeated: what is tried again and again fails in the same way."""
        key = (event, *facts.values())
        if key not in self._logged and len(self._logged) < MAX_LOGGED:
            self._logged.add(key)
            log.warning(event, **facts)
