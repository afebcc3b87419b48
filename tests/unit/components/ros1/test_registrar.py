"""A master that refuses, forgets, dies and begins anew knows what is wanted in the end, and services first."""

import asyncio
from dataclasses import dataclass, field
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from hostlink.cli.ending import LONGEST_END_S
from hostlink.components.ros1.graph_sync import GraphSync
from hostlink.components.ros1.local_node import LocalNode, RegistrationKind, Ros1Counts
from hostlink.components.ros1.master import (
    CHECK_INTERVAL_S,
    END_TIMEOUT_S,
    STATE_INTERVAL_S,
    MasterParameters,
    Registrar,
    _nodes_by_name,
)
from hostlink.components.ros1.xml_rpc import CallRefused, Unreachable
from hostlink.core.mirror.log_once import LogOnce
from tests.support.virtual_loop import virtual

NODE, URI, SERVICE_URI = "/hostlink", "http://here:1/", "rosrpc://here:2"
KINDS = (
    RegistrationKind.PUBLISHER,
    RegistrationKind.SUBSCRIBER,
    RegistrationKind.SERVICE,
)  # in the order of getSystemState
SETTLED_S = 2 * (CHECK_INTERVAL_S + STATE_INTERVAL_S)
Wanted = dict[tuple[RegistrationKind, str], str]


@dataclass
class FakeNode:
    """A node with a master that keeps the third argument of each registration in `known`."""

    name: str = NODE
    uri: str = URI
    master_uri: str = "http://master/"
    counts: Ros1Counts = field(default_factory=Ros1Counts)
    log_once: LogOnce = field(default_factory=LogOnce)
    known: Wanted = field(default_factory=dict)
    refused: set[str] = field(default_factory=set)
    calls: list[str] = field(default_factory=list)
    is_reachable: bool = True
    dies_after: int = 1000  # calls
    way_s: float = 0.0005  # of a call to the master, and of its answer

    async def find_own_uri(self) -> str | None:
        self.check()
        return URI if self.known else None

    async def call_master(self, method: str, *arguments: Any) -> object:
        self.check()
        await asyncio.sleep(self.way_s)
        try:
            return self._answer(method, *arguments)
        finally:
            await asyncio.sleep(self.way_s)

    def _answer(self, method: str, *arguments: Any) -> object:
        if method == "getSystemState":
            return [[[name, [NODE]] for kind, name in self.known if kind is each] for each in KINDS]
        self.calls.append(method)
        is_there, kind = (
            method.startswith("register"),
            RegistrationKind(method.removeprefix("un").removeprefix("register")),
        )
        if is_there and arguments[0] in self.refused:
            raise CallRefused("no")
        if is_there:
            self.known[kind, arguments[0]] = arguments[1]
        else:
            assert arguments[1] == (SERVICE_URI if kind is RegistrationKind.SERVICE else URI)
            self.known.pop((kind, arguments[0]), None)
        return []

    def check(self) -> None:
        self.dies_after -= 1
        if not self.is_reachable or self.dies_after < 0:
            raise Unreachable("dead")


@dataclass
class Sync:
    """Wanted registrations."""

    topics: Wanted = field(default_factory=dict)

    def wanted(self) -> Wanted:
        return dict(self.topics)

    def set_publishers(self, topic: str, uris: list[str], *, is_answer: bool) -> None:
        assert topic
        assert (uris, is_answer) == ([], True)


@dataclass
class Parameters:
    """Parameters that the node has subscribed to at its master."""

    master: FakeNode
    keys: list[str] = field(default_factory=list)

    async def renew(self) -> None: ...

    async def unsubscribe(self, key: str) -> None:
        self.master.check()
        await asyncio.sleep(2 * self.master.way_s)
        self.keys = [each for each in self.keys if each != key]


class World:
    def __init__(self) -> None:
        self.master, self.sync = FakeNode(), Sync()
        self.parameters = Parameters(self.master)
        self.registrar = Registrar(
            cast("LocalNode", self.master),
            cast("GraphSync", self.sync),
            cast("MasterParameters", self.parameters),
            SERVICE_URI,
            on_services=lambda _: None,
            on_collision=lambda _: None,
        )

    def want(self, topics: Wanted) -> None:
        self.sync.topics = topics
        self.registrar.note_change()

    def expected(self) -> Wanted:
        return {
            key: SERVICE_URI if key[0] is RegistrationKind.SERVICE else type_ for key, type_ in self.sync.topics.items()
        }


async def registered(names: list[str]) -> World:
    """Return a world whose master knows these names of each kind, and whose registrar runs no more."""
    world = World()
    world.want({(kind, name): "x/X" for kind in KINDS for name in names})
    running = asyncio.get_running_loop().create_task(world.registrar.run())
    await asyncio.sleep(1.0)
    running.cancel()
    return world


