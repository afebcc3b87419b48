"""The topics by which ROS programs know a robot: odom, tf, cmd_vel."""

import struct
import time

import pytest

from hostlink.core.config import Config, RobotConfig
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import CATALOG, fake_device, pose, robot_topics, topic
from tests.support.participants import publish
from tests.support.rosbridge import client
from tests.support.waiting import expect

ODOM = topic(EndpointKind.PUBLISHER, 126, "/robot_0/odom", "nav_msgs/Odometry")
TF = topic(EndpointKind.PUBLISHER, 127, "/tf", "tf/tfMessage")


def publishers(host: Daemon, name: str) -> set[str]:
    return {str(key) for key in host.hub.topics.find(name).publishers}


async def heard(host: Daemon, *names: str) -> None:
    await expect(lambda: all(host.hub.topics.find(name).subscribers for name in names))


def types(host: Daemon) -> dict[str, str]:
    return {topic.name: topic.type_name for topic in host.hub.topics.all()}


async def test_odometry_and_transform_come_as_ros_programs_expect_them() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odom")
        await program.send(op="subscribe", topic="/tf")
        await heard(host, "/robot_0/odom", "/tf")
        await device.send(pose(1.0, 2.0, 0.0))
        odometry, transform = (await program.receive())["msg"], (await program.receive())["msg"]["transforms"][0]
    assert odometry["pose"]["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert (odometry["header"]["frame_id"], odometry["child_frame_id"]) == ("robot_0/odom", "robot_0/base_link")
    assert odometry["pose"]["covariance"][0] == 0.001
    assert abs(odometry["header"]["stamp"]["secs"] - time.time()) < 5
    assert transform["header"] == odometry["header"]
    assert transform["child_frame_id"] == "robot_0/base_link"
    assert transform["transform"]["translation"] == {"x": 1.0, "y": 2.0, "z": 0.0}


async def test_derived_topics_without_subscribers_are_not_published() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
        assert host.hub.topics.find("/robot_0/odom").messages == 0
        assert "/clock" not in types(host)


async def test_an_invalid_pose_is_not_published() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odom")
        await heard(host, "/robot_0/odom")
        await device.send(encode(125, struct.pack("<3d", float("nan"), 0.0, 0.0)) + pose(1.0))
        assert (await program.receive())["msg"]["pose"]["pose"]["position"]["x"] == 1.0


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cmd_vel", {"linear": {"x": 0.2}, "angular": {"z": 0.5}}),
        ("cmd_vel_stamped", {"header": {"stamp": {"secs": 5}}, "twist": {"linear": {"x": 0.2}, "angular": {"z": 0.5}}}),
    ],
    ids=["Twist", "an old stamp"],
)
async def test_cmd_vel_drives_through_the_same_gate(name: str, message: dict[str, object]) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        async with client(host) as program:
            await program.send(op="publish", topic=f"/robot_0/{name}", msg=message)
            assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.5)
            assert host.hub.robots.find("robot_0").gate.owner_name == "client 1"
        assert await device.velocity_other_than((0.2, 0.5)) == (0.0, 0.0)


async def test_velocity_that_the_gate_sends_is_published_on_cmd_vel_too() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()), client(host) as program:
        await expect(lambda: not host.hub.robots.find("robot_0").gate.is_active)
        await program.send(op="subscribe", topic="/robot_0/cmd_vel")
        await heard(host, "/robot_0/cmd_vel")
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg={"linear": {"x": 5.0}})
        assert (await program.receive())["msg"]["linear"]["x"] == 1.0


async def test_names_that_the_device_uses_itself_are_the_devices() -> None:
    own = [
        topic(EndpointKind.SUBSCRIBER, 102, "/robot_0/cmd_vel", "std_msgs/Bool"),
        topic(EndpointKind.PUBLISHER, 126, "/robot_0/odom", "std_msgs/String"),
        TF,
    ]
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), *own]) as device:
        known = types(host)
        assert (known["/robot_0/cmd_vel"], known["/robot_0/odom"]) == ("std_msgs/Bool", "std_msgs/String")
        assert known["/tf"] == "tf/tfMessage"
        publish(host.hub, "/robot_0/cmd_vel", {"data": True}, source="test")
        assert await device.frame(102) == b"\x01"


async def test_device_that_connects_later_reclaims_its_names_and_releases_them_again() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()), client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odom", type="nav_msgs/Odometry")
        await heard(host, "/robot_0/odom")
        async with fake_device(host.tcp, [ODOM._replace(id=125)]):
            await expect(lambda: "hostlink" not in publishers(host, "/robot_0/odom"))
        await expect(lambda: publishers(host, "/robot_0/odom") == {"hostlink"})


async def test_a_page_with_a_wrong_type_blocks_no_topic() -> None:
    async with daemon() as host, client(host) as program:
        for name in ("cmd_vel", "odom", "odometry"):
            await program.send(op="advertise", topic=f"/robot_0/{name}", type="std_msgs/String")
        await expect(lambda: len(host.hub.topics.all()) == 5)
        async with fake_device(host.tcp, robot_topics()) as device:
            assert types(host)["/robot_0/odometry"] == "geometry_msgs/Pose2D"
            assert types(host)["/robot_0/cmd_vel"] == "geometry_msgs/Twist"
            await program.send(op="publish", topic="/robot_0/cmd_vel", type="std_msgs/String", msg={"data": "go"})
            assert "wanted geometry_msgs/Twist, got std_msgs/String" in (await program.receive())["msg"]
            await program.send(op="subscribe", topic="/robot_0/odom")
            await heard(host, "/robot_0/odom")
            await device.send(pose(1.0))
            assert (await program.receive())["msg"]["pose"]["pose"]["position"]["x"] == 1.0


