"""FoxgloveClient: messages, refusals, and the bounds of its queue."""

import asyncio
import struct
import time
from typing import Any

import pytest

from hostlink.components.gateway.foxglove import (
    BATCH,
    CHANGES_INTERVAL_S,
    CHECK_INTERVAL_S,
    INTERVAL_S,
    NO_GRAPH,
    STEP_S,
    ConnectionGraph,
    graph_update,
)
from hostlink.components.gateway.foxglove_protocol import ServiceCall, decode_frame, encode_message, encode_response
from hostlink.core.hub.node import Role
from hostlink.core.hub.participant import MAX_SUBSCRIPTIONS, Participant
from hostlink.core.hub.queue import MAX_MESSAGES, MAX_RESULTS
from hostlink.core.messages.serialisation import CDR
from hostlink.errors import BadRequest
from tests.support.foxglove_memory import Peer, World, world
from tests.support.virtual_loop import within

SETTLE_S = 0.1  # longer than changes of the graph are collected


def text(data: str) -> bytes:
    return struct.pack("<I", len(data)) + data.encode()


def channel(number: int, topic: str, type_name: str = "std_msgs/String", encoding: str = "ros1") -> dict[str, Any]:
    return {"id": number, "topic": topic, "encoding": encoding, "schemaName": type_name}


async def advertised(peer: Peer, robot: Participant, *topics: str) -> dict[str, int]:
    """Advertise topics of texts; returns the ids of the client's channels, by topic."""
    for topic in topics:
        robot.advertise(topic, "std_msgs/String")
    await asyncio.sleep(SETTLE_S)
    return {each["topic"]: each["id"] for each in peer.channels()}


async def number_of(peer: Peer, topic: str) -> int:
    """Return the id of the channel that is advertised next."""
    await asyncio.sleep(SETTLE_S)
    (found,) = [each["id"] for each in peer.channels() if each["topic"] == topic]
    return int(found)


# -- what a client receives -------------------------------------------------------------------------------------------


@within(world)
async def test_client_first_receives_server_info_and_an_advertisement(here: World) -> None:
    first, second, *_ = here.client().json()
    assert first["op"] == "serverInfo"
    assert first["capabilities"][0] == "clientPublish"
    assert (first["supportedEncodings"], len(first["sessionId"])) == (["ros1"], 16)
    assert second == {"op": "advertise", "channels": []}
    assert "clientPublish" not in here.client(Role.READ).json()[0]["capabilities"]


@within(world)
async def test_channel_has_its_definition_and_a_new_id_after_each_return(here: World) -> None:
    peer, robot = here.client(), here.hub.join("robot")
    robot.advertise("/path", "nav_msgs/Path")
    await asyncio.sleep(SETTLE_S)
    (path,) = [each for each in peer.channels() if each["topic"] == "/path"]
    assert (path["encoding"], path["schemaEncoding"], path["schemaName"]) == ("ros1", "ros1msg", "nav_msgs/Path")
    assert "MSG: geometry_msgs/PoseStamped" in path["schema"]
    robot.unadvertise("/path")
    await asyncio.sleep(SETTLE_S)
    assert {"op": "unadvertise", "channelIds": [path["id"]]} in peer.json()
    robot.advertise("/path", "std_msgs/String")
    assert await number_of(peer, "/path") != path["id"]


@within(world)
async def test_subscription_sends_latched_message_and_unchanged_payloads(here: World) -> None:
    peer, robot = here.client(), here.hub.join("robot")
    robot.advertise("/name", "std_msgs/String", is_latched=True)
    robot.publish("/name", text("kept"))
    peer.send(op="subscribe", subscriptions=[{"id": 9, "channelId": await number_of(peer, "/name")}])
    robot.publish("/name", b"\xff no string at all")
    received = peer.messages()
    assert [(each[:2], each[3]) for each in received] == [
        ((1, 9), text("kept")),
        ((1, 9), b"\xff no string at all"),
    ]
    assert all(stamp_ns > 1_600_000_000_000_000_000 for _, _, stamp_ns, _ in received)
    peer.send(op="unsubscribe", subscriptionIds=[9, 10])
    robot.publish("/name", text("late"))
    assert peer.received() == []


