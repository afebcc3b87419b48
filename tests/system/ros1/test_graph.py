"""Topics, services and parameters between rospy programs and devices, and a master that dies and is started again."""

import asyncio
import signal
import struct
from collections.abc import AsyncIterator
from pathlib import Path

import aiohttp
import pytest

from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.fake_device import FakeDevice, pose, repeating, robot_topics, service_client, service_server, topic
from tests.support.process import Process, simulated
from tests.support.ros1.debian import Graph, Node, graph, living_device
from tests.support.waiting import TIMEOUT_S

CATALOG = Catalog()
ODOMETRY, VELOCITY = "/robot_0/odometry", "/robot_0/velocity_commands"
STRING = "std_msgs/String"


@pytest.fixture
async def ros(tmp_path: Path) -> AsyncIterator[Graph]:
    async with graph(tmp_path) as made:
        yield made


def encoded(type_name: str, **fields: object) -> bytes:
    type_ = CATALOG.message(type_name)
    assert type_ is not None
    return type_.encode(fields)


async def received(node: Node, **wanted: object) -> None:
    """Read until a message with these fields arrives."""
    while (await node.read("message"))["fields"] != wanted:
        pass


# -- topics -----------------------------------------------------------------------------------------------------------


async def test_a_subscriber_receives_what_a_device_publishes_and_its_type_is_right(ros: Graph) -> None:
    """rospy compares md5 sums, and unpacks the payload by the message of its own."""
    async with (
        ros.daemon() as daemon,
        living_device(daemon.tcp, robot_topics()) as robot,
        ros.node("listen", ODOMETRY, "geometry_msgs/Pose2D") as listener,
        ros.node("listen", "/robot_0/odom", "nav_msgs/Odometry") as odom,
        ros.node("listen", "/tf", "tf2_msgs/TFMessage") as frames,
        repeating(robot, pose(1.5, 2.5, 0.5)),
    ):
        await received(listener, x=1.5, y=2.5, theta=0.5)
        assert (await listener.read("message"))["by"] == "/hostlink"
        assert (await odom.read("message"))["fields"]["pose"]["pose"]["position"]["x"] == 1.5
        assert (await frames.read("message"))["fields"]["transforms"][0]["header"]["frame_id"] == "robot_0/odom"


async def test_a_device_receives_what_a_program_publishes(ros: Graph) -> None:
    topics = [*robot_topics(), topic(EndpointKind.SUBSCRIBER, 102, "/text", STRING)]
    async with (
        ros.node("talk", "/text", STRING, "{data: before}", "0"),
        ros.daemon() as daemon,
        living_device(daemon.tcp, topics) as robot,
    ):
        assert await robot.frame(102) == encoded(STRING, data="before")  # what was latched, as ROS has it
        async with ros.node("talk", "/text", STRING, "{data: häßlich}", "20"):
            while await robot.frame(102) != encoded(STRING, data="häßlich"):
                pass


@pytest.mark.long
async def test_latched_topic_of_rospy_second_and_rebooted_device_receive_last_message(ros: Graph) -> None:
    text = [topic(EndpointKind.SUBSCRIBER, 102, "/text", STRING)]
    async with (
        ros.daemon() as daemon,
        living_device(daemon.tcp, text) as first,
        ros.node("talk", "/text", STRING, "{data: kept}", "0"),
    ):
        async with asyncio.timeout(TIMEOUT_S):
            assert await first.frame(102) == encoded(STRING, data="kept")
        for _ in range(2):  # the second is the first again, after a reboot
            async with living_device(daemon.tcp, text, local_host="127.0.0.3") as second, asyncio.timeout(TIMEOUT_S):
                assert await second.frame(102) == encoded(STRING, data="kept")


@pytest.mark.long
async def test_latched_message_of_the_daemon_reaches_later_subscribers(ros: Graph) -> None:
    async with ros.daemon() as daemon, aiohttp.ClientSession() as session, session.ws_connect(daemon.url) as client:
        await client.send_json({"op": "advertise", "topic": "/map_name", "type": STRING, "latch": True})
        await client.send_json({"op": "publish", "topic": "/map_name", "msg": {"data": "hall"}})
        async with ros.node("listen", "/map_name", STRING) as first:
            await received(first, data="hall")
            async with ros.node("listen", "/map_name", STRING) as second:
                await received(second, data="hall")
                await client.send_json({"op": "publish", "topic": "/map_name", "msg": {"data": "yard"}})
                await received(first, data="yard")
                await received(second, data="yard")


