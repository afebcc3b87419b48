"""rosbridge v2 on a real WebSocket, and what bad input does to it: nothing."""

import asyncio
import contextlib

import aiohttp
import pytest
from structlog.testing import capture_logs

from hostlink.protocol.frame import Id, encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import fake_device, pose, robot_topics, topic
from tests.support.rosbridge import client
from tests.support.waiting import expect


async def subscribed(host: Daemon, name: str) -> None:
    await expect(lambda: host.hub.topics.find(name).subscribers)


@pytest.mark.parametrize("name", ["/robot_0/odometry", "robot_0/odometry"])
async def test_message_has_the_topic_name_that_the_client_used(name: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic=name)
        await expect(lambda: len(host.hub.topics.find(name).subscribers) == 2)  # the robot's own odometry too
        await device.send(pose(1.0, 2.0, 0.5))
        assert await program.receive() == {"op": "publish", "topic": name, "msg": {"x": 1.0, "y": 2.0, "theta": 0.5}}


async def test_nan_is_null_and_bytes_are_base64() -> None:
    topics = [
        topic(Id.PUBLISHER, 125, "/image", "std_msgs/UInt8MultiArray"),
        topic(Id.PUBLISHER, 126, "/t", "std_msgs/Float32"),
    ]
    async with daemon() as host, fake_device(host.tcp, topics) as device, client(host) as program:
        await program.send(op="subscribe", topic="/image")
        await program.send(op="subscribe", topic="/t")
        await subscribed(host, "/t")
        await device.send(encode(125, bytes(8) + b"\x03\x00\x00\x00\x01\x02\x03") + encode(126, b"\x00\x00\xc0\x7f"))
        assert (await program.receive())["msg"]["data"] == "AQID"
        assert (await program.receive())["msg"] == {"data": None}


async def test_a_program_drives_a_robot_and_its_end_stops_it() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        async with client(host) as program:
            await program.send(op="advertise", topic="/robot_0/velocity_commands", type="geometry_msgs/Twist")
            await program.send(
                op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": 0.2}, "angular": {"z": 0.5}}
            )
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.5)
        assert await device.velocity_other_than((0.2, 0.5)) == (0.0, 0.0)


async def test_programs_talk_to_each_other_without_a_device() -> None:
    async with daemon() as host, client(host) as speaker, client(host) as listener:
        await listener.send(op="subscribe", topic="/chat", type="std_msgs/String")
        await subscribed(host, "/chat")
        await speaker.send(op="publish", topic="/chat", type="std_msgs/msg/String", msg={"data": "hello"})
        assert (await listener.receive())["msg"] == {"data": "hello"}


async def test_a_throttled_subscription_gets_the_newest_that_waited() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odometry", throttle_rate=200, queue_length=1)
        await expect(lambda: len(host.hub.topics.find("/robot_0/odometry").subscribers) == 2)
        for number in range(5):
            await device.send(pose(float(number)))
        assert [(await program.receive())["msg"]["x"] for _ in range(2)] == [0.0, 4.0]


async def test_unsubscribe_by_id_and_whole() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        for number in ("a", "b"):
            await program.send(op="subscribe", id=number, topic="/robot_0/odometry")
        await program.send(op="unsubscribe", id="a", topic="/robot_0/odometry")
        await expect(lambda: len(host.hub.topics.find("/robot_0/odometry").subscribers) == 2)
        await device.send(pose(1.0))
        assert (await program.receive())["msg"]["x"] == 1.0
        await program.send(op="unsubscribe", topic="/robot_0/odometry")
        await expect(lambda: len(host.hub.topics.find("/robot_0/odometry").subscribers) == 1)


async def test_a_service_of_a_device_is_called_and_a_failure_has_a_reason() -> None:
    topics = [
        topic(Id.SERVICE_SERVER_PUBLISHER, 125, "/trigger", "std_srvs/Trigger"),
        topic(Id.SERVICE_SERVER_SUBSCRIBER, 100, "/trigger", "std_srvs/Trigger"),
    ]
    async with daemon() as host, fake_device(host.tcp, topics) as device, client(host) as program:
        await program.send(op="call_service", id="x1", service="/trigger", args={})
        assert await device.frame(100) == b""
        await device.send(encode(125, b"\x01\x02\x00\x00\x00ok"))
        assert await program.receive() == {
            "op": "service_response", "id": "x1", "service": "/trigger", "result": True,
            "values": {"success": True, "message": "ok"},
        }  # fmt: skip
        await program.send(op="call_service", id="x2", service="/nope")
        answer = await program.receive()
    assert (answer["id"], answer["result"], answer["values"]) == (
        "x2",
        False,
        "no service named /nope; known: /trigger",
    )


