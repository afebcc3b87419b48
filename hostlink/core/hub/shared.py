"""Shared: the parts of the hub that know neither devices nor robots nor programs, and which these share."""

import asyncio
import secrets
import time
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar
from weakref import WeakValueDictionary

from hostlink.core.config import Config
from hostlink.core.hub.byte_budget import ByteBudget
from hostlink.core.hub.diagnoses import Diagnoses
from hostlink.core.hub.gates import Gates, Guard
from hostlink.core.hub.graph_changes import GraphChanges
from hostlink.core.hub.graph_view import GraphView
from hostlink.core.hub.isolation import Isolation
from hostlink.core.hub.node import Node
from hostlink.core.hub.robot_events import RobotEvents
from hostlink.core.hub.services import Services
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.link.fair_share import FairShare, Turns
from hostlink.core.messages.catalog import Catalog
from hostlink.core.robot.admission import EPOCH_BITS
from hostlink.core.runtime.loop_time import loop_time_s

Offered = TypeVar("Offered")
DAEMON = "hostlink"  # name of the daemon's own participants in the graph
CALL_BITS = 32  # two daemons, one after the other, hardly draw the same number


@dataclass(frozen=True, slots=True)
class Counts:
    """Counters of listeners and components, which write into it."""

    refused: Counter[str] = field(default_factory=Counter)  # refused and evicted connections, by cause
    datagrams_dropped: Counter[str] = field(default_factory=Counter)  # UDP datagrams in both directions, by cause
    components: dict[str, Callable[[], Mapping[str, int]]] = field(default_factory=dict)  # counters of each component


def draw_epoch() -> int:
    """Draw the first epoch of a robot."""
    return secrets.randbits(EPOCH_BITS)


def draw_call() -> int:
    """Draw the number of a connection's first call."""
    return secrets.randbits(CALL_BITS)


class Shared:
    """Settings, clocks, graph, gates, diagnoses and tasks of one hub.

    `reraises` is for tests: a crash of one link ends the hub. Otherwise it is logged and counted.
    """

    def __init__(
        self,
        config: Config,
        catalog: Catalog,
        *,
        reraises: bool = False,
        guard: Guard | None = None,
        slept_s: Callable[[], float] = lambda: 0.0,
        computed_s: Callable[[], float] = loop_time_s,
        wall_ns: Callable[[], int] | None = None,
        namespace: str = "/",
    ) -> None:
        """Connect nothing yet. The arguments are those of `Hub`."""
        self.namespace = namespace
        self.config, self.catalog = config, catalog
        self.wall_ns = time.time_ns if wall_ns is None else wall_ns
        self.counts = Counts()
        self.parameters = dict(config.parameters)  # parameters for devices; clients may change them
        self.isolation = Isolation(reraises=reraises)
        self.changes = GraphChanges(computed_s)
        self.budget = ByteBudget()
        self.node = Node(DAEMON, is_daemon=True)  # publishes and subscribes the topics of robots that have names of ROS
        self.topics = TopicGraph(catalog, self.changes, self.budget, self.wall_ns)
        self.services = Services(catalog, self.changes)
        self.events = RobotEvents(self.wall_ns)
        self.slept_s = slept_s
        self.gates = Gates(self.isolation, guard, self.events, slept_s=slept_s, wall_ns=self.wall_ns)
        self.share = FairShare(self.gates.came_s)  # of the event loop, for links and participants
        self.diagnoses = Diagnoses(
            self.isolation, self.events, self.gates.pauses, catalog.least_bytes, slept_s, self.wall_ns
        )
        self.tasks: asyncio.TaskGroup | None = None  # set while the hub runs
        self.offers: dict[type, object] = {}  # what components offer to each other, by its type
        self._views: WeakValueDictionary[str, GraphView] = (
            WeakValueDictionary()
        )  # by group, while participants use them

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str) -> None:
        """Run work at most as long as the hub; not at all while the hub ends. A crash ends only this work."""
        if self.tasks is None:
            raise RuntimeError("the hub does not run yet")
        isolated = self.isolated(work, name)
        try:
            task = self.tasks.create_task(isolated, name=name)
        except RuntimeError:  # the hub is ending: the work would be cancelled before its first turn
            isolated.close()
            work.close()
            return
        task.add_done_callback(lambda _: work.close())  # a task that is cancelled before its first turn never awaits it

    async def isolated(self, work: Coroutine[Any, Any, object], name: str) -> None:
        """Await work. A crash of it is logged, counted, and ends nothing else."""
        with self.isolation.around("task", task=name):
            await work

    def offered(self, kind: type[Offered]) -> Offered | None:
        """Return what a component offers of this type; None: no component that runs does."""
        found = self.offers.get(kind)
        return found if isinstance(found, kind) else None

    def view(self, group: str) -> GraphView:
        """Return the view of the graph for all participants of one group."""
        view = self._views.get(group)
        if view is None:
            view = self._views[group] = GraphView(self.topics, self.services, self.changes, group)
        return view

    def turns(self) -> Turns:
        """Create the share of one more link or participant in the event loop."""
        return Turns(self.share)
