"""rosbridge's operations on the wire: invalid fields, status levels, binary messages, drive and watch_graph."""

import asyncio
import base64
import json
import struct
from typing import Any

import cbor2
import pytest

from hostlink.components.gateway.clients import MAX_MESSAGES
from hostlink.components.gateway.rosbridge import (
    MAX_ADVERTISED,
    MAX_PARTS,
    MAX_SUBSCRIPTIONS,
    MAX_TEXT,
    MAX_UNKNOWN_OPS,
)
from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.hub.node import Role
from hostlink.core.hub.queue import MAX_RESULTS
from hostlink.core.hub.robots import Robots
from hostlink.core.robot.state import MAX_PRIORITY
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.transport.base import READ_BYTES
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.api_memory import ApiMemory, ApiPeer, api_in_memory, text_frame
from tests.support.participants import VELOCITY_ID
from tests.support.remote_robots import connected_robot
from tests.support.rosbridge_memory import Peer, world
from tests.support.virtual_loop import within
from tests.support.waiting import expect

CHAT = {"topic": "/chat", "type": "std_msgs/String"}
VELOCITY = "/robot_0/velocity_commands"
MANY_MESSAGES = 900  # within the allowed rate


def statuses(peer: Peer) -> list[str]:
    return [frame["msg"] for frame in peer.received() if frame["op"] == "status"]


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        ({"op": 7}, "7: op must be a text"),
        ({"op": ""}, "op must be a text"),
        ({"op": "subscribe"}, "subscribe: topic must be a text"),
        ({"op": "subscribe", "topic": 7}, "topic must be a text"),
        ({"op": "subscribe", "topic": "x" * (MAX_TEXT + 1)}, f"topic is longer than {MAX_TEXT} characters"),
        ({"op": "subscribe", "topic": "/a", "id": []}, "id must be a number, or a text of at most"),
        ({"op": "subscribe", "topic": "/a", "id": "x" * (MAX_TEXT + 1)}, "id must be a number, or a text of at most"),
        ({"op": "subscribe", "topic": "/a", "type": 7}, "type must be a text"),
        ({"op": "subscribe", "topic": "/a", "throttle_rate": -1}, "throttle_rate must be a number of 0 or more"),
        ({"op": "subscribe", "topic": "/a", "throttle_rate": True}, "throttle_rate must be a number of 0 or more"),
        ({"op": "subscribe", "topic": "/a", "queue_length": "1"}, "queue_length must be a number of 0 or more"),
        ({"op": "publish", **CHAT, "msg": []}, "publish: msg must be an object"),
        ({"op": "publish", **CHAT, "priority": True}, f"priority must be an integer from 0 to {MAX_PRIORITY}"),
        ({"op": "publish", **CHAT, "priority": 1.0}, f"priority must be an integer from 0 to {MAX_PRIORITY}"),
        ({"op": "publish", **CHAT, "priority": -1}, f"priority must be an integer from 0 to {MAX_PRIORITY}"),
        ({"op": "publish", **CHAT, "priority": MAX_PRIORITY + 1}, f"an integer from 0 to {MAX_PRIORITY}"),
        ({"op": "publish", **CHAT, "raw": "?"}, "raw must be base64"),
        ({"op": "publish", **CHAT, "raw": 7}, "raw must be base64"),
        ({"op": "publish", **CHAT, "raw": base64.b64encode(b"\5\0\0\0x").decode()}, "std_msgs/String"),
        ({"op": "fragment", "num": 0, "total": 1, "data": "x"}, "fragment: id and data are required"),
        ({"op": "fragment", "id": "f", "num": 0, "total": 1, "data": 7}, "fragment: id and data are required"),
        ({"op": "fragment", "id": "f", "total": 1, "data": "x"}, "num must be an integer"),
        ({"op": "set_level", "level": "loud"}, "level must be one of info, warning, error, none"),
    ],
)
async def test_operation_with_an_invalid_field_is_refused_by_its_name(request_: dict[str, Any], reason: str) -> None:
    async with world() as here:
        peer = here.client()
        peer.send(**request_)
        (status,) = statuses(peer)
        assert reason in status