@within(world)
async def test_topic_without_definition_is_reported_once_without_channel(here: World) -> None:
    peer = here.client()
    for number in range(2):
        topic = here.hub.topics.advertise("/lidar", f"link {number}", type_name="maker_msgs/Scan")
        assert topic.type is None
        await asyncio.sleep(SETTLE_S)
        statuses = [each for each in peer.json() if each["op"] == "status"]
        if number == 0:
            (status,) = statuses
            assert (status["level"], status["id"]) == (1, "/lidar")
            assert "maker_msgs/Scan has no definition; put its .msg into a folder" in status["message"]
        else:
            assert statuses == []


@within(world)
async def test_many_channels_are_advertised_in_batches(here: World) -> None:
    robot = here.hub.join_daemon()
    for number in range(3 * BATCH):
        robot.advertise(f"/topic_{number}", "std_msgs/String")
    await asyncio.sleep(SETTLE_S)
    sizes = [len(each["channels"]) for each in here.client().json() if each["op"] == "advertise"]
    assert (max(sizes), sum(sizes)) == (BATCH, 3 * BATCH + 1)


@within(world)
async def test_slow_client_loses_oldest_of_the_topic_that_fills_its_queue(here: World) -> None:
    peer, robot = here.client(), here.hub.join("robot")
    ids = await advertised(peer, robot, "/much", "/rare")
    wanted = [{"id": number, "channelId": ids[topic]} for number, topic in enumerate(("/much", "/rare"))]
    peer.send(op="subscribe", subscriptions=wanted)
    robot.publish("/rare", text("first"))
    for number in range(MAX_MESSAGES + 10):
        robot.publish("/much", text(str(number)))
    assert peer.queue.dropped == 11
    heard = peer.received()
    (told,) = [each["message"] for each in heard if isinstance(each, dict) and each["op"] == "status"]
    assert "messages dropped: 1 (/much 1)" in told
    received = [(*struct.unpack_from("<BIQ", each), each[13:]) for each in heard if isinstance(each, bytes)]
    assert (received[0][1], received[0][3]) == (1, text("first"))
    assert (received[1][3], received[-1][3]) == (text("11"), text(str(MAX_MESSAGES + 9)))


@within(world)
async def test_graph_changes_wait_for_a_client_that_does_not_read(here: World) -> None:
    peer, robot = here.client(), here.hub.join("robot")
    for number in range(3 * MAX_RESULTS):
        robot.advertise("/flaps", "std_msgs/String")
        robot.publish("/flaps", text(str(number)))
        await asyncio.sleep(SETTLE_S)
        peer.client.flush(asyncio.get_running_loop().time())
        robot.unadvertise("/flaps")
        await asyncio.sleep(SETTLE_S)
        peer.client.flush(asyncio.get_running_loop().time())
    assert not peer.queue.is_too_slow
    peer.received()
    now_s = asyncio.get_running_loop().time()
    due_s = peer.client.flush(now_s)
    assert due_s is not None
    assert due_s > now_s + CHANGES_INTERVAL_S  # of the clock alone
    robot.advertise("/flaps", "std_msgs/String")
    await number_of(peer, "/flaps")


# -- time -------------------------------------------------------------------------------------------------------------


async def subscribed(here: World, peer: Peer, topic: str = "/chat") -> Any:
    """Participant that publishes a topic to which the peer has subscribed."""
    robot = here.hub.join("robot")
    robot.advertise(topic, "std_msgs/String")
    peer.send(op="subscribe", subscriptions=[{"id": 5, "channelId": await number_of(peer, topic)}])
    peer.received()
    return robot


def clock(secs: int, nsecs: int = 0) -> bytes:
    return struct.pack("<II", secs, nsecs)


