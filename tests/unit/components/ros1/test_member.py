"""Graph of ROS 1 and the slave API without sockets: what is registered, connected and answered."""

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.components.ros1 import graph_sync
from hostlink.components.ros1.local_node import RegistrationKind
from hostlink.components.ros1.names import NameResolver
from hostlink.components.ros1.node import HEADER_TIMEOUT_S, KEEPALIVE_S, MAX_AGE_S, Member, SlaveApi
from hostlink.components.ros1.tcpros import encode_header
from hostlink.components.ros1.xml_rpc import CallRefused, decode_answer, encode_call
from hostlink.core.hub.topic import DeviceSubscription
from hostlink.core.messages.catalog import CLOCK_TYPE
from hostlink.core.messages.serialisation import CDR
from tests.support.api_memory import ApiTransport
from tests.support.logs import logged
from tests.support.participants import ROBOT, TEXT, TEXT_TYPE, Scene, play
from tests.support.ros1.wireless import FakeRpc, FakeWire, local_node
from tests.support.virtual_loop import inside

VELOCITY = f"/{ROBOT}/velocity_commands"


class Graph:
    """Member of the graph without a master, and its API."""

    def __init__(self, scene: Scene, **settings: Any) -> None:
        self.scene = scene
        self.node, self.rpc = local_node(scene.hub, scene.tasks, **settings)
        self.member = Member(self.node, NameResolver(), "rosrpc://here:2")
        self.api = SlaveApi(self.member, self.node, ("here", 2))

    @property
    def sync(self) -> graph_sync.GraphSync:
        return self.member.sync

    async def call(self, method: str, *arguments: object) -> Any:
        return decode_answer(await self.api.answer(encode_call(method, arguments)))

    def requested(self) -> list[str]:
        """Addresses of the publishers from which a topic was requested."""
        return [uri for uri, method, _ in self.rpc.calls if method == "requestTopic"]


@contextlib.asynccontextmanager
async def graph(scene: Scene, **settings: Any) -> AsyncIterator[Graph]:
    made = Graph(scene, **settings)
    async with made.member.taking_part():
        await asyncio.sleep(0.2)
        yield made
    assert (made.sync.publications, made.sync.subscriptions, made.sync.offers) == ({}, {}, {})
    assert "ros1" not in scene.hub.isolation.crashes
    await made.node.aclose()


def with_graph(test: Callable[[Graph], Awaitable[None]], **settings: Any) -> None:
    async def run(scene: Scene) -> None:
        async with graph(scene, **settings) as made:
            await test(made)

    play(run)


@inside(with_graph)
async def test_topics_and_services_of_the_hub_are_wanted_at_the_master_services_first(made: Graph) -> None:
    wanted = made.sync.wanted()
    assert wanted[RegistrationKind.PUBLISHER, TEXT] == TEXT_TYPE
    assert wanted[RegistrationKind.SUBSCRIBER, VELOCITY] == "geometry_msgs/Twist"
    assert wanted[RegistrationKind.SERVICE, "/neighbour"] == "std_srvs/Trigger"
    kinds = [kind for kind, _ in wanted]
    assert kinds == sorted(
        kinds, key=[RegistrationKind.SERVICE, RegistrationKind.PUBLISHER, RegistrationKind.SUBSCRIBER].index
    )
    assert (RegistrationKind.SUBSCRIBER, TEXT) not in wanted


@inside(with_graph)
async def test_slave_api_lists_publications_subscriptions_and_connections(made: Graph) -> None:
    assert [TEXT, TEXT_TYPE] in await made.call("getPublications", "/x")
    assert [VELOCITY, "geometry_msgs/Twist"] in await made.call("getSubscriptions", "/x")
    assert await made.call("getMasterUri", "/x") == "http://master:11311/"
    assert await made.call("getPid", "/x") == os.getpid()
    assert await made.call("getBusStats", "/x") == [[], [], []]
    await made.call("publisherUpdate", "/master", VELOCITY, ["http://a:1/"])
    assert await made.call("getBusInfo", "/x") == [[0, "http://a:1/", "i", "TCPROS", VELOCITY, False]]


@inside(with_graph)
async def test_slave_api_names_the_port_of_a_published_topic_only(made: Graph) -> None:
    assert await made.call("requestTopic", "/x", TEXT, [["TCPROS"]]) == ["TCPROS", "here", 2]
    with pytest.raises(CallRefused, match="not a publisher of /unknown"):
        await made.call("requestTopic", "/x", "/unknown", [["TCPROS"]])
    for protocols in ([], [["UDPROS"]], [[]], ["TCPROS"]):
        with pytest.raises(CallRefused, match="no supported protocol"):
            await made.call("requestTopic", "/x", TEXT, protocols)


