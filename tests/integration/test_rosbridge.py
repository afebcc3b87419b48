"""rosbridge v2 on a real WebSocket, and what bad input does to it: nothing."""

import asyncio
import contextlib

import aiohttp

from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, pose, robot_topics, service_client, service_server
from tests.support.rosbridge import client
from tests.support.waiting import expect


async def test_a_service_of_a_device_is_called_and_a_failure_has_a_reason() -> None:
    topics = service_server("/trigger", "std_srvs/Trigger")
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


async def test_a_program_offers_a_service_that_a_device_calls() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, service_client("/toggle", "std_srvs/SetBool")) as device,
        client(host) as program,
    ):
        await program.send(op="advertise_service", service="/toggle", type="std_srvs/SetBool")
        await expect(lambda: host.hub.services.provider("/toggle"))
        await device.send(encode(125, b"\x01"))
        call = await program.receive()
        assert (call["op"], call["service"], call["args"]) == ("call_service", "/toggle", {"data": True})
        values = {"success": True, "message": "ok"}
        await program.send(op="service_response", id=call["id"], service="/toggle", values=values, result=True)
        assert await device.frame(100) == b"\x01\x02\x00\x00\x00ok"