@within(world)
async def test_host_time_is_sent_without_messages(here: World) -> None:
    peer = here.client()
    began_ns = time.time_ns()
    for number in range(10):
        received = peer.received_with_times()
        if number == 0:
            assert "time" in received[0]["capabilities"]
        await asyncio.sleep(INTERVAL_S + STEP_S)
    assert len(peer.times) == 10
    assert peer.times == sorted(set(peer.times))
    assert began_ns <= peer.times[0] <= peer.times[-1] <= time.time_ns()


@within(world)
async def test_time_before_a_message_is_sent_once_for_many(here: World, monkeypatch: pytest.MonkeyPatch) -> None:
    peer = here.client()
    robot = await subscribed(here, peer)
    await asyncio.sleep(2 * STEP_S)
    now_ns = time.time_ns()
    monkeypatch.setattr(time, "time_ns", lambda: now_ns)  # they are of one moment, also if the machine pauses
    for number in range(3):
        robot.publish("/chat", text(str(number)))
    at_ns, first, *others = peer.received_with_times()
    assert struct.unpack_from("<BIQ", first) == (1, 5, at_ns)
    assert [each[13:] for each in others] == [text("1"), text("2")]


@within(world)
async def test_time_displaces_no_message_of_a_client_that_does_not_read(here: World) -> None:
    peer = here.client()
    robot = await subscribed(here, peer)
    for number in range(MAX_MESSAGES):
        robot.publish("/chat", text(str(number)))
        await asyncio.sleep(2 * STEP_S)
        peer.client.flush(asyncio.get_running_loop().time())
    assert peer.queue.dropped == 0
    assert len(peer.messages()) == MAX_MESSAGES


@within(world)
async def test_published_clock_replaces_the_host_time(here: World) -> None:
    peer = here.client()
    robot, simulator = await subscribed(here, peer), here.hub.join("simulator")
    simulator.advertise("/clock", "rosgraph_msgs/Clock")
    await asyncio.sleep(SETTLE_S)
    peer.received()
    simulator.publish("/clock", clock(77, 5))
    assert peer.received_with_times() == [77_000_000_005]
    robot.publish("/chat", text("simulated"))
    ((_, _, stamp_ns, _),) = peer.messages()
    assert stamp_ns == 77_000_000_005
    await asyncio.sleep(5 * INTERVAL_S)
    assert peer.received_with_times() == []  # it has stopped
    simulator.publish("/clock", clock(3))  # it begins again
    assert peer.received_with_times() == [3_000_000_000]
    simulator.publish("/clock", b"no time")
    simulator.leave()
    await asyncio.sleep(SETTLE_S)
    peer.received()
    assert here.hub.topics.find_or_none("/clock") is None
    await asyncio.sleep(INTERVAL_S)
    robot.publish("/chat", text("real"))
    ((_, _, stamp_ns, _),) = peer.messages()
    assert abs(stamp_ns - time.time_ns()) < 60_000_000_000
    assert peer.times[-1] == stamp_ns


@within(world)
async def test_clock_of_another_type_is_ignored(here: World) -> None:
    peer = here.client()
    robot, sketch = await subscribed(here, peer), here.hub.join("sketch")
    sketch.advertise("/clock", "std_msgs/Time")
    await asyncio.sleep(SETTLE_S)
    peer.received()
    sketch.publish("/clock", clock(77))
    robot.publish("/chat", text("now"))
    ((_, _, stamp_ns, _),) = peer.messages()
    assert abs(stamp_ns - time.time_ns()) < 60_000_000_000


@within(world)
async def test_client_at_subscription_limit_keeps_the_host_time(here: World) -> None:
    peer, simulator = here.client(), here.hub.join("simulator")
    for number in range(MAX_SUBSCRIPTIONS):
        peer.client.participant.subscribe(f"/topic_{number}", lambda _: None)
    simulator.advertise("/clock", "rosgraph_msgs/Clock")
    await asyncio.sleep(SETTLE_S)
    peer.received()
    simulator.publish("/clock", clock(77))
    await asyncio.sleep(INTERVAL_S)
    peer.received()
    assert peer.times[-1] > 1_600_000_000_000_000_000


