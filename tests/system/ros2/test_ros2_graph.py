"""`hostlink ros2` with a daemon: an independent rclpy node lists, reads, calls and sets what is in the graph."""

import asyncio
import math
import struct
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest

from hostlink.client import Host, HostlinkError, connect
from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.robot.velocity import Twist
from tests.support.daemon import daemon
from tests.support.fake_device import CATALOG, fake_device, pose, robot_topics, topic
from tests.support.ros2 import DISCOVERY_S, Peer, bridge, domain, peer
from tests.support.waiting import expect, expect_never

pytestmark = pytest.mark.timeout(300)

SCAN = topic(EndpointKind.PUBLISHER, 126, "/robot_0/scan", "sensor_msgs/LaserScan")
TEXT = topic(EndpointKind.PUBLISHER, 127, "/robot_0/text", "std_msgs/String")
SERVO = topic(EndpointKind.SUBSCRIBER, 110, "/robot_0/servo", "std_msgs/Float64")


@pytest.fixture
def environment() -> Iterator[dict[str, str]]:
    with domain() as found:
        yield found


async def repeat_until(is_so: Callable[[], object], act: Callable[[], Awaitable[object]]) -> None:
    """Do it again and again until this is true."""
    async with asyncio.timeout(DISCOVERY_S):
        while not is_so():
            await act()
            await asyncio.sleep(0.05)


async def drive(other: Peer, name: str, linear_m_s: float, left_m_s: float = 0.0) -> None:
    """Publish a Twist ten times a second."""
    velocity = {"linear": {"x": linear_m_s, "y": left_m_s}}
    await other.do("publish", topic=name, type="geometry_msgs/msg/Twist", msg=velocity, rate_hz=10)


async def until_called(host: Host, service: str, request: dict[str, object]) -> object:
    """The answer of a service, as soon as it is there."""
    async with asyncio.timeout(DISCOVERY_S):
        while True:
            try:
                return await host.call(service, request)
            except HostlinkError as error:
                assert "no service named" in str(error)  # noqa: PT017 - any other error is one
            await asyncio.sleep(0.1)


async def test_the_topics_of_a_robot_are_read_by_rclpy_and_come_and_go_with_it(environment: dict[str, str]) -> None:
    scan = CATALOG.message("sensor_msgs/LaserScan")
    assert scan is not None
    async with daemon() as server, bridge(environment, server.url), peer(environment) as other:
        await other.do("subscribe", topic="/robot_0/odometry", type="geometry_msgs/msg/Pose2D")
        await other.do("subscribe", topic="/robot_0/odom", type="nav_msgs/msg/Odometry", best_effort=True)
        await other.do("subscribe", topic="/robot_0/scan", type="sensor_msgs/msg/LaserScan")
        async with fake_device(server.tcp, [*robot_topics(), SCAN, TEXT]) as device:
            types = {
                "/robot_0/text": "std_msgs/msg/String",
                "/robot_0/odom": "nav_msgs/msg/Odometry",
                "/robot_0/cmd_vel": "geometry_msgs/msg/Twist",
                "/robot_0/cmd_vel_stamped": "geometry_msgs/msg/TwistStamped",
            }
            await other.until_graph(lambda graph: types.items() <= graph["topics"].items())
            await other.until_graph(lambda graph: "hostlink" in graph["nodes"])
            await other.until_graph(lambda graph: "/robot_0/lock" in graph["services"])
            fields = {"header": {"frame_id": "laser"}, "ranges": [0.5, math.inf], "angle_max": 1.0}
            frames = pose(1.5, -2.0, 0.25) + encode(126, scan.encode(fields))
            await repeat_until(
                lambda: all(other.messages(f"/robot_0/{name}") for name in ("odometry", "odom", "scan")),
                lambda: device.send(frames),
            )
            assert other.messages("/robot_0/odometry")[-1] == {"x": 1.5, "y": -2.0, "theta": 0.25}
            odom = other.messages("/robot_0/odom")[-1]
            assert odom["header"]["frame_id"] == "robot_0/odom"
            assert odom["child_frame_id"] == "robot_0/base_link"
            assert odom["header"]["stamp"]["sec"] > 1_600_000_000
            assert len(odom["pose"]["covariance"]) == 36
            read = other.messages("/robot_0/scan")[-1]
            assert (read["header"]["frame_id"], read["ranges"], read["angle_max"]) == ("laser", [0.5, math.inf], 1.0)
        await other.until_graph(lambda graph: "/robot_0/text" not in graph["topics"])
        await other.until_graph(lambda graph: "/robot_0/cmd_vel" in graph["topics"])  # its robot is still known