CONFIGURED = Config(robots={"robot_1": RobotConfig(odom_frame="odom", base_frame="base_link")})


@pytest.mark.parametrize(
    ("config", "plain", "order"),
    [
        (Config(), "", ("robot_0", "robot_1")),
        (Config(robots={"robot_1": RobotConfig()}), "", ("robot_1", "robot_0")),
        (CONFIGURED, "robot_1", ("robot_1", "robot_0")),
    ],
)
async def test_frames_have_the_name_of_the_robot_whichever_connects_first(
    config: Config, plain: str, order: tuple[str, str]
) -> None:
    found = {}
    async with (
        daemon(config) as host,
        fake_device(host.tcp, robot_topics(order[0])) as first,
        fake_device(host.tcp, robot_topics(order[1])) as second,
        client(host) as program,
    ):
        await program.send(op="subscribe", topic="/tf")
        await heard(host, "/tf")
        for name, device in zip(order, (first, second), strict=True):
            await device.send(pose(1.0))
            transform = (await program.receive())["msg"]["transforms"][0]
            found[name] = (transform["header"]["frame_id"], transform["child_frame_id"])
    assert found == {
        name: ("odom", "base_link") if name == plain else (f"{name}/odom", f"{name}/base_link") for name in order
    }


async def test_names_frames_and_the_transform_are_configurable() -> None:
    robot = RobotConfig(
        odom_topic="/odom", cmd_vel_topic="/cmd_vel", cmd_vel_stamped_topic="", odom_frame="world",
        base_frame="base_footprint", publish_tf=False,
    )  # fmt: skip
    async with (
        daemon(Config(robots={"robot_0": robot})) as host,
        fake_device(host.tcp, robot_topics()) as device,
        client(host) as program,
    ):
        assert {"/odom", "/cmd_vel"} < types(host).keys()
        assert not {"/robot_0/odom", "/robot_0/cmd_vel", "/robot_0/cmd_vel_stamped", "/tf"} & types(host).keys()
        await program.send(op="subscribe", topic="/odom")
        await heard(host, "/odom")
        await device.send(pose(1.0))
        odometry = (await program.receive())["msg"]
    assert (odometry["header"]["frame_id"], odometry["child_frame_id"]) == ("world", "base_footprint")


async def test_a_robot_with_an_odometry_of_its_own_keeps_what_it_publishes() -> None:
    wheels = topic(EndpointKind.PUBLISHER, 125, "/robot_0/wheels", "nav_msgs/Odometry", buffer_bytes=1024)
    type_ = CATALOG.message("nav_msgs/Odometry")
    assert type_ is not None
    covariance = [float(number) for number in range(36)]
    twist = {"twist": {"linear": {"x": 0.2, "y": -0.1}, "angular": {"z": 0.5}}}
    message = type_.encode(
        {
            "pose": {"pose": {"position": {"x": 3.0}, "orientation": {"w": 1.0}}, "covariance": covariance},
            "twist": twist,
        }
    )
    async with (
        daemon() as host,
        fake_device(host.tcp, [wheels, robot_topics()[1]]) as device,
        client(host) as program,
    ):
        await program.send(op="subscribe", topic="/robot_0/odom")
        await heard(host, "/robot_0/odom")
        await device.send(encode(125, message))
        odometry = (await program.receive())["msg"]
        shown = await host.get("/api/robots/robot_0/odometry")
    assert odometry["pose"]["pose"]["position"]["x"] == 3.0
    assert odometry["twist"]["twist"]["linear"] == {"x": 0.2, "y": -0.1, "z": 0.0}
    assert shown["twist"] == {"linear_m_s": 0.2, "linear_y_m_s": -0.1, "angular_rad_s": 0.5}
    assert odometry["pose"]["covariance"] == covariance
    assert odometry["twist"]["covariance"][35] == 0.01


async def test_a_robot_that_is_away_gives_its_names_up_to_one_that_is_connected() -> None:
    config = Config(robots={"b": RobotConfig(cmd_vel_topic="/robot_0/cmd_vel")})
    async with daemon(config) as host:
        async with fake_device(host.tcp, robot_topics()):
            pass
        await expect(lambda: host.hub.robots.find("robot_0").link is None)
        assert host.hub.topics.find("/robot_0/cmd_vel").is_gated
        async with fake_device(host.tcp, robot_topics("b")) as device:
            await device.velocity_of((0.0, 0.0))
            publish(host.hub, "/robot_0/cmd_vel", PlanarVelocity(0.1).encode())
            await device.velocity_of((0.1, 0.0))
        await expect(lambda: host.hub.robots.find("b").link is None)
        assert host.hub.robots.find("b").heard >= {"/robot_0/cmd_vel"}


async def test_a_robot_that_leaves_keeps_its_velocity_topics_alone_until_it_is_forgotten() -> None:
    async with daemon() as host:
        async with fake_device(host.tcp, robot_topics()):
            assert "/robot_0/odom" in types(host)
        velocities = {f"/robot_0/{leaf}" for leaf in ("cmd_vel", "cmd_vel_stamped", "velocity_commands")}
        await expect(lambda: types(host).keys() == {"/diagnostics", "/rosout", *velocities})
        host.hub.robots.forget("robot_0")
        assert types(host).keys() == {"/diagnostics", "/rosout"}