@pytest.mark.parametrize(
    "call",
    [
        ("unknownMethod", "/x"),
        ("getPid",),
        ("paramUpdate", "/x", 5, 1),
        ("publisherUpdate", "/x", VELOCITY, "http://a:1/"),
        ("publisherUpdate", "/x", VELOCITY, [5]),
        ("publisherUpdate", "/x", 5, []),
        ("requestTopic", "/x", TEXT, 7),
    ],
)
@inside(with_graph)
async def test_malformed_call_is_refused_and_counted(made: Graph, call: tuple[Any, ...]) -> None:
    with pytest.raises(CallRefused):
        await made.call(*call)
    assert made.node.counts.refused_calls == 1


@inside(with_graph)
async def test_shutdown_ends_the_node_with_the_reason_of_the_first_call(made: Graph) -> None:
    assert not made.member.ended.done()
    await made.call("shutdown", "/rosnode", "bye")
    await made.call("shutdown", "/rosnode", "again")
    assert await made.member.ended == "/rosnode: bye"


@inside(with_graph)
async def test_publishers_are_connected_and_disconnected_as_the_master_names_them(made: Graph) -> None:
    made.sync.set_publishers(VELOCITY, ["http://a:1/", made.node.uri], is_answer=True)
    await asyncio.sleep(0.01)
    assert made.requested() == ["http://a:1/"]
    made.sync.set_publishers(VELOCITY, ["http://b:1/"], is_answer=False)
    await asyncio.sleep(0.01)
    assert set(made.sync.subscriptions[VELOCITY].publishers) == {"http://b:1/"}
    made.sync.set_publishers(VELOCITY, ["http://c:1/"], is_answer=True)
    assert set(made.sync.subscriptions[VELOCITY].publishers) == {"http://b:1/", "http://c:1/"}
    made.sync.set_publishers("/unknown", ["http://a:1/"], is_answer=False)
    assert "/unknown" not in made.sync.subscriptions


@inside(with_graph)
async def test_publisher_named_with_the_first_answer_is_not_new_and_a_later_one_is(made: Graph) -> None:
    subscription = made.sync.subscriptions[VELOCITY]
    made.sync.set_publishers(VELOCITY, ["http://a:1/"], is_answer=True)
    assert subscription.publishers["http://a:1/"]._new_until_s == 0.0
    made.sync.set_publishers(VELOCITY, ["http://a:1/", "http://b:1/"], is_answer=False)
    assert subscription.publishers["http://b:1/"]._new_until_s > 0.0
    made.sync.set_publishers(VELOCITY, ["http://c:1/"], is_answer=False)
    assert subscription.publishers["http://c:1/"]._new_until_s > 0.0


@inside(with_graph)
async def test_change_before_the_first_answer_leaves_publishers_old(made: Graph) -> None:
    subscription = made.sync.subscriptions[VELOCITY]
    made.sync.set_publishers(VELOCITY, ["http://a:1/"], is_answer=False)
    made.sync.set_publishers(VELOCITY, ["http://a:1/", "http://b:1/"], is_answer=False)
    assert subscription.publishers["http://b:1/"]._new_until_s == 0.0


@inside(with_graph)
async def test_topic_with_another_type_is_subscribed_anew_with_the_known_publishers(made: Graph) -> None:
    reader = made.scene.hub.join("reader")
    reader.subscribe("/plan", lambda _: None, type_name=TEXT_TYPE)
    await asyncio.sleep(0.2)
    made.sync.set_publishers("/plan", ["http://a:1/"], is_answer=True)
    before = made.sync.subscriptions["/plan"]
    reader.leave()
    other = made.scene.hub.join("other")
    other.subscribe("/plan", lambda _: None, type_name="std_msgs/Bool")
    await asyncio.sleep(0.2)
    after = made.sync.subscriptions["/plan"]
    assert after is not before
    assert (list(after.publishers), after.is_registered) == (["http://a:1/"], True)
    assert after.publishers["http://a:1/"]._new_until_s == 0.0
    assert before.publishers == {}
    other.leave()
    await asyncio.sleep(0.2)
    assert "/plan" not in made.sync.subscriptions