@pytest.mark.long
async def test_a_type_that_is_not_installed_is_reported_once_by_name_and_the_others_work(
    environment: dict[str, str],
) -> None:
    async with daemon() as server, bridge(environment, server.url) as process, peer(environment) as other:
        for name in ("robot_0", "robot_1"):
            async with fake_device(server.tcp, robot_topics(name)):
                await other.until_graph(lambda graph, name=name: f"/{name}/odom" in graph["topics"])
                await expect(lambda: process.has_reported("tf2_msgs/msg/TFMessage is not installed"))
        assert len([line for line in process.reports if "tf2_msgs" in line]) == 1


async def test_message_of_rclpy_reaches_the_device_and_programs(environment: dict[str, str]) -> None:
    async with (
        daemon() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        fake_device(server.tcp, [*robot_topics(), SERVO]) as device,
        connect(server.url) as program,
        program.subscribe("/chat", type_name="std_msgs/String") as chat,
    ):
        fields = {"topic": "/robot_0/servo", "type": "std_msgs/msg/Float64", "msg": {"data": math.inf}, "rate_hz": 20}
        await other.do("publish", **fields)
        await other.do(
            "publish", topic="/chat", type="std_msgs/msg/String", msg={"data": "hä"}, rate_hz=20, best_effort=True
        )
        async with asyncio.timeout(DISCOVERY_S):
            while True:
                frame = await device.next()
                if frame.topic_id == SERVO.id:
                    break
        assert frame.payload == struct.pack("<d", math.inf)
        async with asyncio.timeout(DISCOVERY_S):
            assert await anext(chat) == {"data": "hä"}


@pytest.mark.long
async def test_latched_topic_reaches_later_subscribers_both_ways(environment: dict[str, str]) -> None:
    async with (
        daemon() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        connect(server.url) as me,
        connect(server.url) as later,
    ):
        async with me.advertise("/here", "std_msgs/String", is_latched=True):
            await me.publish("/here", {"data": "a"})
            await other.until_graph(lambda graph: "/here" in graph["topics"])
            await other.do("subscribe", topic="/here", type="std_msgs/msg/String", latched=True)
            await expect(lambda: other.messages("/here") == [{"data": "a"}], timeout_s=DISCOVERY_S)
        await other.do("publish", topic="/there", type="std_msgs/msg/String", msg={"data": "b"}, latched=True)
        async with asyncio.timeout(DISCOVERY_S), me.subscribe("/there", type_name="std_msgs/String") as early:
            assert await anext(early) == {"data": "b"}
            async with later.subscribe("/there", type_name="std_msgs/String") as late:
                assert await anext(late) == {"data": "b"}


async def test_topic_that_both_sides_publish_and_read_is_not_sent_back(environment: dict[str, str]) -> None:
    async with (
        daemon() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        connect(server.url) as me,
        me.advertise("/chat", "std_msgs/String"),
        me.subscribe("/chat", type_name="std_msgs/String") as chat,
    ):
        await other.do("subscribe", topic="/chat", type="std_msgs/msg/String")
        await other.do("publish", topic="/chat", type="std_msgs/msg/String", msg={"data": "there"}, rate_hz=5)
        async with asyncio.timeout(DISCOVERY_S):
            assert await anext(chat) == {"data": "there"}
        await other.do("silence", topic="/chat")
        await repeat_until(
            lambda: other.messages("/chat").count({"data": "here"}) >= 3, lambda: me.publish("/chat", {"data": "here"})
        )
        await expect_never(lambda: other.messages("/chat").count({"data": "here"}) >= 100, for_s=1.0)
        own = chat.pop_all().count({"data": "here"})
        assert other.messages("/chat").count({"data": "here"}) <= own < 100  # a program reads its own, as in ROS