@pytest.mark.parametrize("text", ["{", "[]", "{}", '{"id": 1}', "[" * 100_000, b"\xff"])
async def test_message_that_is_not_an_operation_is_refused(text: str | bytes) -> None:
    async with world() as here:
        peer = here.client()
        peer.client.receive(text)
        (status,) = statuses(peer)
        assert status.startswith(("invalid JSON", 'a message is a JSON object with an "op"'))


async def test_largest_valid_values_are_accepted() -> None:
    async with world() as here:
        peer = here.client()
        peer.send(op="subscribe", topic="/" + "x" * (MAX_TEXT - 1), id="i" * MAX_TEXT, type=None, throttle_rate=None)
        peer.send(op="publish", **CHAT, msg={"data": "x"}, priority=MAX_PRIORITY)
        peer.send(op="publish", **CHAT, msg={"data": "x"}, priority=0)
        assert peer.received() == []


@pytest.mark.parametrize(("level", "heard"), [("info", 2), ("warning", 2), ("error", 1), ("none", 0), (None, 0)])
async def test_client_receives_statuses_of_its_level_and_above(level: str | None, heard: int) -> None:
    """A client that has set no level receives only statuses of refused velocities."""
    async with world() as here:
        peer = here.client()
        if level is None:
            peer.client._status_from = None
        else:
            peer.send(op="set_level", level=level)
        peer.send(op="service_response", id="1", service="/none", values={}, result=True)  # a warning
        peer.send(op="dance")  # an error
        assert len(peer.received()) == heard


async def test_status_has_the_id_of_its_request_as_text() -> None:
    async with world() as here:
        peer = here.client()
        for request_id in ("a", 7, None):
            peer.send(op="dance", id=request_id)
        assert [frame.get("id") for frame in peer.received()] == ["a", "7", None]


async def test_reading_client_may_only_read() -> None:
    async with world() as here:
        peer = here.client()
        peer.client.participant.role = Role.READ
        for op in ("advertise", "publish", "advertise_service"):
            peer.send(op=op, **CHAT, msg={}, service="/s")
            (status,) = peer.received()
            assert (status["level"], status["kind"], op in status["msg"]) == ("error", "NoRole", True)
        peer.send(op="drive", id="1", robot="robot_0", linear=0.1, angular=0.0)
        (answer,) = peer.received()
        assert answer == {
            "op": "drive_result",
            "id": "1",
            "result": False,
            "kind": "NoRole",
            "reason": "drive: the token may only read; use one with the role drive",
        }
        peer.send(op="subscribe", topic="/chat")
        peer.send(op="unsubscribe", topic="/chat")
        peer.send(op="call_service", service="/rosapi/get_time")
        (answer,) = await peer.answers()
        assert answer["result"] is True


async def test_subscriptions_and_topics_of_a_client_are_bounded() -> None:
    async with world() as here:
        peer = here.client()
        for number in range(MAX_SUBSCRIPTIONS):
            peer.send(op="subscribe", topic=f"/t{number}", id=number)
        assert statuses(peer) == []
        peer.send(op="subscribe", topic="/t0", id=0)  # known
        assert statuses(peer) == []
        peer.send(op="subscribe", topic="/t0", id="one more")
        assert statuses(peer) == [f"more than {MAX_SUBSCRIPTIONS} subscriptions"]
        for number in range(MAX_ADVERTISED):
            peer.send(op="advertise", topic=f"/a{number}", type="std_msgs/Bool")
        assert statuses(peer) == []
        peer.send(op="advertise", topic="/one_more", type="std_msgs/Bool")
        assert statuses(peer) == [f"more than {MAX_ADVERTISED} topics advertised"]


async def test_unknown_operations_are_refused_always_and_logged_a_few_times() -> None:
    async with world() as here:
        peer = here.client()
        for number in range(MAX_UNKNOWN_OPS + 3):
            peer.send(op=f"dance_{number}")
        assert len(peer.received()) == MAX_UNKNOWN_OPS + 3
        assert len(peer.client._unknown_ops) == MAX_UNKNOWN_OPS