@pytest.mark.long
async def test_program_without_a_type_receives_a_topic_of_ros(ros: Graph) -> None:
    async with (
        ros.daemon() as daemon,
        ros.node("talk", "/scan_name", STRING, "{data: front}", "10"),
        aiohttp.ClientSession() as session,
        session.ws_connect(daemon.url) as client,
    ):
        await client.send_json({"op": "subscribe", "topic": "/scan_name"})
        async with asyncio.timeout(TIMEOUT_S):
            assert (await client.receive_json())["msg"] == {"data": "front"}


@pytest.mark.long
async def test_a_publisher_of_another_type_is_logged_and_the_others_are_heard(ros: Graph) -> None:
    topics = [*robot_topics(), topic(EndpointKind.SUBSCRIBER, 102, "/text", STRING)]
    async with (
        ros.daemon() as daemon,
        living_device(daemon.tcp, topics) as robot,
        ros.node("talk", "/text", "geometry_msgs/Vector3", "{x: 1}", "10"),
        ros.node("talk", "/text", STRING, "{data: right}", "10"),
    ):
        assert await robot.frame(102) == encoded(STRING, data="right")
        refused = await daemon.read_log("ros1.publisher_failed")
        assert refused["topic"] == "/text"
        assert "Vector3" in refused["reason"] or "md5" in refused["reason"]


# -- services ---------------------------------------------------------------------------------------------------------

SERVER = service_server("/robot_0/arm", "std_srvs/SetBool", 126, 103)
CLIENT = service_client("/door", "std_srvs/SetBool", 127, 104)
SET_BOOL = CATALOG.service("std_srvs/SetBool")
assert SET_BOOL is not None


async def test_a_program_calls_the_service_of_a_device(ros: Graph) -> None:
    assert SET_BOOL is not None
    async with (
        ros.daemon() as daemon,
        living_device(daemon.tcp, [*robot_topics(), *SERVER]) as robot,
        ros.node("call", "/robot_0/arm", "std_srvs/SetBool", "{data: true}") as caller,
    ):
        assert SET_BOOL.request.decode(await robot.frame(103)) == {"data": True}
        await robot.send(encode(126, SET_BOOL.response.encode({"success": True, "message": "up"})))
        assert (await caller.read("answered"))["fields"] == {"success": True, "message": "up"}


@pytest.mark.long
async def test_a_device_that_does_not_answer_fails_the_call_with_its_reason(ros: Graph) -> None:
    async with (
        ros.daemon() as daemon,
        living_device(daemon.tcp, [*robot_topics(), *SERVER]) as robot,
        ros.node("call", "/robot_0/arm", "std_srvs/SetBool", "{data: true}") as caller,
    ):
        await robot.frame(103)
        robot.hang_up()
        assert "not connected" in (await caller.read("failed"))["reason"]


async def test_a_device_calls_the_service_of_a_program(ros: Graph) -> None:
    assert SET_BOOL is not None
    async with (
        ros.daemon() as daemon,
        ros.node("serve", "/door", "std_srvs/SetBool", "{success: true, message: open}") as server,
        living_device(daemon.tcp, [*robot_topics(), *CLIENT]) as robot,
        aiohttp.ClientSession() as session,
    ):
        await offered(session, daemon, "/door")
        await robot.send(encode(127, SET_BOOL.request.encode({"data": True})))
        assert (await server.read("called"))["fields"] == {"data": True}
        assert SET_BOOL.response.decode(await robot.frame(104)) == {"success": True, "message": "open"}
        server.signal(signal.SIGKILL)
        await robot.send(encode(127, SET_BOOL.request.encode({"data": True})))
        assert SET_BOOL.response.decode(await robot.frame(104))["success"] is False


