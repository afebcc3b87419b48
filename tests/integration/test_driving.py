"""A connection that ends while its program drives, or its robot moves: the robot receives a zero."""

import pytest

from hostlink.core.robot.events import OWNER_LEFT
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.daemon import daemon, stops_of
from tests.support.fake_device import fake_device, robot_topics
from tests.support.gates import drive_gate
from tests.support.rosbridge import client
from tests.support.waiting import expect

ZERO, CURVE = (0.0, 0.0), (0.2, 0.5)


async def test_a_robot_that_sends_no_more_but_still_reads_receives_a_zero_before_its_link_ends() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await expect(lambda: host.hub.robots.find("robot_0").link)
        drive_gate(host.hub.robots.find("robot_0"), PlanarVelocity(0.2, 0.0, 0.5))
        assert await device.velocity_other_than(ZERO) == CURVE
        device.end_sending()
        assert await device.velocity_other_than(CURVE) == ZERO
        await device.closed()


@pytest.mark.parametrize("way", ["close", "cut"])
async def test_robot_stands_when_the_web_socket_of_its_driver_ends(way: str) -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        reasons = stops_of(host, "robot_0")
        twist = {"linear": {"x": 0.2}, "angular": {"z": 0.5}}
        await program.send(op="publish", topic="/robot_0/velocity_commands", msg=twist)
        assert await device.velocity_other_than(ZERO) == CURVE
        if way == "close":
            await program.socket.close()
        else:
            connection = program.socket._response.connection
            assert connection is not None
            assert connection.transport is not None
            connection.transport.abort()
        assert await device.velocity_other_than(CURVE) == ZERO
        assert reasons == [OWNER_LEFT] or host.was_paused
        assert [await device.velocity() for _ in range(2)] == [ZERO, ZERO]