@pytest.mark.long
async def test_qualities_that_do_not_match_are_reported_by_name(environment: dict[str, str]) -> None:
    async with (
        daemon() as server,
        bridge(environment, server.url) as process,
        peer(environment) as other,
        fake_device(server.tcp, robot_topics()),
    ):
        await other.do("subscribe", topic="/robot_0/odometry", type="geometry_msgs/msg/Pose2D", latched=True)
        await expect(
            lambda: any("robot_0/odometry" in line and "DURABILITY" in line for line in process.reports),
            timeout_s=DISCOVERY_S,
        )
        publisher = ["hostlink", "geometry_msgs/msg/Pose2D", "RELIABLE", "VOLATILE"]
        await other.until_end("/robot_0/odometry", "publishers", publisher)
        subscriber = ["hostlink", "geometry_msgs/msg/Twist", "BEST_EFFORT", "VOLATILE"]
        await other.until_end("/robot_0/cmd_vel", "subscribers", subscriber)


async def test_services_go_both_ways(environment: dict[str, str]) -> None:
    async with (
        daemon() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        fake_device(server.tcp, robot_topics()),
        connect(server.url) as me,
    ):
        answer = await other.answer("call", "response", service="/robot_0/lock", type="std_srvs/srv/Trigger")
        assert answer["msg"]["success"]
        assert (await me.robot("robot_0").state())["locked"]
        await other.do("serve", service="/lamp", type="std_srvs/srv/SetBool", msg={"success": True, "message": "on"})
        assert await until_called(me, "/lamp", {"data": True}) == {"success": True, "message": "on"}
        assert other.events("request")[0]["msg"] == {"data": True}
        services = (await me.call("/rosapi/services", {}))["services"]
        assert not [name for name in services if name.endswith("get_parameters")]


@pytest.mark.long
async def test_a_call_that_the_daemon_refuses_is_answered_as_far_as_ros_2_can(environment: dict[str, str]) -> None:
    async def fail(_: object) -> dict[str, object]:
        raise HostlinkError("the lamp is broken")

    async with (
        daemon() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        connect(server.url) as me,
        me.serve("/lamp", "std_srvs/Trigger", fail),
    ):
        answer = await other.answer("call", "response", service="/lamp", type="std_srvs/srv/Trigger")
        assert not answer["msg"]["success"]
        assert "the lamp is broken" in answer["msg"]["message"]


@pytest.mark.long
async def test_client_that_waits_for_a_service_offers_none(environment: dict[str, str]) -> None:
    """ROS 2 lists a service that has a client and no server: it must not be taken over from who offers it later."""

    async def answer(_: object) -> dict[str, object]:
        return {"success": True, "message": "on"}

    async with (
        daemon() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        connect(server.url) as me,
    ):
        await other.do("call", service="/lamp", type="std_srvs/srv/Trigger")
        await expect_never(lambda: server.hub.services.is_offered("/lamp"), for_s=2.0)
        async with me.serve("/lamp", "std_srvs/Trigger", answer):
            await expect(lambda: other.events("response"))
    assert other.events("response")[0]["msg"]["message"] == "on"