async def offered(session: aiohttp.ClientSession, daemon: Process, service: str) -> None:
    """Wait until the daemon offers the service of another node."""
    async with session.ws_connect(daemon.url) as client, asyncio.timeout(TIMEOUT_S):
        found: list[str] = []
        while service not in found:
            await client.send_json({"op": "call_service", "service": "/rosapi/services"})
            found = (await client.receive_json())["values"]["services"]
            await asyncio.sleep(0.1)


# -- parameters and time ----------------------------------------------------------------------------------------------


def parameter(payload: bytes) -> tuple[list[int], list[float], list[str]]:
    """The answer that a device receives."""
    ints: list[int] = []
    floats: list[float] = []
    strings: list[str] = []
    at = 0
    for found, form in ((ints, "<i"), (floats, "<f")):
        count = struct.unpack_from("<I", payload, at)[0]
        at += 4
        for _ in range(count):
            found.append(struct.unpack_from(form, payload, at)[0])
            at += 4
    count = struct.unpack_from("<I", payload, at)[0]
    at += 4
    for _ in range(count):
        size = struct.unpack_from("<I", payload, at)[0]
        strings.append(payload[at + 4 : at + 4 + size].decode())
        at += 4 + size
    return ints, floats, strings


async def requested(robot: FakeDevice, name: str) -> tuple[list[int], list[float], list[str]]:
    text = name.encode()
    await robot.send(encode(Id.PARAMETER, struct.pack("<I", len(text)) + text))
    async with asyncio.timeout(0.9):  # a device waits for a second
        return parameter(await robot.frame(Id.PARAMETER))


async def becomes(robot: FakeDevice, name: str, wanted: tuple[list[int], list[float], list[str]]) -> None:
    """The master reports a change soon after it was made."""
    found = await requested(robot, name)
    for _ in range(100):
        if found == wanted:
            return
        await asyncio.sleep(0.05)
        found = await requested(robot, name)
    assert found == wanted


@pytest.mark.long
async def test_a_device_reads_parameters_of_the_master_as_rosserial_python_resolves_them(ros: Graph) -> None:
    for name, value in (
        ("/hostlink/kp", "2.5"),
        ("/rate", "30"),
        ("/names", "[left, right]"),
        ("/tree/a", "1"),
        ("/is_on", "true"),
    ):
        await ros.lines("rosparam", "set", name, value)
    async with ros.daemon() as daemon, living_device(daemon.tcp, robot_topics()) as robot:
        await daemon.read_log("ros1.master_found")
        assert await requested(robot, "~kp") == ([], [2.5], [])
        assert await requested(robot, "rate") == await requested(robot, "/rate") == ([30], [], [])
        assert await requested(robot, "names") == ([], [], ["left", "right"])
        assert await requested(robot, "is_on") == ([1], [], [])
        assert await requested(robot, "tree") == await requested(robot, "missing") == ([], [], [])
        await ros.lines("rosparam", "set", "/hostlink/kp", "3.5")
        await ros.lines("rosparam", "set", "/rate", "40")
        await becomes(robot, "~kp", ([], [3.5], []))
        await becomes(robot, "rate", ([40], [], []))
        await ros.lines("rosparam", "delete", "/rate")
        await becomes(robot, "rate", ([], [], []))
        await ros.kill()
        assert await requested(robot, "~kp") == ([], [3.5], [])


@pytest.mark.long
async def test_devices_are_given_the_time_of_the_clock_topic(ros: Graph) -> None:
    await ros.lines("rosparam", "set", "/use_sim_time", "true")
    async with (
        ros.daemon() as daemon,
        living_device(daemon.tcp, robot_topics()) as robot,
        ros.node("talk", "/clock", "rosgraph_msgs/Clock", "{clock: {secs: 77, nsecs: 5}}", "20"),
        asyncio.timeout(TIMEOUT_S),
    ):
        seconds = -1
        while seconds != 77:
            await robot.send(encode(Id.TIME, bytes(8)))
            seconds, _ = struct.unpack("<II", await robot.frame(Id.TIME))
            assert seconds in (0, 77) or seconds > 1e9  # before the parameter was read
        await ros.lines("rosparam", "set", "/use_sim_time", "false")
        while seconds < 1e9:
            await robot.send(encode(Id.TIME, bytes(8)))
            seconds, _ = struct.unpack("<II", await robot.frame(Id.TIME))