async def test_goal_of_an_action_is_answered_as_aborted() -> None:
    async with world() as here:
        peer = here.client()
        peer.send(op="send_action_goal", id="g", action="/dock")
        assert peer.received() == [
            {
                "op": "action_result", "action": "/dock", "values": "actions are unsupported", "status": 6,
                "result": False, "id": "g",
            }
        ]  # fmt: skip


async def test_cbor_has_numbers_as_typed_arrays_also_in_nested_messages() -> None:
    async with world() as here:
        listener, speaker = here.client(), here.client()
        listener.send(op="subscribe", topic="/scan", type="std_msgs/Float32MultiArray", compression="cbor")
        layout = {"dim": [{"label": "x", "size": 2, "stride": 2}], "data_offset": 3}
        speaker.send(
            op="publish", topic="/scan", type="std_msgs/Float32MultiArray", msg={"data": [1.5, -2], "layout": layout}
        )
        (frame,) = listener.received()
        assert (frame["op"], frame["topic"], frame["msg"]["layout"]) == ("publish", "/scan", layout)
        assert frame["msg"]["data"] == cbor2.CBORTag(85, struct.pack("<2f", 1.5, -2.0))


async def test_cbor_raw_has_the_serialised_message_and_its_time() -> None:
    async with world() as here:
        listener, speaker = here.client(), here.client()
        listener.send(op="subscribe", **CHAT, compression="cbor-raw")
        speaker.send(op="publish", **CHAT, raw=base64.b64encode(b"\2\0\0\0hi").decode())
        (frame,) = listener.received()
        assert frame["msg"]["bytes"] == b"\2\0\0\0hi"
        assert frame["msg"]["secs"] > 1_500_000_000
        assert 0 <= frame["msg"]["nsecs"] < 1_000_000_000


async def test_message_with_too_many_parts_with_times_is_refused() -> None:
    async with world() as here:
        listener, speaker = here.client(), here.client()
        listener.send(op="subscribe", topic="/path", type="nav_msgs/Path")
        for count, is_right in ((MAX_PARTS // 2 - 1, True), (MAX_PARTS, False)):
            speaker.send(op="publish", topic="/path", type="nav_msgs/Path", msg={"poses": [{}] * count})
            (refused, heard) = (statuses(speaker), listener.received())
            assert (len(refused), len(heard)) == ((0, 1) if is_right else (1, 0))


# -- with a robot -----------------------------------------------------------------------------------------------------


async def ask(peer: ApiPeer, **fields: Any) -> Any:
    """Send one operation and return its only answer."""
    peer.send_text(**fields)
    await asyncio.sleep(0.05)
    (answer,) = peer.texts()
    return answer


@within(api_in_memory)
async def test_drive_is_answered_with_link_epoch_and_client(api: ApiMemory) -> None:
    peer, robot = await api.web_socket(), api.hub.robots.find("robot_0")
    answer = await ask(peer, op="drive", id="1", robot="robot_0", linear=0.2, angular=0.5, linear_y=0.0)
    assert (answer["op"], answer["id"], answer["result"], answer["link"]) == ("drive_result", "1", True, 1)
    assert (answer["stops"], answer["epoch"]) == (robot.admission.epoch, robot.admission.epoch)
    assert answer["velocity"] == {"linear_m_s": 0.2, "linear_y_m_s": 0.0, "angular_rad_s": 0.5}
    assert answer["client"].startswith("client ")
    assert struct.unpack("<6d", api.device.payloads(VELOCITY_ID)[-1]) == (0.2, 0.0, 0.0, 0.0, 0.0, 0.5)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({}, "linear (m/s) or angular (rad/s) is missing"),
        ({"linear": "fast", "angular": 0}, "linear"),
        ({"linear": 0, "angular": 0, "priority": -1}, f"priority must be a number from 0 to {MAX_PRIORITY}"),
        ({"linear": 0, "angular": 0, "priority": MAX_PRIORITY + 1}, "priority must be a number from 0"),
        ({"linear": 0, "angular": 0, "robot": "robot_9"}, "robot_9"),
    ],
)
@within(api_in_memory)
async def test_drive_with_an_invalid_field_is_refused(api: ApiMemory, fields: dict[str, Any], reason: str) -> None:
    peer = await api.web_socket()
    answer = await ask(peer, **({"op": "drive", "id": 7, "robot": "robot_0"} | fields))
    assert (answer["result"], answer["id"]) == (False, 7)
    assert reason in answer["reason"]