# -- what it may publish ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", [b"", b"\x05\x00\x00\x00abc", text("x") + b"more"])
@within(world)
async def test_payload_that_is_not_one_message_is_refused(here: World, payload: bytes) -> None:
    peer, heard = here.client(), list[bytes]()
    here.hub.join("other").subscribe("/chat", lambda message: heard.append(message.payload))
    peer.send(op="advertise", channels=[channel(1, "/chat")])
    peer.publish(1, payload)
    (status,) = peer.statuses()
    assert "std_msgs/String" in status
    assert heard == []


@within(world)
async def test_payload_of_fixed_size_is_checked_without_decoding(here: World) -> None:
    peer = here.client()
    peer.send(op="advertise", channels=[channel(1, "/cmd", "geometry_msgs/Twist")])
    peer.publish(1, bytes(47))
    assert peer.statuses() == ["geometry_msgs/Twist: 47 bytes instead of 48"]
    peer.publish(1, bytes(48))
    assert {"op": "removeStatus", "statusIds": ["/cmd"]} in peer.json()


@within(world)
async def test_repeated_refusal_is_sent_once_until_a_message_is_accepted(here: World) -> None:
    peer = here.client()
    peer.send(op="advertise", channels=[channel(1, "/chat")])
    for payload in (b"", b"", text("fine"), b""):
        peer.publish(1, payload)
    ops = [each["op"] for each in peer.json() if each["op"] in ("status", "removeStatus")]
    assert ops == ["status", "removeStatus", "status"]


@within(world)
async def test_refusal_is_forgotten_with_its_channel(here: World) -> None:
    peer = here.client()
    for number in range(100):
        peer.send(op="advertise", channels=[channel(1, f"/topic_{number}")])
        peer.publish(1, b"")
        peer.send(op="unadvertise", channelIds=[1])
        removed = [each["statusIds"] for each in peer.json() if each["op"] == "removeStatus"]
        assert removed == [[f"/topic_{number}"]]
    assert not peer.client._refused


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [
        (channel(1, "/other"), "the id 1 is in use"),
        (channel(2, "/other", encoding="json"), "must have the encoding ros1, not 'json'"),
        (channel(2, "/other", "maker_msgs/Scan"), "unknown type maker_msgs/Scan"),
        (channel(2, "/chat", "std_msgs/Int32"), "std_msgs/String"),
    ],
)
@within(world)
async def test_invalid_channel_is_refused_with_the_reason(here: World, wanted: dict[str, Any], reason: str) -> None:
    peer = here.client()
    peer.send(op="advertise", channels=[channel(1, "/chat")])
    peer.send(op="advertise", channels=[wanted])
    (status,) = peer.statuses()
    assert reason in status


@within(world)
async def test_topic_is_withdrawn_with_its_last_channel(here: World) -> None:
    peer = here.client()
    peer.send(op="advertise", channels=[channel(1, "/chat"), channel(2, "chat")])
    for number, is_published in ((1, True), (2, False)):
        peer.send(op="unadvertise", channelIds=[number, 77])
        assert (here.hub.topics.find_or_none("/chat") is not None) is is_published
    peer.publish(1, text("late"))
    assert peer.statuses() == ["publish: the channel 1 is not advertised"]


@within(world)
async def test_client_with_role_read_changes_nothing(here: World) -> None:
    peer = here.client(Role.READ)
    peer.send(op="advertise", channels=[channel(1, "/chat")])
    peer.send(op="setParameters", parameters=[{"name": "/gain", "value": 1}], id="x")
    refused = "the token may only read; use one with the role drive"
    assert [status.partition(": ")[2] for status in peer.statuses()] == [refused] * 2
    assert here.hub.parameters == {}
    assert here.hub.topics.find_or_none("/chat") is None


@within(world)
async def test_all_refusals_of_one_request_have_one_status(here: World) -> None:
    peer = here.client()
    peer.send(op="subscribe", subscriptions=[{"id": number, "channelId": 900 + number} for number in range(500)])
    assert peer.statuses() == ["subscribe: there is no channel 900 (and 499 more)"]
    peer.send(op="subscribe", subscriptions=[{"id": 1, "channelId": 1}] * 1025)
    assert peer.statuses() == ["Expected `array` of length <= 1024 - at `$.subscriptions`"]