async def test_parameters_are_the_node_s_and_setting_one_there_sets_it_here(environment: dict[str, str]) -> None:
    config = Config(parameters={"/robot_0/gain": 1.5, "name": "a", "/robot_0/pid": [1.0, 2.0]})
    async with (
        daemon(config) as server,
        bridge(environment, server.url),
        peer(environment) as other,
        connect(server.url) as me,
    ):
        names = ["robot_0.gain", "name", "robot_0.pid"]

        async def until_read(gain: float) -> list[object]:
            async with asyncio.timeout(DISCOVERY_S):
                while True:
                    read = await other.answer("param", "param", verb="get", node="/hostlink", names=names)
                    if read["lines"][0] == gain:
                        return list(read["lines"])

        assert await until_read(1.5) == [1.5, "a", [1.0, 2.0]]
        changed = {"verb": "set", "names": ["robot_0.gain"], "values": ["2.5"]}
        assert (await other.answer("param", "param", node="/hostlink", **changed))["lines"] == [True]
        await expect(lambda: server.hub.parameters["/robot_0/gain"] == 2.5)
        await me.call("/rosapi/set_param", {"name": "/robot_0/gain", "value": "3.5"})
        await until_read(3.5)


@pytest.mark.long
async def test_a_parameter_is_set_listed_described_and_deleted_as_ros2_param_does(environment: dict[str, str]) -> None:
    config = Config(parameters={"/robot_0/gain": 1.5})
    async with daemon(config) as server, bridge(environment, server.url), peer(environment) as other:

        async def param(verb: str, *names: str, **fields: Any) -> list[Any]:
            answer = await other.answer("param", "param", verb=verb, node="/hostlink", names=list(names), **fields)
            return list(answer["lines"])

        listed: list[Any] = []

        async def list_all() -> None:
            listed[:] = await param("list")

        await repeat_until(lambda: "robot_0.gain" in listed, list_all)
        assert await param("set", "rover.kp", values=["0.5"]) == [True]
        assert server.hub.parameters == {"/robot_0/gain": 1.5, "/rover/kp": 0.5}
        assert await param("set", "rover.kp", values=["[1, 2]"]) == [True]  # another type
        assert await param("set", "rover.name", "robot_0.gain", values=["anna", "2"]) == [True, True]
        assert server.hub.parameters == {"/robot_0/gain": 2, "/rover/kp": [1, 2], "/rover/name": "anna"}
        assert await param("get", "rover.kp", "rover.name", "robot_0.gain") == [[1, 2], "anna", 2]
        await list_all()
        assert {"robot_0.gain", "rover.kp", "rover.name", "use_sim_time"} <= set(listed)
        assert await param("describe", "rover.kp", "rover.name") == ["rover.kp: 7", "rover.name: 4"]

        # what the daemon refuses fails here, with its reason, and changes nothing
        (reason,) = await param("set", "rover.far", values=["1099511627776"])
        assert "int32" in str(reason)
        (reason,) = await param("set", "/rover/kp", values=["1"])
        assert "as robot_0.gain" in str(reason)
        (reason,) = await param("set", "rover.kp", "rover.far", values=["3", "1099511627776"], atomic=True)
        assert "int32" in str(reason)
        assert server.hub.parameters == {"/robot_0/gain": 2, "/rover/kp": [1, 2], "/rover/name": "anna"}
        assert await param("list") == listed
        assert await param("get", "rover.kp") == [[1, 2]]

        assert await param("set", "use_sim_time", values=["false"]) == [True]  # the node's own
        assert await param("delete", "rover.name") == [True]
        assert server.hub.parameters == {"/robot_0/gain": 2, "/rover/kp": [1, 2]}
        assert "rover.name" not in await param("list")


@pytest.mark.long
async def test_a_parameter_that_the_token_may_not_set_is_refused_in_ros_2_too(environment: dict[str, str]) -> None:
    tokens = (TokenConfig(name="reader", role="read", token="a-token-of-a-reader"),)
    config = Config(parameters={"/robot_0/gain": 1.5}).with_tables(api=ApiConfig(tokens=tokens))
    async with (
        daemon(config) as server,
        bridge(environment, server.url, "--token", "a-token-of-a-reader"),
        peer(environment) as other,
    ):
        answer = await other.answer(
            "param", "param", verb="set", node="/hostlink", names=["robot_0.gain"], values=["2.5"]
        )
        assert "may only read" in str(answer["lines"][0])
        assert server.hub.parameters == {"/robot_0/gain": 1.5}