# -- a graph that changes ---------------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_robot_that_leaves_takes_its_topics_out_of_the_graph(ros: Graph) -> None:
    async with ros.daemon() as daemon:
        async with living_device(daemon.tcp, robot_topics()):
            await ros.listed(ODOMETRY)
        await ros.listed(ODOMETRY, is_there=False)
        async with living_device(daemon.tcp, robot_topics()):
            await ros.listed(ODOMETRY)


async def test_the_master_dies_and_topics_go_on_and_a_new_one_knows_all_again(ros: Graph) -> None:
    async with (
        ros.daemon() as daemon,
        living_device(daemon.tcp, robot_topics()) as robot,
        ros.node("listen", ODOMETRY, "geometry_msgs/Pose2D") as listener,
        repeating(robot, pose(1.5)),
    ):
        await received(listener, x=1.5, y=0.0, theta=0.0)
        await ros.kill()
        lost = await daemon.read_log("ros1.master_lost")
        assert lost["master"] == ros.url
        for _ in range(3):
            await received(listener, x=1.5, y=0.0, theta=0.0)
        await ros.start()
        await daemon.read_log("ros1.registered_again")
        found = await ros.listed(ODOMETRY)
        assert {"/robot_0/odom", "/tf", "/rosout", VELOCITY} <= found
        assert "/robot_0/lock" in await ros.lines("rosservice", "list")
        async with ros.node("listen", ODOMETRY, "geometry_msgs/Pose2D") as other:
            await received(other, x=1.5, y=0.0, theta=0.0)
        await received(listener, x=1.5, y=0.0, theta=0.0)
    events = [line["event"] for line in daemon.log]
    assert events.count("ros1.master_lost") == events.count("ros1.registered_again") == 1


@pytest.mark.long
async def test_the_daemon_starts_before_its_master(ros: Graph) -> None:
    await ros.kill()
    async with ros.daemon() as daemon, living_device(daemon.tcp, robot_topics()):
        await daemon.read_log("ros1.master_lost")
        await ros.start()
        await daemon.read_log("ros1.master_found")
        await ros.listed(ODOMETRY)


@pytest.mark.long
async def test_another_node_of_the_same_name_takes_its_place(ros: Graph) -> None:
    async with ros.daemon() as daemon, living_device(daemon.tcp, robot_topics()):
        await ros.listed(ODOMETRY)
        async with ros.node("idle", "name=hostlink"):
            ended = await daemon.read_log("ros1.ended")
            assert "new node registered with same name" in ended["reason"]
            await ros.listed(ODOMETRY, is_there=False)
            await asyncio.sleep(1.5)
            assert "xmlrpc reply" in (await ros.run("rosnode", "ping", "-c", "1", "/hostlink"))[1]
        assert daemon.child.returncode is None


@pytest.mark.long
async def test_the_end_of_the_daemon_leaves_nothing_in_the_graph(ros: Graph) -> None:
    async with ros.daemon() as daemon, living_device(daemon.tcp, robot_topics()):
        await ros.listed(ODOMETRY)
        assert await daemon.end(signal.SIGTERM) == 0
    assert "/hostlink" not in (await ros.run("rosnode", "list"))[1]
    assert await ros.lines("rosservice", "list") == []


@pytest.mark.long
async def test_thirty_robots_are_driven_and_registered_again_at_a_new_master(ros: Graph) -> None:
    async with ros.daemon() as daemon, simulated(daemon.tcp, "--robots", "30"):
        await ros.listed("/robot_29/odom")
        for number in range(0, 30, 7):
            await ros.listed(f"/robot_{number}/cmd_vel")
        async with (
            ros.node("listen", "/robot_29/odom", "nav_msgs/Odometry") as listener,
            ros.node("drive", "/robot_29/cmd_vel", "0.2", "20"),
        ):
            message = await listener.read("message")
            while message["fields"]["pose"]["pose"]["position"]["x"] < 0.05:
                message = await listener.read("message")
        await ros.kill()
        await daemon.read_log("ros1.master_lost")
        await ros.start()
        await daemon.read_log("ros1.registered_again")
        await ros.listed("/robot_29/odom")