@within(api_in_memory)
async def test_drive_of_a_locked_or_driven_robot_is_refused_with_epoch_and_holder(api: ApiMemory) -> None:
    first, second = await api.web_socket(), await api.web_socket()
    velocity = {"op": "drive", "robot": "robot_0", "linear": 0.1, "angular": 0.0}
    driven = await ask(first, **velocity, priority=60)
    answer = await ask(second, **velocity, priority=50)
    assert (answer["kind"], answer["holder"]) == ("held", driven["client"])
    robot = api.hub.robots.find("robot_0")
    robot.lock("test")
    answer = await ask(second, **velocity)
    assert (answer["kind"], answer["holder"], answer["epoch"]) == ("locked", None, robot.admission.epoch)


@within(api_in_memory)
async def test_operations_that_find_no_room_wait_in_the_socket(api: ApiMemory) -> None:
    """Decoded messages take several times the memory of their bytes."""
    peer = await api.web_socket()
    peer.reading.pause_writing()  # the client does not read its answers
    messages = [
        text_frame(op="drive", robot=f"absent_{100 + number}", linear=0.1, angular=0.0)
        for number in range(MANY_MESSAGES)
    ]
    peer.send(b"".join(messages))
    await asyncio.sleep(0.1)
    read = MANY_MESSAGES - len(peer.unread) // len(messages[0])
    assert MAX_MESSAGES < read < MAX_MESSAGES + MAX_RESULTS // 2 + 2 * READ_BYTES // len(messages[0])
    peer.reading.resume_writing()
    await asyncio.sleep(1.0)
    assert (len(peer.texts()), len(peer.unread)) == (MANY_MESSAGES, 0)


@within(api_in_memory)
async def test_zero_behind_a_burst_of_velocities_is_the_last_that_the_device_gets(api: ApiMemory) -> None:
    """A connection that drives is read to its end, in the same moment, although not in one read."""
    peer = await api.web_socket()
    velocity = {"op": "drive", "robot": "robot_0", "angular": 0.0}
    began_s = asyncio.get_running_loop().time()
    linear = [0.1 + number / 1e5 for number in range(MANY_MESSAGES)] + [0.0]
    peer.send(b"".join(text_frame(**velocity, linear=each) for each in linear))
    await expect(lambda: not peer.unread)
    assert asyncio.get_running_loop().time() - began_s < 0.1
    await asyncio.sleep(0.01)
    assert struct.unpack("<6d", api.device.payloads(VELOCITY_ID)[-1]) == 6 * (0.0,)


@pytest.mark.parametrize(("link", "is_moved"), [(0, False), (1, True), (2, False)])
@within(api_in_memory)
async def test_drive_for_another_connection_of_the_device_has_an_earlier_epoch(
    api: ApiMemory, link: int, is_moved: bool
) -> None:
    peer, robot = await api.web_socket(), api.hub.robots.find("robot_0")
    answer = await ask(
        peer, op="drive", robot="robot_0", linear=0.1, angular=0.0, link=link, epoch=robot.admission.epoch
    )
    assert answer["result"] is is_moved


@pytest.mark.parametrize("motion", [{"epoch": -1}, {"stops": -1}, {"link": 0}])
@within(api_in_memory)
async def test_drive_that_waits_behind_one_of_another_epoch_continues_its_motion(
    api: ApiMemory, motion: dict[str, int]
) -> None:
    peer, robot = await api.web_socket(), api.hub.robots.find("robot_0")
    velocity = {"op": "drive", "robot": "robot_0", "linear": 0.1, "angular": 0.0}
    peer.send_text(**velocity, **motion)  # the daemon executes nothing before all of them wait
    peer.send_text(**velocity)
    peer.send_text(**velocity)
    await asyncio.sleep(0.05)
    answers = peer.texts()
    assert [each["kind"] for each in answers] == ["disarmed"] * 3
    assert robot.gate.owner is None