@pytest.mark.long
async def test_two_domains_know_nothing_of_each_other(environment: dict[str, str]) -> None:
    with domain() as elsewhere:
        async with (
            daemon() as one,
            daemon() as two,
            bridge(environment, one.url),
            bridge(elsewhere, two.url),
            peer(environment) as here,
            peer(elsewhere) as there,
            fake_device(one.tcp, robot_topics("a")),
            fake_device(two.tcp, robot_topics("b")),
        ):
            first = await here.until_graph(lambda graph: "/a/odom" in graph["topics"])
            second = await there.until_graph(lambda graph: "/b/odom" in graph["topics"])
            assert "/b/odom" not in first["topics"]
            assert "/a/odom" not in second["topics"]


@pytest.mark.long
async def test_a_namespace_and_a_remap_are_those_of_rclpy(environment: dict[str, str]) -> None:
    arguments = ("--ros-args", "-r", "__ns:=/site", "-r", "robot_0/odom:=/odom")
    async with (
        daemon() as server,
        bridge(environment, server.url, *arguments),
        peer(environment) as other,
        fake_device(server.tcp, robot_topics()) as device,
    ):
        graph = await other.until_graph(lambda graph: {"/odom", "/site/robot_0/odometry"} <= graph["topics"].keys())
        assert "/site/robot_0/odom" not in graph["topics"]
        await drive(other, "/site/robot_0/cmd_vel", 0.2)
        assert (await device.velocity_other_than((0.0, 0.0)))[0] > 0


@pytest.mark.long
async def test_sideways_velocity_of_rclpy_is_limited_and_passed(environment: dict[str, str]) -> None:
    config = Config(robots={"robot_0": RobotConfig(max_wheel_m_s=0.3, wheel_separation_m=0.2)})
    async with (
        daemon(config) as server,
        bridge(environment, server.url),
        peer(environment) as other,
        fake_device(server.tcp, robot_topics()) as device,
    ):
        await other.until_graph(lambda graph: "/robot_0/odom" in graph["topics"])
        await drive(other, "/robot_0/cmd_vel", 0.0, 0.9)
        async with asyncio.timeout(DISCOVERY_S):
            while (twist := Twist.decode(await device.frame(100))).is_zero:
                pass
        assert twist == pytest.approx(Twist(linear_y_m_s=0.3))
        shown = await server.get("/api/robots/robot_0")
        assert shown["velocity"] == {"linear_m_s": 0.0, "linear_y_m_s": pytest.approx(0.3), "angular_rad_s": 0.0}


@pytest.mark.long
async def test_use_sim_time_stamps_with_the_time_of_clock(environment: dict[str, str]) -> None:
    async with (
        daemon() as server,
        bridge(environment, server.url, "--ros-args", "-p", "use_sim_time:=true"),
        peer(environment) as other,
        fake_device(server.tcp, robot_topics()) as device,
    ):
        await other.do("subscribe", topic="/robot_0/odom", type="nav_msgs/msg/Odometry")
        clock = {"clock": {"sec": 77, "nanosec": 5}}
        await other.do("publish", topic="/clock", type="rosgraph_msgs/msg/Clock", msg=clock, rate_hz=20)

        def is_stamped() -> bool:
            stamps = [message["header"]["stamp"] for message in other.messages("/robot_0/odom")]
            return {"sec": 77, "nanosec": 5} in stamps

        await repeat_until(is_stamped, lambda: device.send(pose(0.1)))


async def test_a_device_s_log_lines_are_on_rosout(environment: dict[str, str]) -> None:
    async with (
        daemon() as server,
        bridge(environment, server.url),
        peer(environment) as other,
        fake_device(server.tcp, robot_topics()) as device,
    ):
        await other.do("subscribe", topic="/rosout", type="rcl_interfaces/msg/Log")
        text = b"battery low"
        line = encode(Id.LOG, b"\x02" + struct.pack("<I", len(text)) + text)

        def lines() -> list[dict[str, object]]:
            return [line for line in other.messages("/rosout") if line["msg"].endswith("battery low")]

        await repeat_until(lines, lambda: device.send(line))
        assert lines()[0]["level"] == 30
