"""Payloads, velocities and calls between the daemon and nodes of ROS 1."""

import asyncio
import contextlib
import dataclasses
import struct
from collections.abc import AsyncIterator

import pytest
from structlog.testing import capture_logs

from hostlink.errors import HostlinkError
from hostlink.graphs.ros1 import graph_sync, topics
from hostlink.graphs.ros1.tcpros import encode_answer, encode_failure, encode_message
from hostlink.protocol.frame import Id
from hostlink.robot.admission import LEASE_S
from hostlink.robot.velocity import TWIST_TYPE
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.ros1.fake import FakePublisher, connection, fake_master, fake_publisher, fake_service
from tests.support.ros1.scene import ODOMETRY, STRING, SUBSCRIBER, TEXT, VELOCITY, Scene, plain_scene, scene, twist
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


async def test_the_definition_stands_in_the_header_with_all_that_it_contains(made: Scene) -> None:
    odometry = CATALOG.message("nav_msgs/Odometry")
    assert odometry is not None
    await made.master.knows("Publisher", "/robot_0/odom")
    fields = {"callerid": "/listener", "topic": "/robot_0/odom", "type": "*", "md5sum": "*"}
    async with connection(await made.tcpros(), **fields) as listener:
        header = await listener.read_header()
    assert header["message_definition"] == odometry.full_definition
    assert "MSG: geometry_msgs/Quaternion" in header["message_definition"]
    assert (header["type"], header["md5sum"]) == (odometry.name, odometry.md5)


async def test_only_a_subscriber_in_ros_makes_a_subscriber_in_the_hub(made: Scene) -> None:
    address = await made.tcpros()
    found = made.daemon.hub.topics.find(ODOMETRY)
    own = found.subscribers  # the robot's
    async with connection(address, **SUBSCRIBER) as listener:
        await listener.read_header()
        assert len(found.subscribers) == len(own) + 1
    await expect(lambda: found.subscribers == own)


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
            assert set(await there.velocities()) == {0.2}


async def test_velocity_latched_by_a_publisher_that_joins_later_drives_once(made: Scene) -> None:
    """`rostopic pub -1` latches its message. When the connection breaks, the same message arrives again."""
    await made.master.knows("Subscriber", VELOCITY)
    async with fake_publisher(TWIST_TYPE, is_latched=True, first=twist(0.3)) as publisher:
        await made.update(VELOCITY, publisher.uri)
        assert set(await made.velocities()) == {0.3}
        (await publisher.connected()).close()
        await publisher.connected(2)
        await made.velocities(0.6)  # until the lease is over
        assert await made.velocities() == []
        assert made.counts["refused_messages"] == 1


async def streaming(publisher: FakePublisher, speeds_m_s: list[float]) -> None:
    """Publish the newest of these speeds to all subscribers, in the task group of a test."""
    while True:
        for peer in publisher.peers[-1:]:
            with contextlib.suppress(OSError):
                await peer.send_message(twist(speeds_m_s[-1]))
        await asyncio.sleep(0.05)


async def drives_after_a_zero(made: Scene, speeds_m_s: list[float]) -> None:
    assert await made.velocities(0.8) == []
    speeds_m_s.append(0.0)
    await asyncio.sleep(0.2)
    speeds_m_s.append(0.1)
    assert set(await made.velocities()) == {0.1}


async def test_stream_from_before_the_device_connected_again_drives_after_a_zero(made: Scene) -> None:
    """The device was disconnected for longer than a lease, and hostlink stayed subscribed."""
    speeds_m_s = [0.2]
    async with fake_publisher(TWIST_TYPE) as publisher, asyncio.TaskGroup() as tasks:
        made.master.publishers["/red/velocity_commands"] = [publisher.uri]
        stream = tasks.create_task(streaming(publisher, speeds_m_s))
        for _ in range(2):
            async with fake_device(made.daemon.tcp, robot_topics("red"), local_host="127.0.0.2") as red:
                await publisher.connected()
                await drives_after_a_zero(dataclasses.replace(made, robot=red), speeds_m_s)
            await asyncio.sleep(LEASE_S)
        stream.cancel()


async def test_stream_through_a_lost_connection_drives_after_a_zero(made: Scene) -> None:
    """A stop during that time is not known to the new connection's participant."""
    speeds_m_s = [0.2]
    async with fake_publisher(TWIST_TYPE) as publisher, asyncio.TaskGroup() as tasks:
        stream = tasks.create_task(streaming(publisher, speeds_m_s))
        await made.update(VELOCITY, publisher.uri)
        assert set(await made.velocities()) == {0.2}
        (await publisher.connected()).close()
        await publisher.connected(2)
        await made.velocities(0.1)
        await drives_after_a_zero(made, speeds_m_s)
        stream.cancel()