class LeavingHosts:
    """Another daemon, which refuses a command when its robot is not known any longer."""

    def __init__(self, robots: Robots) -> None:
        self._robots = robots

    def drive(self, *_: object, **__: object) -> None: ...

    def release(self, _: object) -> None: ...

    async def answer(self, robot: AnyRobot, _: object) -> PlanarVelocity:
        self._robots.pop_remote(robot.name)
        raise CommandRefused(robot.name, RefusalKind.HELD, "another drives it")


@within(api_in_memory)
async def test_drive_is_answered_also_when_its_robot_is_forgotten_before_its_refusal(api: ApiMemory) -> None:
    peer = await api.web_socket()
    robot = connected_robot(api.hub, "robot_7", LeavingHosts(api.hub.robots))
    answer = await ask(peer, op="drive", robot="robot_7", linear=0.1, angular=0.0)
    assert (answer["kind"], answer["epoch"]) == ("held", robot.admission.epoch)
    assert (await ask(peer, op="drive", robot="robot_0", linear=0.1, angular=0.0))["result"]


@within(api_in_memory)
async def test_client_without_a_level_hears_of_refused_velocities_at_a_limited_rate(api: ApiMemory) -> None:
    peer = await api.web_socket()
    api.hub.robots.find("robot_0").lock("test")
    for _ in range(3):
        peer.send_text(op="publish", topic=VELOCITY, msg={"linear": {"x": 0.1}})
        await asyncio.sleep(0.01)
    peer.send_text(op="publish", topic="/none", msg={})
    await asyncio.sleep(0.05)
    (status,) = peer.texts()
    assert (status["op"], status["level"], status["kind"]) == ("status", "error", "locked")
    api.hub.robots.find("robot_0").unlock()
    peer.send_text(op="publish", topic=VELOCITY, msg={"linear": {"x": 0.1}})
    await asyncio.sleep(0.05)
    (status,) = peer.texts()  # another reason is told at once: a program answers it
    assert (status["op"], status["kind"]) == ("status", "disarmed")


@within(api_in_memory)
async def test_watched_graph_is_sent_at_once_and_after_each_change(api: ApiMemory) -> None:
    peer = await api.web_socket()
    peer.send_text(op="watch_graph")
    await asyncio.sleep(0.1)
    (graph,) = peer.texts()
    (robot,) = graph["robots"]
    assert (robot["name"], robot["link"]) == ("robot_0", 1)
    assert robot["velocity_topics"] == {
        VELOCITY: "geometry_msgs/Twist",
        "/robot_0/cmd_vel": "geometry_msgs/Twist",
        "/robot_0/cmd_vel_stamped": "geometry_msgs/TwistStamped",
    }
    topics = {topic["name"]: topic for topic in graph["topics"]}
    assert topics[VELOCITY] == {
        "name": VELOCITY, "type": "geometry_msgs/Twist", "published": False, "subscribed": True,
        "latched": False, "velocity": True, "encoding": "ros1",
    }  # fmt: skip
    assert (topics["/robot_0/odometry"]["published"], topics["/robot_0/odometry"]["velocity"]) == (True, False)
    assert {"name": "/robot_0/lock", "type": "std_srvs/Trigger"} in graph["services"]
    await asyncio.sleep(1.0)
    assert peer.texts() == []
    other = api.hub.join("program")
    other.advertise("/door", "std_msgs/Bool", is_latched=True)
    await asyncio.sleep(0.1)
    (graph,) = peer.texts()
    (door,) = (topic for topic in graph["topics"] if topic["name"] == "/door")
    assert (door["published"], door["latched"], door["subscribed"]) == (True, True, False)
    await api.device.aclose()
    await asyncio.sleep(1.0)
    assert peer.texts()[-1]["robots"][0]["link"] is None


@within(api_in_memory)
async def test_fragments_of_a_velocity_are_executed_as_one_message(api: ApiMemory) -> None:
    peer = await api.web_socket()
    text = json.dumps({"op": "drive", "id": "1", "robot": "robot_0", "linear": 0.2, "angular": 0.0})
    for number, piece in enumerate((text[:20], text[20:])):
        peer.send_text(op="fragment", id="f", num=number, total=2, data=piece)
    await asyncio.sleep(0.05)
    (answer,) = peer.texts()
    assert (answer["id"], answer["result"]) == ("1", True)