@pytest.mark.parametrize(
    ("request_text", "reason"),
    [
        ("{", "invalid JSON"),
        ("[1]", 'a message is a JSON object with an "op"'),
        ('{"op": 7}', "7: op must be a text"),
        ('{"op": "dance"}', "unknown op 'dance'"),
        ('{"op": "publish", "topic": "/nope", "msg": {}}', "no topic named /nope"),
        ('{"op": "publish", "topic": "/robot_0/velocity_commands", "msg": {"linaer": {}}}', "linaer"),
        ('{"op": "publish", "topic": "/robot_0/velocity_commands", "msg": []}', "msg must be an object"),
        ('{"op": "publish", "topic": "/robot_0/velocity_commands", "msg": {}, "priority": "high"}', "priority must be"),
        ('{"op": "publish", "topic": "/robot_0/velocity_commands", "msg": {"linear": {"x": null}}}', "finite"),
        ('{"op": "publish", "topic": "/robot_0/velocity_commands", "type": 5, "msg": {}}', "type must be a text"),
        ('{"op": "advertise", "topic": "/x", "type": "my_msgs/None"}', "unknown type my_msgs/None"),
        ('{"op": "advertise", "topic": "/robot_0/odometry", "type": "std_msgs/Bool"}', "wanted geometry_msgs/Pose2D"),
        ('{"op": "subscribe", "topic": ""}', "topic must be a text"),
        ('{"op": "subscribe", "topic": "/x", "throttle_rate": -1}', "throttle_rate must be a number"),
        ('{"op": "set_level", "level": "loud"}', "level must be one of"),
        ("[" * 100_000, "nested too deeply"),
        (
            '{"op": "publish", "topic": "/robot_0/velocity_commands", "msg": '
            + '{"linear":' * 50_000
            + "1"
            + "}" * 50_001,
            "JSON",
        ),
    ],
)
async def test_invalid_request_is_reported_and_the_client_stays(request_text: str, reason: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.socket.send_str(request_text)
        status = await program.receive()
        assert (status["op"], status["level"]) == ("status", "error")
        assert reason in status["msg"]
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": 0.1}})
        assert await device.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)


async def test_a_client_that_did_not_request_status_gets_none() -> None:
    with capture_logs() as lines:
        async with daemon() as host, client(host, level="none") as program:
            await program.send(op="dance")
            await program.send(op="call_service", id="1", service="/nope")
            assert (await program.receive())["op"] == "service_response"
    assert [line["op"] for line in lines if line["event"] == "client.unknown_op"] == ["dance"]


async def test_half_a_frame_and_a_huge_one_end_only_their_own_connection() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        address = host.url.removeprefix("http://").split(":")
        reader, writer = await asyncio.open_connection(address[0], int(address[1]))
        writer.write(
            b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"\x81\xfe\x10")  # the start of a text frame of some kilobytes
        await writer.drain()
        writer.close()
        await writer.wait_closed()
        async with host.session.ws_connect(host.url, max_msg_size=0) as other:
            with contextlib.suppress(ConnectionError):
                await other.send_str('"' + "x" * 2_000_000 + '"')
            assert (await other.receive()).type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED)
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": 0.1}})
        assert await device.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)


async def test_a_client_that_never_reads_costs_the_robot_nothing() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics()) as device,
        client(host) as program,
        host.session.ws_connect(host.url) as stuck,
    ):
        await stuck.send_str('{"op": "subscribe", "topic": "/robot_0/odometry"}')
        await expect(lambda: len(host.hub.topics.find("/robot_0/odometry").subscribers) == 2)
        for number in range(3000):
            await device.send(pose(float(number)))
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": 0.1}})
        assert await device.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 3000)


async def test_a_client_that_a_fault_of_hostlink_ends_is_closed_and_its_robot_stopped() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/chat", type="std_msgs/String")
        await expect(lambda: host.hub.topics.find("/chat").subscribers)
        await program.send(op="drive", robot="robot_0", linear=0.2, angular=0.0)
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        assert (await program.receive())["result"] is True
        host.hub.topics.find("/chat").subscribers[0].fail(ValueError("a defect"))
        assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
        closing = await program.socket.receive(timeout=5.0)
        assert (closing.type, closing.data) == (aiohttp.WSMsgType.CLOSE, aiohttp.WSCloseCode.INTERNAL_ERROR)
        async with client(host) as other:
            assert "/chat" not in (await other.call("/rosapi/topics"))["topics"]
