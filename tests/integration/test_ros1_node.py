"""Payloads, velocities and calls between the daemon and nodes of ROS 1."""

import asyncio
import contextlib
import dataclasses
import struct
from collections.abc import AsyncIterator

import pytest
from structlog.testing import capture_logs

from hostlink.components.ros1.tcpros import encode_answer, encode_message
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.velocity import TWIST_TYPE
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.ros1.fake import FakePublisher, connection, fake_publisher, fake_service
from tests.support.ros1.scene import STRING, SUBSCRIBER, TEXT, VELOCITY, Scene, plain_scene, twist
from tests.support.waiting import expect, expect_never


@pytest.fixture
async def made() -> AsyncIterator[Scene]:
    async with plain_scene() as made:
        yield made


# -- bytes ------------------------------------------------------------------------------------------------------------


async def test_payloads_pass_both_ways_as_they_are(made: Scene) -> None:
    latin = struct.pack("<I", 5) + b"\xff\x00\xfea\n"  # no UTF-8
    async with (
        connection(await made.tcpros(), **SUBSCRIBER) as listener,
        fake_publisher(STRING) as publisher,
    ):
        assert (await listener.read_header())["md5sum"] == SUBSCRIBER["md5sum"]
        await made.robot.send(pose(1.0, -2.0, float("nan")))
        assert await listener.read() == struct.pack("<3d", 1.0, -2.0, float("nan"))
        await made.update("/text", publisher.uri)
        await (await publisher.connected()).send_message(latin)
        assert await made.robot.frame(102) == latin
    assert publisher.requests[0]["tcp_nodelay"] == "1"
    assert publisher.requests[0]["callerid"] == "/hostlink"


# -- velocities -------------------------------------------------------------------------------------------------------


async def test_velocity_latched_before_the_robot_connected_does_not_move_it(made: Scene) -> None:
    async with fake_publisher(TWIST_TYPE, is_latched=True, first=twist(0.3)) as publisher:
        made.master.publishers["/red/velocity_commands"] = [publisher.uri]
        async with fake_device(made.daemon.tcp, robot_topics("red"), local_host="127.0.0.2") as red:
            peer = await publisher.connected()
            there = dataclasses.replace(made, robot=red)
            assert await there.velocities() == []
            assert made.counts["refused_messages"] == 1
            await asyncio.sleep(LEASE_S)
            await peer.send_message(twist(0.2))
            assert await red.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)


async def test_refused_velocity_is_in_both_logs_at_a_limited_rate(made: Scene) -> None:
    lines: list[str] = []
    made.daemon.hub.join("reader").subscribe("/rosout", lambda line: lines.append(str(line.decoded["msg"])))
    async with fake_publisher(TWIST_TYPE) as publisher:
        await made.update(VELOCITY, publisher.uri)
        peer = await publisher.connected()
        made.daemon.hub.robots.find("robot_0").lock("smoke")
        with capture_logs() as logs:
            for count in range(1, 6):
                await peer.send_message(twist(0.2))
                await expect(lambda count=count: made.counts["refused_messages"] == count)
    refused = [log for log in logs if log["event"] == "ros1.message_refused"]
    assert [(log["kind"], log["count"]) for log in refused] == [("locked", 1)]
    assert "smoke" in refused[0]["reason"]
    assert len(lines) == 1
    assert "/robot_0/velocity_commands of ros1 /fake is refused (locked): robot_0: locked: smoke" in lines[0]


async def test_each_publisher_is_a_driver_of_its_own(made: Scene) -> None:
    robot = made.daemon.hub.robots.find("robot_0")
    async with (
        fake_publisher(TWIST_TYPE, callerid="/first") as first,
        fake_publisher(TWIST_TYPE, callerid="/second") as second,
    ):
        await made.update(VELOCITY, first.uri, second.uri)
        one, other = await first.connected(), await second.connected()
        await one.send_message(twist(0.1))
        await expect(lambda: robot.gate.owner_name == "ros1 /first")
        other.close()
        await asyncio.sleep(0.1)
        assert robot.gate.owner_name == "ros1 /first" or made.daemon.was_paused
        one.close()
        await expect(lambda: robot.gate.owner_name is None)


# -- what was latched --------------------------------------------------------------------------------------------------

OLD, NEW = (struct.pack("<I", 3) + text for text in (b"old", b"new"))
TEXT_ALONE = [topic(EndpointKind.SUBSCRIBER, 102, "/text", STRING)]


@contextlib.asynccontextmanager
async def latched(made: Scene, *contents: bytes) -> AsyncIterator[list[FakePublisher]]:
    """Publishers of /text that have latched one message each, and from which the robot has it."""
    async with contextlib.AsyncExitStack() as stack:
        found = [
            await stack.enter_async_context(
                fake_publisher(STRING, is_latched=True, first=each, callerid=f"/latch_{number}")
            )
            for number, each in enumerate(contents)
        ]
        for number, each in enumerate(contents, 1):
            await made.update("/text", *(publisher.uri for publisher in found[:number]))
            assert await made.robot.frame(102) == each
        yield found


