"""Behaviour of today's hosts and of hostlink, situation by situation (docs/reliability.md#todays-hosts).

A test's docstring says it: what rosserial_python does | what rosserial_server does. Both were seen by running them.
"""

import asyncio
import socket
import struct
import time
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.device import COMMAND_DEPTH
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import decode_parameter
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.errors import FrameTooLarge, ServiceFailed
from tests.support.daemon import Daemon, daemon
from tests.support.device_codec import encode_parameter_request
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics, service_client, service_server, topic
from tests.support.participants import publish
from tests.support.rosbridge import client
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect

SERVICE_CLIENT = service_client("/toggle", "std_srvs/SetBool")
SERVICE_SERVER = service_server("/set_led", "std_srvs/SetBool")
NO_SUCH_SERVICE = b"no service named /toggle"
ODOMETRY = "/robot_0/odometry"


async def works(host: Daemon, name: str = "monitor") -> bool:
    """Whether a robot that connects now is heard and can be driven."""
    async with fake_device(host.tcp, robot_topics(name)) as device:
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find(f"/{name}/odometry").messages == 1)
        assert await device.velocity() == (0.0, 0.0)
    return not host.hub.isolation.crashes


async def messages(host: Daemon, count: int) -> None:
    """Wait until so many messages of robot_0's odometry have come."""
    await expect(lambda: host.hub.topics.find(ODOMETRY).messages == count)


async def test_a_device_that_resets_in_the_middle_of_a_frame() -> None:
    """The process dies | closes, keeps listening. Here: the link ends, all others go on."""
    async with daemon() as host, fake_device(host.tcp, robot_topics("other")) as other:
        with socket.create_connection(host.tcp) as device:
            device.sendall(pose(1.0)[:13])
            device.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        await other.send(pose(2.0))
        await expect(lambda: host.hub.topics.find("/other/odometry").messages == 1)
        await expect(lambda: len(host.hub.links.all()) == 1)
        assert await works(host)


async def test_a_device_with_a_service_client_disconnects() -> None:
    """The process dies | an empty answer. Here: nothing remains of it."""
    async with daemon() as host:
        async with fake_device(host.tcp, SERVICE_CLIENT) as device:
            await device.send(encode(125, b"\x01"))
        await expect(lambda: not host.hub.links.all())
        assert await works(host)


async def test_a_service_that_a_device_calls_fails() -> None:
    """The process dies | the answer is empty and looks real. Here: the answer says that it failed, and why."""
    async with daemon() as host, fake_device(host.tcp, SERVICE_CLIENT) as device:
        await device.send(encode(125, b"\x01"))
        assert await device.frame(100) == b"\x00" + struct.pack("<I", len(NO_SUCH_SERVICE)) + NO_SUCH_SERVICE
        assert await works(host)


async def test_a_parameter_that_is_an_empty_list() -> None:
    """The process dies | parameters unknown. Here: answered with nothing in it."""
    async with daemon(Config(parameters={"empty": []})) as host, fake_device(host.tcp, []) as device:
        await device.send(encode(Id.PARAMETER, encode_parameter_request("empty")))
        assert decode_parameter(await device.frame(Id.PARAMETER)) == ((), (), ())
        assert await works(host)


async def test_a_payload_too_short_for_its_type() -> None:
    """The process dies | passed on. Here: no frame of that type has that size, so the frame is rejected and counted."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(encode(125, bytes(8)) + pose(1.0))
        await messages(host, 1)
        assert (await host.get("/api/links"))["links"][0]["rejected"] == {"wrong_size": 1}


async def test_a_half_open_link_and_the_robot_on_a_new_connection() -> None:
    """The device gets nothing | the old link is closed after 5 s of silence. Here: the new link wins at once."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        watch = Stopwatch()
        async with fake_device(host.tcp, robot_topics()) as back:
            assert await back.velocity() == (0.0, 0.0)
            await back.send(pose(1.0))
            await messages(host, 1)
        assert watch.seconds < 1.0 or host.was_paused