NAMES = st.sampled_from(["/a", "/b", "/c"])
GRAPHS = st.dictionaries(st.tuples(st.sampled_from(KINDS), NAMES), st.sampled_from(["x/X", "x/Y"]))
STEPS = st.one_of(
    st.tuples(st.just("want"), GRAPHS),
    st.tuples(st.just("forget"), st.sets(NAMES)),
    st.tuples(st.just("refuse"), st.sets(NAMES)),
    st.tuples(st.just("die"), st.integers(0, 6)),
    st.tuples(st.just("wait"), st.sampled_from([0.0, 0.002, 1.0, 4.0])),
)


@given(st.lists(STEPS), GRAPHS)
@virtual
async def test_any_history_of_master_and_hub_ends_with_what_is_wanted(
    steps: list[tuple[str, Any]], last: Wanted
) -> None:
    world = World()
    running = asyncio.get_running_loop().create_task(world.registrar.run())
    for what, value in steps:
        match what:
            case "want":
                world.want(value)
            case "forget":
                for name in value:
                    for kind in KINDS:
                        world.master.known.pop((kind, name), None)
            case "refuse":
                world.master.refused = value
            case "die":
                world.master.dies_after = value
            case _:
                await asyncio.sleep(value)
    world.master.refused, world.master.dies_after = set(), 1000
    world.want(last)
    await asyncio.sleep(SETTLED_S)
    assert world.master.known == world.expected()
    running.cancel()


@virtual
async def test_services_are_registered_before_topics_and_another_type_over_the_one_before() -> None:
    world = World()
    world.want({(RegistrationKind.SERVICE, "/stop"): "x/X", (RegistrationKind.PUBLISHER, "/odom"): "x/X"})
    running = asyncio.get_running_loop().create_task(world.registrar.run())
    await asyncio.sleep(1.0)
    world.want({(RegistrationKind.SERVICE, "/stop"): "x/X", (RegistrationKind.PUBLISHER, "/odom"): "x/Y"})
    await asyncio.sleep(1.0)
    assert world.master.calls == ["registerService", "registerPublisher", "registerPublisher"]
    await world.registrar.end()
    assert world.master.known == {}
    running.cancel()


@given(st.floats(0.0, 0.1))
@virtual
async def test_end_at_any_moment_leaves_nothing_at_the_master(registering_s: float) -> None:
    world = World()
    world.master.way_s = 0.01
    world.want({(kind, name): "x/X" for kind in KINDS for name in ("/a", "/b")})
    running = asyncio.get_running_loop().create_task(world.registrar.run())
    await asyncio.sleep(registering_s)
    running.cancel()
    await world.registrar.end()
    assert world.master.known == {}


@virtual
async def test_end_waits_for_a_slow_master_and_gives_up_one_that_does_not_answer() -> None:
    world = await registered(["/a", "/b"])
    now_s = asyncio.get_running_loop().time
    world.master.way_s, began_s = 100.0, now_s()
    await world.registrar.end()
    assert now_s() == pytest.approx(began_s + END_TIMEOUT_S)
    assert len(world.master.known) == 6
    world.master.way_s = 0.15
    world.parameters.keys = ["/a", "/b", "/c"]
    await world.registrar.end()
    assert (world.master.known, world.parameters.keys) == ({}, [])


@virtual
async def test_end_at_a_very_slow_master_leaves_the_daemon_most_of_the_time_for_its_end() -> None:
    world = await registered([f"/{number}" for number in range(10)])
    now_s = asyncio.get_running_loop().time
    world.master.way_s, began_s = 0.45, now_s()
    await world.registrar.end()
    assert now_s() < began_s + LONGEST_END_S / 2


@virtual
async def test_name_that_the_master_refuses_is_logged_once_and_tried_again_and_affects_no_other() -> None:
    world = World()
    world.master.refused = {"/a"}
    world.want({(RegistrationKind.PUBLISHER, "/a"): "x/X", (RegistrationKind.PUBLISHER, "/b"): "x/X"})
    running = asyncio.get_running_loop().create_task(world.registrar.run())
    with capture_logs() as logs:
        await asyncio.sleep(10 * STATE_INTERVAL_S)
    assert list(world.master.known) == [(RegistrationKind.PUBLISHER, "/b")]
    assert 8 <= len(world.master.calls) <= 12
    assert [log["name"] for log in logs if log["event"] == "ros1.name_refused"] == ["/a"]
    assert world.master.counts.re_registrations == 0
    running.cancel()


def test_state_of_the_master_has_publishers_subscribers_and_services_in_this_order() -> None:
    state = [[["/a", ["/n"]]], [], [["/s", ["/n", "/m"]]]]
    assert _nodes_by_name(state) == {
        RegistrationKind.PUBLISHER: {"/a": ["/n"]},
        RegistrationKind.SUBSCRIBER: {},
        RegistrationKind.SERVICE: {"/s": ["/n", "/m"]},
    }


@pytest.mark.parametrize(
    "state", [7, [], [[], []], [[], [], [], []], [[7], [], []], [[["/a"]], [], []], [[["/a", 7]], [], []]]
)
def test_state_of_another_form_counts_as_a_lost_master(state: object) -> None:
    with pytest.raises(Unreachable, match="malformed"):
        _nodes_by_name(state)