@inside(with_graph, max_connections=2)
async def test_publishers_over_the_bounds_are_counted(made: Graph, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_sync, "MAX_NAMED", 3)
    made.sync.set_publishers(VELOCITY, [f"http://a:{port}/" for port in range(1, 6)], is_answer=False)
    await asyncio.sleep(0.01)
    assert made.node.counts.crowded_out == 2 + 1  # over the named ones, and over the connections
    assert len(made.requested()) == 2


@inside(with_graph)
async def test_publisher_that_was_left_out_of_a_full_list_is_not_new(
    made: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A publisher that finds room may be in the middle of its motion."""
    monkeypatch.setattr(graph_sync, "MAX_NAMED", 3)
    subscription = made.sync.subscriptions[VELOCITY]
    uris = [f"http://a:{port}/" for port in range(1, 6)]
    made.sync.set_publishers(VELOCITY, [], is_answer=True)
    made.sync.set_publishers(VELOCITY, uris[:4], is_answer=False)
    made.sync.set_publishers(VELOCITY, uris[2:4], is_answer=False)
    assert subscription.publishers[uris[3]]._new_until_s == 0.0
    made.sync.set_publishers(VELOCITY, uris[2:], is_answer=False)
    assert subscription.publishers[uris[4]]._new_until_s > 0.0


@inside(with_graph)
async def test_publishers_of_one_topic_have_a_bound(made: Graph) -> None:
    uris = [f"http://a:{port}/" for port in range(900)]
    made.sync.set_publishers(VELOCITY, uris, is_answer=False)
    assert made.node.counts.crowded_out == 900 - graph_sync.MAX_PUBLISHERS
    made.sync.set_publishers(VELOCITY, [], is_answer=False)
    made.sync.set_publishers(VELOCITY, uris[:2], is_answer=False)
    assert made.node.counts.crowded_out == 900 - graph_sync.MAX_PUBLISHERS


@inside(with_graph)
async def test_failed_publisher_is_tried_again_with_growing_delays(made: Graph) -> None:
    made.sync.set_publishers(VELOCITY, ["http://a:1/"], is_answer=False)
    await asyncio.sleep(0.05)
    assert len(made.requested()) == 1
    await asyncio.sleep(0.1)
    assert len(made.requested()) == 2
    await asyncio.sleep(60.0)
    assert 8 <= len(made.requested()) <= 16


@inside(with_graph)
async def test_service_of_another_node_is_looked_up_and_own_and_tool_services_are_not(made: Graph) -> None:
    found = {"/reset": "/gazebo", "/own": made.node.name, "/gazebo/get_loggers": "/gazebo"}
    made.member._registrar._on_services(found)
    await asyncio.sleep(0.05)
    lookups = [arguments for _, method, arguments in made.rpc.calls if method == "lookupService"]
    assert lookups == [(made.node.name, "/reset")]


@inside(with_graph)
async def test_connection_to_an_unknown_topic_is_refused_and_to_a_known_one_accepted(made: Graph) -> None:
    publication, unknown, malformed, wrong = FakeWire(), FakeWire(), FakeWire(), FakeWire()
    md5 = made.sync.publications[TEXT].type.md5
    header = {"callerid": "/listener", "md5sum": md5, "type": TEXT_TYPE}
    made.sync.accept(publication.wire, [encode_header(header | {"topic": TEXT})[4:]])
    assert publication.refusals == []
    assert not publication.is_replaceable
    made.sync.accept(unknown.wire, [encode_header(header | {"service": "/none"})[4:]])
    assert unknown.refusals == ["/hostlink has no service /none"]
    made.sync.accept(malformed.wire, [b"\x05"])
    assert len(malformed.refusals) == 1
    made.sync.accept(wrong.wire, [encode_header(header | {"topic": TEXT, "md5sum": "0"})[4:], b"more"])
    assert "not 0" in wrong.refusals[0]
    assert made.node.counts.refused_headers == 3


@inside(with_graph)
async def test_connection_without_a_header_is_closed_after_a_time(made: Graph) -> None:
    silent, known = made.member.make_wire(), made.member.make_wire()
    md5 = made.sync.publications[TEXT].type.md5
    for wire in (silent, known):
        transport = ApiTransport("10.0.0.9")
        transport.protocol = wire
        wire.connection_made(transport)
    header = {"callerid": "/listener", "md5sum": md5, "type": TEXT_TYPE, "topic": TEXT}
    known.data_received(encode_header(header))
    await asyncio.sleep(HEADER_TIMEOUT_S - 0.1)
    assert (silent.is_closed, known.is_closed) == (False, False)
    await asyncio.sleep(0.2)
    assert (silent.is_closed, known.is_closed) == (True, False)
    assert made.node.counts.refused_headers == 1
    known.close()


@inside(with_graph)
async def test_connection_to_the_slave_api_is_closed_after_its_largest_age(made: Graph) -> None:
    async with made.api.serving() as make_protocol:
        protocol: Any = make_protocol()
        transport = ApiTransport("10.0.0.9")
        transport.protocol = protocol
        protocol.connection_made(transport)
        await asyncio.sleep(KEEPALIVE_S / 2)
        protocol.data_received(b"POST / HTTP/1.1\r\nHost: here\r\nContent-Length: 9\r\n\r\nno xml...")
        await asyncio.sleep(0.1)
        assert b"faultString" in transport.written
        assert made.node.counts.refused_calls == 1
        await asyncio.sleep(MAX_AGE_S + 1.0)
        assert transport.is_closed


@inside(with_graph)
async def test_idle_connection_to_the_slave_api_gives_its_place_to_another(made: Graph) -> None:
    async with made.api.serving() as make_protocol:
        assert make_protocol().is_replaceable


@inside(with_graph)
async def test_parameter_update_is_kept_for_subscribed_keys(made: Graph) -> None:
    made.rpc.answer = lambda _uri, _method: 5
    assert await made.member.parameters.get("gain") == 5
    await made.call("paramUpdate", "/master", "/gain", 7)
    assert await made.member.parameters.get("gain") == 7
    assert [method for _, method, _ in made.rpc.calls] == ["subscribeParam"]
    made.rpc.answer = FakeRpc.refuse
    assert await made.member.parameters.get("unknown") is None


@inside(with_graph)
async def test_clock_of_another_type_ends_nothing_and_is_tried_again(made: Graph) -> None:
    made.scene.neighbour.advertise("/clock", TEXT_TYPE)
    made.rpc.answer = lambda _uri, _method: True
    with capture_logs() as logs:
        await made.member.parameters.renew()
    assert logged(logs) == ["ros1.clock_unusable"]
    assert made.scene.hub.links.wall_ns() == 0
    await asyncio.sleep(0.2)
    tries: list[object] = []
    made.member._sim_time._clock._on_refusal = tries.append
    await asyncio.sleep(1.0)
    assert tries == []  # a try does not change the graph, or it would cause the next one
    made.scene.neighbour.unadvertise("/clock")
    await asyncio.sleep(0.2)
    made.scene.neighbour.advertise("/clock", CLOCK_TYPE)
    made.scene.neighbour.publish("/clock", bytes([7, 0, 0, 0, 1, 0, 0, 0]))
    assert made.scene.hub.links.wall_ns() == 7_000_000_001


@pytest.mark.parametrize(("value", "is_simulated"), [(True, True), (1, True), (False, False), ("true", False)])
@inside(with_graph)
async def test_time_of_clock_is_used_while_use_sim_time_is_set(made: Graph, value: object, is_simulated: bool) -> None:
    made.rpc.answer = lambda _uri, _method: value
    await made.member.parameters.renew()
    assert (made.scene.hub.links.wall_ns() == 0) is is_simulated
    await made.call("paramUpdate", "/master", "/use_sim_time", False)
    assert made.scene.hub.links.wall_ns() > 0


@inside(with_graph)
async def test_cdr_of_a_type_without_a_definition_is_not_offered_and_logged_with_the_reason(made: Graph) -> None:
    with capture_logs() as lines:
        hub = made.scene.hub
        hub.topics.advertise("/talk", "board", type_name="my_msgs/Own", raw_encoding=CDR)
        hub.topics.subscribe_device(
            "/listen", "board", DeviceSubscription(print, is_gate=False), type_name="my_msgs/Own", raw_encoding=CDR
        )
        await asyncio.sleep(0.2)
    assert not {"/talk", "/listen"} & {name for _, name in made.sync.wanted()}
    (line,) = [each for each in lines if each["event"] == "ros1.topic_unknown"]
    assert (line["topic"], line["type"]) == ("/talk", "my_msgs/Own")
    assert line["reason"].endswith("ROS 1 cannot read it; put its .msg into a folder named in message_folders")
    hub.topics.leave("board")