async def test_a_robot_that_publishes_on_after_a_reconnect() -> None:
    """A topic request for each unknown frame | waits. Here: a request a second, and those for one id end."""
    async with daemon() as host, fake_device(host.tcp) as device:
        began_s = time.monotonic()
        while time.monotonic() < began_s + 1.5:
            await device.send(pose(1.0) * 5)
            await asyncio.sleep(0.02)
        link = (await host.get("/api/links"))["links"][0]
    assert link["unknown_ids"] > 100
    assert link["topic_requests"] <= 2


async def test_the_first_topic_request() -> None:
    """2.1 s after the connection | at once, but closes after 1 s without topics. Here: at once, and it stays."""
    async with daemon() as host, fake_device(host.tcp) as device:
        began_s, watch = time.monotonic(), Stopwatch()
        await device.frame(Id.PUBLISHER)
        assert watch.seconds < 0.3 or host.was_paused
        await device.frame(Id.PUBLISHER)  # asked again after 2 s without an answer, on the same connection
        assert time.monotonic() - began_s > 1.5


async def test_a_header_that_claims_32767_bytes() -> None:
    """Swallows 36 s of traffic | nothing above 1022 bytes ever passes. Here: no frame behind it is lost."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(b"\xff\xfe\xff\x7f\x81\x7d\x00" + pose(1.0) + pose(2.0))
        await messages(host, 2)


async def test_a_stray_ff_before_a_good_frame() -> None:
    """Loses that frame | loses that frame. Here: loses the FF."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(b"\xff" + pose(1.0) + b"\xff\xff" + pose(2.0))
        await messages(host, 2)


@pytest.mark.parametrize("name", ["/missing", "/mixed"])
async def test_a_missing_or_mixed_parameter(name: str) -> None:
    """No answer: the device spins a second | parameters unknown. Here: answered at once, with none."""
    async with daemon(Config(parameters={"mixed": [1, "a"]})) as host, fake_device(host.tcp, []) as device:
        watch = Stopwatch()
        await device.send(encode(Id.PARAMETER, encode_parameter_request(name)))
        assert decode_parameter(await device.frame(Id.PARAMETER)) == ((), (), ())
        assert watch.seconds < 0.3 or host.was_paused


async def test_a_service_of_a_device_that_never_answers() -> None:
    """A busy loop, also after the device left | service servers unknown. Here: a deadline, and no work meanwhile."""
    async with daemon() as host, fake_device(host.tcp, SERVICE_SERVER) as device:
        busy_s = time.process_time()
        with pytest.raises(ServiceFailed, match="no answer within"):
            await host.hub.services.call("/set_led", {"data": True}, timeout_s=1.0)
        assert time.process_time() - busy_s < 0.2
        assert await device.frame(100) == b"\x01"
        assert await works(host)


async def test_a_message_larger_than_the_device_buffer() -> None:
    """The session ends | sent all the same. Here: refused to its sender, and the session continues."""
    text = [topic(EndpointKind.SUBSCRIBER, 100, "/text", "std_msgs/String", buffer_bytes=64)]
    async with daemon() as host, fake_device(host.tcp, text) as device:
        with pytest.raises(FrameTooLarge):
            publish(host.hub, "/text", {"data": "x" * 100}, source="test")
        publish(host.hub, "/text", {"data": "short"}, source="test")
        assert await device.frame(100) == b"\x05\x00\x00\x00short"


