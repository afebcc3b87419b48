"""A TopicInfo that is lost on the line while a robot is driven: it can be stopped all the same."""

import asyncio

import pytest

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import Id
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, announcement, fake_device, robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.waiting import TIMEOUT_S, expect

ZERO = (0.0, 0.0)
CURVE = (0.2, 0.5)
VELOCITY_FIRST = robot_topics()
VELOCITY_LAST = [
    topic(EndpointKind.PUBLISHER, 125, "/robot_0/odometry", "geometry_msgs/Pose2D"),
    topic(EndpointKind.SUBSCRIBER, 99 + 1, "/robot_0/reset_odometry", "std_msgs/Empty"),
    topic(EndpointKind.SUBSCRIBER, 101, "/robot_0/velocity_commands", "geometry_msgs/Twist"),
]


def without(type_name: str, infos: list[DeviceEndpoint]) -> bytes:
    return announcement([info for info in infos if info.type != type_name])


def without_velocity(infos: list[DeviceEndpoint]) -> bytes:
    return without("geometry_msgs/Twist", infos)


async def velocity(device: FakeDevice, topic_id: int, *, other_than: bytes) -> bytes:
    while (payload := await device.frame(topic_id)) == other_than:
        pass
    return payload


async def moving(host: Daemon, device: FakeDevice, topic_id: int) -> bytes:
    await expect(lambda: host.hub.robots.find("robot_0").link)
    robot = host.hub.robots.find("robot_0")
    drive_gate(robot, PlanarVelocity(x_m_s=0.2, yaw_rad_s=0.5), owner="test")
    return await velocity(device, topic_id, other_than=bytes(48))


async def test_a_stop_still_reaches_it_and_its_topics_are_requested_again() -> None:
    infos, topic_id = VELOCITY_LAST, 101
    async with daemon() as host, fake_device(host.tcp, infos) as device:
        driven = await moving(host, device, topic_id)
        topic_requests = host.hub.links.all()[0].session.counts.topic_requests
        await device.send(without_velocity(infos))
        await expect(lambda: host.hub.links.all()[0].session.counts.negotiations == 2)
        assert (await host.rest("POST", "/api/stop"))[0] == 200
        assert await velocity(device, topic_id, other_than=driven) == bytes(48)
        await expect(lambda: host.hub.links.all()[0].session.counts.topic_requests > topic_requests)
        await device.send(announcement(infos))
        await expect(lambda: host.hub.links.all()[0].session.counts.negotiations == 3)
        assert await moving(host, device, topic_id) == driven


async def test_robot_that_never_announces_its_velocity_again_receives_zero_before_it_is_removed() -> None:
    infos, topic_id = VELOCITY_FIRST, 100
    async with daemon() as host, fake_device(host.tcp, infos) as device:
        driven = await moving(host, device, topic_id)
        for count in (2, 3, 4):
            drive_gate(
                host.hub.robots.find("robot_0"),
                PlanarVelocity(x_m_s=0.2, yaw_rad_s=0.5),
                owner="test",
            )
            await device.send(without_velocity(infos))
            await expect(lambda count=count: host.hub.links.all()[0].session.counts.negotiations == count)  # type: ignore[misc]
        assert host.hub.robots.find("robot_0").link is None
        async with asyncio.timeout(TIMEOUT_S):
            assert await velocity(device, topic_id, other_than=driven) == bytes(48)


async def test_a_robot_whose_odometry_is_lost_drives_on_and_its_topics_are_requested_again() -> None:
    async with daemon() as host, fake_device(host.tcp, VELOCITY_FIRST) as device:
        await moving(host, device, 100)
        robot, session = host.hub.robots.find("robot_0"), host.hub.links.all()[0].session
        topic_requests = session.counts.topic_requests
        await device.send(without("geometry_msgs/Pose2D", VELOCITY_FIRST))
        await expect(lambda: session.counts.negotiations == 2)
        assert robot.link is not None
        assert robot.gate.may_move
        await expect(lambda: session.counts.topic_requests > topic_requests)
        await device.send(announcement(VELOCITY_FIRST))
        await expect(lambda: session.counts.negotiations == 3)
        assert robot.link is not None


@pytest.mark.slow
async def test_robot_without_velocity_is_stopped_after_the_third_announcement_without_it() -> None:
    """A client drives the robot all the time."""
    type_name = "geometry_msgs/Twist"
    async with daemon() as host, fake_device(host.tcp, VELOCITY_FIRST) as device:
        await moving(host, device, 100)
        robot = host.hub.robots.find("robot_0")
        await device.send(without(type_name, VELOCITY_FIRST))
        last = b""
        async with asyncio.timeout(TIMEOUT_S):
            while robot.link is not None or last != bytes(48):
                frame = await device.next()
                if frame.topic_id == 100:
                    last = frame.payload
                elif frame.topic_id == Id.PUBLISHER:
                    await device.send(without(type_name, VELOCITY_FIRST))
                if robot.link is not None:
                    drive_gate(robot, PlanarVelocity(x_m_s=0.2, yaw_rad_s=0.5), owner="test")
        await expect(lambda: not robot.gate.may_move)  # it has repeated its zero
        assert all(not each.gate.may_move for each in host.hub.robots.drivables())