async def test_publisher_that_waited_for_room_is_connected_and_drives_after_a_zero(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The publisher was new when the master named it, and has streamed since then."""
    monkeypatch.setattr(graph_sync, "MAX_PUBLISHERS", 1)
    speeds_m_s = [0.2]
    async with (
        plain_scene() as made,
        fake_publisher(TWIST_TYPE) as first,
        fake_publisher(TWIST_TYPE) as second,
        asyncio.TaskGroup() as tasks,
    ):
        stream = tasks.create_task(streaming(second, speeds_m_s))
        await made.update(VELOCITY, first.uri, second.uri)
        await first.connected()
        assert made.counts["crowded_out"] == 1
        await asyncio.sleep(topics.NEW_S)
        await made.update(VELOCITY, second.uri)
        await second.connected()
        await drives_after_a_zero(made, speeds_m_s)
        stream.cancel()


async def test_publisher_of_before_that_was_silent_drives_at_once(made: Scene) -> None:
    """A teleop that was started before the robot is such a publisher."""
    async with fake_publisher(TWIST_TYPE) as publisher:
        made.master.publishers["/red/velocity_commands"] = [publisher.uri]
        async with fake_device(made.daemon.tcp, robot_topics("red"), local_host="127.0.0.2") as red:
            peer = await publisher.connected()
            await asyncio.sleep(LEASE_S + 0.1)
            await peer.send_message(twist(0.2))
            assert set(await dataclasses.replace(made, robot=red).velocities()) == {0.2}


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


async def test_of_velocities_that_come_at_once_the_newest_counts(made: Scene) -> None:
    async with fake_publisher(TWIST_TYPE) as publisher:
        await made.update(VELOCITY, publisher.uri)
        peer = await publisher.connected()
        await peer.send(b"".join(encode_message(twist(0.01 * number)) for number in range(1, 9)))
        assert (await made.velocities())[-1] == 0.08
        assert made.counts["superseded_velocities"] > 0


async def test_a_zero_behind_velocities_stops_at_once(made: Scene) -> None:
    async with fake_publisher(TWIST_TYPE) as publisher:
        await made.update(VELOCITY, publisher.uri)
        peer = await publisher.connected()
        await peer.send_message(twist(0.2))
        assert set(await made.velocities(0.2)) == {0.2}
        await peer.send(encode_message(twist(0.3)) + encode_message(twist(0.0)))
        await made.velocities(0.1)
        assert await made.velocities() == []


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
        assert robot.gate.owner_name == "ros1 /first"
        one.close()
        await expect(lambda: robot.gate.owner_name is None)


async def test_velocity_that_is_not_finite_is_refused_and_ends_nothing(made: Scene) -> None:
    async with fake_publisher(TWIST_TYPE) as publisher:
        await made.update(VELOCITY, publisher.uri)
        peer = await publisher.connected()
        await peer.send_message(struct.pack("<6d", float("nan"), 0, 0, 0, 0, 0))
        await expect(lambda: made.counts["refused_messages"] == 1)
        await peer.send_message(twist(0.2))
        assert set(await made.velocities()) == {0.2}


# -- what was latched --------------------------------------------------------------------------------------------------

OLD, OTHER, NEW = (struct.pack("<I", 3) + text for text in (b"old", b"oth", b"new"))
TEXT_ALONE = [topic(Id.SUBSCRIBER, 102, "/text", STRING)]


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


async def test_latched_topic_device_that_restarts_on_its_connection_receives_it_again(made: Scene) -> None:
    """A board that restarts behind a USB or radio bridge announces its topics again on the same connection."""
    async with latched(made, OLD), reader(made) as device:
        assert await device.frame(102) == OLD
        made.daemon.hub.links.all()[-1].session.request_topics("test")
        made.daemon.hub.links.all()[-1].wake()
        await device.announce(TEXT_ALONE)
        assert await device.frame(102) == OLD


async def test_latched_topic_of_two_publishers_later_device_receives_both_newest_last(made: Scene) -> None:
    async with latched(made, OLD, OTHER) as (first, _):
        await (await first.connected()).send_message(NEW)
        assert await made.robot.frame(102) == NEW
        async with reader(made) as device:
            assert [await device.frame(102) for _ in range(2)] == [OTHER, NEW]


async def test_latched_topic_whose_publisher_is_gone_later_device_receives_nothing_of_it(made: Scene) -> None:
    async with latched(made, OLD, OTHER) as (first, second):
        await made.update("/text", second.uri)
        await expect(lambda: len(made.daemon.hub.topics.find("/text").publishers) == 1)
        async with reader(made) as device:
            assert await device.frame(102) == OTHER
            await (await second.connected()).send_message(NEW)
            assert await device.frame(102) == NEW
        assert len(first.peers) == 1


async def test_latched_topic_each_program_of_the_api_receives_last_message(made: Scene) -> None:
    async with latched(made, OLD):
        for number in range(2):
            heard: list[bytes] = []
            made.daemon.hub.join(f"program {number}").subscribe("/text", lambda each, to=heard: to.append(each.payload))
            assert heard == [OLD]


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
    link.session.request_topics("test")
    link.wake()
    await made.robot.announce([*robot_topics(), TEXT])
    found = [frame.topic_id for frame in [await made.robot.next() for _ in range(1)]]
    while 102 not in found:
        found.append((await made.robot.next()).topic_id)
    assert 101 not in found


# -- what a device must not receive -----------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", [b"", b"\x00", struct.pack("<I", 100) + b"a", struct.pack("<I", 1) + b"ab"])
async def test_message_of_another_type_than_negotiated_reaches_no_device(made: Scene, payload: bytes) -> None:
    async with fake_publisher(STRING) as publisher:
        await made.update("/text", publisher.uri)
        peer = await publisher.connected()
        right = struct.pack("<I", 2) + b"ok"
        await peer.send(encode_message(payload) + encode_message(right))
        assert await made.robot.frame(102) == right
        assert made.counts["malformed_messages"] == 1


async def test_a_message_over_the_bound_is_passed_over() -> None:
    async with (
        fake_master() as master,
        scene(master, max_message_bytes=50) as made,
        fake_publisher(STRING) as publisher,
    ):
        await made.update("/text", publisher.uri)
        peer = await publisher.connected()
        right = struct.pack("<I", 2) + b"ok"
        await peer.send(encode_message(struct.pack("<I", 60_000) + bytes(60_000)) + encode_message(right))
        assert await made.robot.frame(102) == right
        assert made.counts["too_large_messages"] == 1


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


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (encode_failure("the door is stuck"), "the door is stuck"),
        (b"", "0 bytes read"),
        (b"\x01\xff\xff\xff\xff", "an answer of 4294967295 bytes"),
        (encode_answer(b"\x01"), "std_srvs/Trigger"),
        (encode_answer(DONE + b"more"), "std_srvs/Trigger"),
    ],
    ids=["refused", "closed", "four gigabytes", "too short", "too long"],
)
async def test_a_call_that_another_node_fails_has_its_reason(made: Scene, answer: bytes, reason: str) -> None:
    async with fake_service("std_srvs/Trigger", answer) as service:
        await offered(made, "/door", service.address)
        caller = made.daemon.hub.join("caller")
        with pytest.raises(HostlinkError, match=reason):
            await caller.call("/door", {})


async def test_a_service_of_another_definition_is_not_offered(made: Scene) -> None:
    async with fake_service("std_srvs/Trigger", encode_answer(DONE), md5="0" * 32) as service:
        made.master.services["/door"] = service.address
        await expect(lambda: service.headers)
        await expect_never(lambda: made.daemon.hub.services.is_offered("/door"), for_s=0.2)


async def test_a_service_that_is_hostlinks_own_is_not_provided_by_another_node(made: Scene) -> None:
    before = made.daemon.hub.services.find("/robot_0/lock")
    async with fake_service("std_srvs/Trigger", encode_answer(DONE)) as service:
        made.master.services["/robot_0/lock"] = service.address
        await expect(lambda: service.headers)
        await asyncio.sleep(0.1)
        assert made.daemon.hub.services.find("/robot_0/lock") is before


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


# -- time -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [True, 1])
async def test_sim_time_is_wanted_as_nodes_of_ros_read_it(made: Scene, value: object) -> None:
    await made.master.knows("Publisher", ODOMETRY)
    await made.master.call("paramUpdate", "/master", "/use_sim_time", value)
    assert made.daemon.hub.links.wall_ns() == 0  # before the first message of /clock
    for other in (False, 0, "", {}):
        await made.master.call("paramUpdate", "/master", "/use_sim_time", other)
        assert made.daemon.hub.links.wall_ns() > 0