@within(world)
async def test_subscription_id_and_channel_are_used_once(here: World) -> None:
    peer, robot = here.client(), here.hub.join("robot")
    ids = await advertised(peer, robot, "/a", "/b")
    for number, topic in ((1, "/a"), (1, "/b"), (2, "/a")):
        peer.send(op="subscribe", subscriptions=[{"id": number, "channelId": ids[topic]}])
    assert peer.statuses() == ["subscribe: the id 1 is in use", "subscribe: /a is subscribed already"]


# -- parameters -------------------------------------------------------------------------------------------------------


def values(peer: Peer) -> list[dict[str, Any]]:
    return [each for each in peer.json() if each["op"] == "parameterValues"]


@within(world)
async def test_parameters_are_read_set_and_removed_with_types(here: World) -> None:
    peer = here.client()
    here.hub.parameters.update({"robot_0/gain": 2.0, "/name": "x", "/list": [1, 2], "/floats": [1.0, 2.0]})
    peer.send(op="getParameters", parameterNames=[], id="all")
    (answer,) = values(peer)
    assert answer["id"] == "all"
    assert answer["parameters"] == [
        {"name": "/robot_0/gain", "value": 2.0, "type": "float64"},
        {"name": "/name", "value": "x"},
        {"name": "/list", "value": [1, 2]},
        {"name": "/floats", "value": [1.0, 2.0], "type": "float64_array"},
    ]
    settings = [
        {"name": "/robot_0/gain", "value": 3, "type": "float64"},
        {"name": "/floats", "value": [1, 2], "type": "float64_array"},
        {"name": "/name"},
    ]
    peer.send(op="setParameters", parameters=settings, id="set")
    assert here.hub.parameters == {"robot_0/gain": 3.0, "/list": [1, 2], "/floats": [1.0, 2.0]}
    assert isinstance(here.hub.parameters["robot_0/gain"], float)
    (answer,) = values(peer)
    assert [each["name"] for each in answer["parameters"]] == ["/robot_0/gain", "/floats"]


@pytest.mark.parametrize(
    "setting",
    [
        {"value": "QUI=", "type": "byte_array"},
        {"value": "x", "type": "float64"},
        {"value": 1, "type": "float64_array"},
        {"value": None},
        {"value": [1, ["x"]]},
        {"value": 10**400, "type": "float64"},
    ],
)
@within(world)
async def test_parameter_that_fits_no_device_is_refused(here: World, setting: dict[str, Any]) -> None:
    peer = here.client()
    peer.send(op="setParameters", parameters=[{"name": "/gain", **setting}])
    assert len(peer.statuses()) == 1
    assert here.hub.parameters == {}


@within(world)
async def test_watched_parameters_are_sent_after_every_change(here: World) -> None:
    peer = here.client()
    here.hub.parameters["/gain"] = 1
    peer.send(op="subscribeParameterUpdates", parameterNames=["/gain", "/later"])
    peer.received()
    here.hub.parameters.update({"gain": 5, "/later": True, "/other": 1})
    del here.hub.parameters["/gain"]
    await asyncio.sleep(CHECK_INTERVAL_S)
    (update,) = values(peer)
    assert update["parameters"] == [{"name": "/gain", "value": 5}, {"name": "/later", "value": True}]
    del here.hub.parameters["/later"]
    await asyncio.sleep(1.0)
    assert values(peer)[0]["parameters"] == [{"name": "/later"}]
    peer.send(op="unsubscribeParameterUpdates", parameterNames=[])
    here.hub.parameters["/gain"] = 6
    await asyncio.sleep(2 * CHECK_INTERVAL_S)
    assert values(peer) == []


