"""Topic names that two devices share: neither device loses anything by them."""

import struct

import pytest

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, pose, robot_topics, service_server, topic
from tests.support.gates import drive_gate
from tests.support.participants import publish, subscribe
from tests.support.waiting import expect

TWIST, POSE = "geometry_msgs/Twist", "geometry_msgs/Pose2D"
BOTH_WAYS = [topic(EndpointKind.SUBSCRIBER, 100, "/x", TWIST), topic(EndpointKind.PUBLISHER, 125, "/x", POSE)]


async def goes_on(host: Daemon, device: FakeDevice, *, name: str = "robot_0") -> None:
    """The robot can be driven, and tells where it is."""
    await expect(lambda: host.hub.robots.find(name).link)
    drive_gate(host.hub.robots.find(name), PlanarVelocity(x_m_s=0.1), owner="test")
    assert await device.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)
    observed = host.hub.robots.find(name).odometry.count
    await device.send(pose(3.0))
    await expect(lambda: host.hub.robots.find(name).odometry.count == observed + 1)
    assert (await host.get(f"/api/robots/{name}/odometry"))["pose"]["x_m"] == 3.0
    assert not host.hub.isolation.crashes


async def test_one_name_in_both_directions_and_of_two_types() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as honest:
        await expect(lambda: host.hub.robots.find("robot_0").link)
        await _both_ways(host, honest)


async def _both_ways(host: Daemon, honest: FakeDevice) -> None:
    async with fake_device(host.tcp, BOTH_WAYS) as device:
        await expect(lambda: host.hub.robots.find("robot_1").link)
        for message_type in (TWIST, POSE):
            type_ = CATALOG.message(message_type)
            assert type_ is not None
            try:
                publish(host.hub, "/x", type_.encode({}), source="test", type_name=message_type)
            except HostlinkError:
                assert message_type != host.hub.topics.find("/x").type_name
        await device.send(pose(3.0))
        await goes_on(host, device, name="robot_1")
        await goes_on(host, honest)


@pytest.mark.parametrize(("name", "is_first"), [("velocity_commands", True), ("odometry", False), ("odom", True)])
async def test_another_device_publishes_another_type_on_a_robots_topic(name: str, is_first: bool) -> None:
    for type_name in (POSE, TWIST, "nav_msgs/Odometry"):
        other = [topic(EndpointKind.PUBLISHER, 125, f"/robot_0/{name}", type_name)]
        type_ = CATALOG.message(type_name)
        assert type_ is not None
        announcements = [other, robot_topics()] if is_first else [robot_topics(), other]
        async with (
            daemon() as host,
            fake_device(host.tcp, announcements[0]) as first,
            fake_device(host.tcp, announcements[1]) as second,
        ):
            intruder, robot = (first, second) if is_first else (second, first)
            await intruder.send(encode(125, type_.encode({})))
            await goes_on(host, robot)


async def test_odometry_of_a_robot_from_another_publisher_is_refused() -> None:
    async with (
        daemon() as host,
        fake_device(host.tcp, robot_topics()) as device,
        fake_device(host.tcp, [topic(EndpointKind.PUBLISHER, 130, "/robot_0/odometry", POSE)]) as other,
    ):
        await device.send(pose(1.0))
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count == 1)
        for _ in range(3):
            await other.send(encode(130, struct.pack("<3d", 9.0, 9.0, 0.0)))
            publish(host.hub, "/robot_0/odometry", {"x": 9.0}, source="a program")
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 7)
        odometry = await host.get("/api/robots/robot_0/odometry")
        assert (odometry["count"], odometry["pose"]["x_m"]) == (1, 1.0)


async def test_a_device_that_publishes_on_its_own_velocity_topic_does_not_drive_itself() -> None:
    echo = topic(EndpointKind.PUBLISHER, 130, "/robot_0/velocity_commands", TWIST)
    async with daemon() as host, fake_device(host.tcp, [*robot_topics(), echo]) as device:
        await expect(lambda: host.hub.robots.find("robot_0").link)
        await device.send(encode(130, struct.pack("<6d", 0.1, 0, 0, 0, 0, 0)))
        await goes_on(host, device)
        assert host.hub.robots.find("robot_0").gate.counts.commands == 1


async def test_two_robots_that_share_a_velocity_topic_are_both_driven_by_it() -> None:
    def shared(name: str) -> list[DeviceEndpoint]:
        own = topic(EndpointKind.SUBSCRIBER, 101, f"/{name}/velocity_commands", TWIST)
        return [
            topic(EndpointKind.SUBSCRIBER, 100, "/cmd_vel", TWIST),
            own,
            topic(EndpointKind.PUBLISHER, 125, f"/{name}/odometry", POSE),
        ]

    async with daemon() as host, fake_device(host.tcp, shared("a")) as one:
        async with fake_device(host.tcp, shared("b")) as other:
            await expect(lambda: len(host.hub.robots.all()) == 2)
            publish(host.hub, "/cmd_vel", {"linear": {"x": 0.1}}, source="test")
            assert await one.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)
            assert await other.velocity_other_than((0.0, 0.0)) == (0.1, 0.0)
        await expect(lambda: host.hub.robots.find("b").link is None)
        publish(host.hub, "/cmd_vel", {"linear": {"x": 0.2}}, source="test")
        assert await one.velocity_other_than((0.1, 0.0)) == (0.2, 0.0)


@pytest.mark.parametrize("is_first", [True, False])
async def test_emergency_stop_service_cannot_be_replaced(is_first: bool) -> None:
    own = service_server("/robot_0/lock", "std_srvs/Trigger", 130, 105)
    announcements = [own, robot_topics()] if is_first else [robot_topics(), own]
    async with (
        daemon() as host,
        fake_device(host.tcp, announcements[0]),
        fake_device(host.tcp, announcements[1]),
    ):
        await expect(lambda: host.hub.robots.find("robot_0").link)
        answer = await host.hub.services.call("/robot_0/lock", {})
        assert answer["success"] is True
        assert host.hub.robots.find("robot_0").gate.lock_reason == "emergency stop"


async def test_device_that_publishes_transforms_in_the_old_type_blocks_no_other_transforms() -> None:
    frames = [
        topic(EndpointKind.PUBLISHER, 125, "/tf", "tf/tfMessage"),
        topic(EndpointKind.PUBLISHER, 126, "/rosout", "std_msgs/Bool"),
    ]
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        subscribe(host.hub, "/tf", lambda _: None)
        await goes_on(host, device)
        async with fake_device(host.tcp, frames):
            await expect(lambda: host.hub.topics.find("/tf").type_name == "tf/tfMessage")
            await goes_on(host, device)
        await expect(lambda: host.hub.topics.find("/tf").type_name == "tf2_msgs/TFMessage")
        await goes_on(host, device)