@contextlib.asynccontextmanager
async def reader(made: Scene) -> AsyncIterator[FakeDevice]:
    """A device that reads /text alone."""
    async with fake_device(made.daemon.tcp, TEXT_ALONE, local_host="127.0.0.3") as device:
        yield device


async def test_latched_topic_second_device_and_rebooted_device_receive_last_message(made: Scene) -> None:
    async with latched(made, OLD) as (publisher,):
        async with reader(made) as second:
            assert await second.frame(102) == OLD
        async with reader(made) as rebooted:
            assert await rebooted.frame(102) == OLD
            await (await publisher.connected()).send_message(NEW)
            assert await rebooted.frame(102) == NEW  # and nothing twice in between
        async with reader(made) as late:
            assert await late.frame(102) == NEW
    assert len(publisher.peers) == 1


async def test_latched_velocity_of_program_moves_no_robot_that_connects_later(made: Scene) -> None:
    """The message was latched while no robot had the topic, and nothing marked it as a velocity."""
    program = made.daemon.hub.join("program")
    program.advertise("/red/velocity_commands", TWIST_TYPE, is_latched=True)
    program.publish("/red/velocity_commands", twist(0.3))
    async with fake_device(made.daemon.tcp, robot_topics("red"), local_host="127.0.0.2") as red:
        await expect(lambda: made.daemon.hub.robots.find("red").link)
        assert await dataclasses.replace(made, robot=red).velocities() == []


async def test_latched_odometry_reset_is_not_repeated_to_device_that_announces_again(made: Scene) -> None:
    program = made.daemon.hub.join("program")
    program.advertise("/robot_0/reset_odometry", "std_msgs/Empty", is_latched=True)
    program.advertise("/text", STRING, is_latched=True)
    program.publish("/robot_0/reset_odometry", b"")
    program.publish("/text", OLD)
    assert (await made.robot.frame(101), await made.robot.frame(102)) == (b"", OLD)
    link = made.daemon.hub.links.all()[0]
    link.session.probe()
    link.wake()
    await made.robot.announce([*robot_topics(), TEXT])
    found = [frame.topic_id for frame in [await made.robot.next() for _ in range(1)]]
    while 102 not in found:
        found.append((await made.robot.next()).topic_id)
    assert 101 not in found


# -- what a device must not receive -----------------------------------------------------------------------------------


async def test_message_of_another_type_than_negotiated_reaches_no_device(made: Scene) -> None:
    payload = struct.pack("<I", 1) + b"ab"
    async with fake_publisher(STRING) as publisher:
        await made.update("/text", publisher.uri)
        peer = await publisher.connected()
        right = struct.pack("<I", 2) + b"ok"
        await peer.send(encode_message(payload) + encode_message(right))
        assert await made.robot.frame(102) == right
        assert made.counts["malformed_messages"] == 1


# -- services of other nodes ------------------------------------------------------------------------------------------

TRIGGER = CATALOG.service("std_srvs/Trigger")
assert TRIGGER is not None
DONE = TRIGGER.response.encode({"success": True, "message": "open"})


async def offered(made: Scene, name: str, address: str) -> None:
    """Wait until the daemon offers the service of another node."""
    made.master.services[name] = address
    await expect(lambda: made.daemon.hub.services.is_offered(name))


async def test_a_service_of_another_node_is_called_and_withdrawn_when_it_leaves(made: Scene) -> None:
    async with fake_service("std_srvs/Trigger", encode_answer(DONE)) as service:
        await offered(made, "/door", service.address)
        caller = made.daemon.hub.join("caller")
        assert await caller.call("/door", {}) == {"success": True, "message": "open"}
        assert service.headers[0]["probe"] == "1"
        assert service.headers[-1]["callerid"] == "/hostlink"
        del made.master.services["/door"]
        await expect(lambda: not made.daemon.hub.services.is_offered("/door"))


async def test_a_service_of_another_definition_is_not_offered(made: Scene) -> None:
    async with fake_service("std_srvs/Trigger", encode_answer(DONE), md5="0" * 32) as service:
        made.master.services["/door"] = service.address
        await expect(lambda: service.headers)
        await expect_never(lambda: made.daemon.hub.services.is_offered("/door"), for_s=0.2)


async def test_a_program_of_ros_that_calls_and_leaves_ends_its_call(made: Scene) -> None:
    """And another that sends requests without waiting for answers is closed."""
    started = asyncio.Event()

    async def never(_: object) -> dict[str, object]:
        started.set()
        await asyncio.sleep(60)
        return {}

    made.daemon.hub.join("slow").provide("/slow", "std_srvs/Trigger", never)
    await made.master.knows("Service", "/slow")
    assert TRIGGER is not None
    header = {"callerid": "/caller", "service": "/slow", "md5sum": TRIGGER.md5}
    async with connection(await made.tcpros(), **header) as caller:
        assert (await caller.read_header())["type"] == "std_srvs/Trigger"
        await caller.send_message(b"")
        await started.wait()
    await expect(lambda: made.counts["failed_services"] == 1)
    async with connection(await made.tcpros(), **header) as caller:
        await caller.send(encode_message(b"") * 20)
        assert await caller.is_closed()