@within(world)
async def test_graph_requested_repeatedly_is_sent_at_a_limited_rate(here: World) -> None:
    peer, updates = here.client(), 0
    for _ in range(1000):
        peer.send(op="unsubscribeConnectionGraph")
        peer.send(op="subscribeConnectionGraph")
        updates += sum(each["op"] == "connectionGraphUpdate" for each in peer.json())
        await asyncio.sleep(0.001)
    assert 10 <= updates <= 21


# -- frames and the connection graph ----------------------------------------------------------------------------------


def test_frames_have_the_layout_of_the_specification() -> None:
    assert encode_message(7, 2**63, b"xy").hex() == "010700000000000000000000807879"
    call = ServiceCall(3, 4, "ros1", b"\x01")
    assert encode_response(call).hex() == "03030000000400000004000000726f733101"
    assert decode_frame(b"\x02" + encode_response(call)[1:]) == call


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "unknown opcode None"),
        (b"\x07", "unknown opcode 7"),
        (b"\x01\x00\x00", "3 bytes is shorter than its head"),
        (struct.pack("<BIII", 2, 1, 1, 5) + b"ros1", "whose encoding has 5 bytes"),
    ],
)
def test_invalid_frame_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(BadRequest, match=reason):
        decode_frame(data)


def test_connection_graph_is_sent_as_changes() -> None:
    before = ConnectionGraph({"/a": ("/n",), "/b": ("/n",)}, {"/a": ("/m",)}, {"/s": ("/n",)})
    assert graph_update(before, before) is None
    full = graph_update(NO_GRAPH, before)
    assert full is not None
    assert full["publishedTopics"] == [{"name": "/a", "publisherIds": ("/n",)}, {"name": "/b", "publisherIds": ("/n",)}]
    now = ConnectionGraph({"/a": ("/n", "/o")}, {"/b": ("/m",)}, {})
    assert graph_update(before, now) == {
        "op": "connectionGraphUpdate",
        "publishedTopics": [{"name": "/a", "publisherIds": ("/n", "/o")}, {"name": "/b", "publisherIds": []}],
        "subscribedTopics": [{"name": "/b", "subscriberIds": ("/m",)}, {"name": "/a", "subscriberIds": []}],
        "advertisedServices": [],
        "removedTopics": [],
        "removedServices": ["/s"],
    }
    assert graph_update(before, NO_GRAPH)["removedTopics"] == ["/a", "/b"]  # type: ignore[index]


# -- types without a definition ---------------------------------------------------------------------------------------


@within(world)
async def test_cdr_of_a_type_without_a_definition_is_a_channel_without_a_schema_and_a_warning(here: World) -> None:
    peer = here.client()
    here.hub.topics.advertise("/own", "rosserial", type_name="my_msgs/Own")
    topic = here.hub.topics.advertise("/talk", "board", type_name="my_msgs/Own", raw_encoding=CDR)
    await asyncio.sleep(SETTLE_S)
    sent = peer.json()
    channels = [each for frame in sent if frame["op"] == "advertise" for each in frame["channels"]]
    (channel,) = [each for each in channels if each["topic"] in {"/talk", "/own"}]
    number = channel.pop("id")
    assert channel == {"topic": "/talk", "encoding": "cdr", "schemaName": "my_msgs/msg/Own", "schema": ""}
    warned = [frame["message"] for frame in sent if frame["op"] == "status"]
    assert [text.partition(":")[0] for text in warned] == ["/own", "/talk"]
    peer.send(op="subscribe", subscriptions=[{"id": 7, "channelId": number}])
    topic.publish(b"\0\1\0\0x", source="board")
    topic.encoding = "ros1"  # it changes, and the graph has not reported that yet
    topic.publish(b"not on this channel", source="board")
    topic.encoding, topic.type_name = CDR, "my_msgs/Other"
    topic.publish(b"of another type", source="board")
    topic.type_name = "my_msgs/Own"
    assert [payload for _, _, _, payload in peer.messages()] == [b"\0\1\0\0x"]
    here.hub.topics.leave("board")
    here.hub.topics.advertise("/talk", "other board", type_name="std_msgs/String")
    assert await number_of(peer, "/talk") != number