async def test_a_device_that_never_reads() -> None:
    """A queue without limit | its messages can stop too. Here: 16 wait, newer ones replace, its messages go on."""
    text = [topic(EndpointKind.SUBSCRIBER, 101, "/text", "std_msgs/String", buffer_bytes=60_000)]
    async with daemon() as host, fake_device(host.tcp, robot_topics()[:1] + text) as device:
        link = host.hub.links.all()[0]
        sent = 0
        while not link.session.outbox.replaced:
            publish(host.hub, "/text", {"data": "x" * 50_000}, source="test")
            sent += 1
            assert sent < 1000
            await asyncio.sleep(0)
        for _ in range(50):
            publish(host.hub, "/text", {"data": "x" * 50_000}, source="test")
        await asyncio.sleep(0)
        assert link.session.outbox.replaced >= 50 - COMMAND_DEPTH
        await device.send(pose(1.0))
        await messages(host, 1)


async def test_a_hundred_frames_in_one_segment() -> None:
    """100 reach a Python subscriber | 4 do. Here: 100 reach a program on the WebSocket, in order."""
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await expect(lambda: host.hub.topics.find(ODOMETRY).publishers)
        await program.send(op="subscribe", topic=ODOMETRY)
        await expect(lambda: len(host.hub.topics.find(ODOMETRY).subscribers) == 2)  # the robot's pose is read too
        await device.send(b"".join(pose(float(number)) for number in range(100)))
        assert [(await program.receive())["msg"]["x"] for _ in range(100)] == list(range(100))


@pytest.mark.slow
async def test_each_reconnect() -> None:
    """Leaks a thread and a descriptor | nothing. Here: nothing."""

    def in_use() -> tuple[int, int]:
        return len(list(Path("/proc/self/fd").iterdir())), len(asyncio.all_tasks())

    async with daemon() as host:
        before = None
        for _ in range(50):
            async with fake_device(host.tcp, robot_topics()):
                pass
            await expect(lambda: not host.hub.links.all())
            before = before or in_use()
        assert in_use() <= before


async def test_an_illegal_topic_name() -> None:
    """An error | the process aborts. Here: no device means it, so it counts as damage; the other topics go on."""
    uncommon = topic(EndpointKind.PUBLISHER, 126, "/no name\x1b[31m at all!", "std_msgs/Bool")
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), uncommon]) as device:
        await device.send(encode(126, b"\x01") + pose(1.0))
        await messages(host, 1)
        assert (await host.get("/api/links"))["links"][0]["malformed"] == 1
        assert await works(host)


async def test_a_wrong_md5() -> None:
    """The topic is refused | published, useless to subscribers. Here: refused, with both sums; others go on."""
    wrong = topic(EndpointKind.PUBLISHER, 126, "/odd", "std_msgs/Bool")._replace(md5="0" * 32)
    with capture_logs() as lines:
        async with daemon() as host, fake_device(host.tcp, [*robot_topics(), wrong]) as device:
            await device.send(encode(126, b"\x01") + pose(1.0))
            await messages(host, 1)
            assert host.hub.topics.find_or_none("/odd") is None
            assert (await host.get("/api/links"))["links"][0]["refused_frames"] == 1
    reasons = [line["reason"] for line in lines if line["event"] == "topic.refused"]
    assert len(reasons) == 1
    assert wrong.md5 in reasons[0]
    assert topic(EndpointKind.PUBLISHER, 126, "/odd", "std_msgs/Bool").md5 in reasons[0]


async def test_thirty_silent_robots() -> None:
    """117 % of a core and 30 processes | 1 %. Here: at most 5 % of a core, in one process."""
    devices: list[FakeDevice] = []
    async with daemon() as host, asyncio.TaskGroup() as tasks:
        is_over = asyncio.Event()

        async def stay(number: int) -> None:
            async with fake_device(host.tcp, robot_topics(f"robot_{number}")) as device:
                devices.append(device)
                await is_over.wait()

        for number in range(30):
            tasks.create_task(stay(number))
        await expect(lambda: len(devices) == 30 and all(robot.link for robot in host.hub.robots.all()))
        await asyncio.sleep(0.5)  # the zeros with which each session begins are sent
        busy_s = time.process_time()
        await asyncio.sleep(1.0)
        assert time.process_time() - busy_s < 0.05
        is_over.set()
