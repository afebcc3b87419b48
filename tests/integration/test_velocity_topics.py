"""A device that takes a Twist and tells no pose, or a second Twist of a robot: its velocity has a lease, too."""

import asyncio
import struct

import pytest

from hostlink.protocol.frame import Id
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, robot_topics, topic
from tests.support.participants import publish
from tests.support.rosbridge import client
from tests.support.waiting import expect

ZERO = bytes(48)
NO_POSE = [topic(Id.SUBSCRIBER, 100, "/cart/cmd_vel", "geometry_msgs/Twist")]
SECOND = [*robot_topics(), topic(Id.SUBSCRIBER, 102, "/robot_0/arm_vel", "geometry_msgs/Twist")]
DRIVE = {"op": "publish", "topic": "", "msg": {"linear": {"x": 0.3}}}


async def heard(device: FakeDevice, topic_id: int, *, is_zero: bool) -> None:
    """Wait for a velocity of this kind."""
    async with asyncio.timeout(5):
        while (await device.frame(topic_id) == ZERO) != is_zero:
            pass


async def driven(host: Daemon, device: FakeDevice, topic_id: int, name: str) -> None:
    await expect(lambda: host.hub.topics.find(name).devices)
    publish(host.hub, name, {"linear": {"x": 0.3}}, source="test")
    await heard(device, topic_id, is_zero=False)


@pytest.mark.parametrize(
    ("infos", "topic_id", "name"), [(NO_POSE, 100, "/cart/cmd_vel"), (SECOND, 102, "/robot_0/arm_vel")]
)
class TestBoth:
    async def test_a_driver_that_vanishes_leaves_it_standing(self, infos: list, topic_id: int, name: str) -> None:  # type: ignore[type-arg]
        async with daemon() as host, fake_device(host.tcp, infos) as device:
            await expect(lambda: host.hub.topics.find(name).devices)
            async with client(host) as program:
                await program.say(**{**DRIVE, "topic": name})
                await heard(device, topic_id, is_zero=False)
                began_s = asyncio.get_running_loop().time()
            await heard(device, topic_id, is_zero=True)
            assert asyncio.get_running_loop().time() - began_s < 0.9
            for _ in range(2):
                await heard(device, topic_id, is_zero=True)

    async def test_one_that_is_commanded_again_and_again_moves_on(
        self,
        infos: list,
        topic_id: int,
        name: str,  # type: ignore[type-arg]
    ) -> None:
        async with daemon() as host, fake_device(host.tcp, infos) as device:
            await driven(host, device, topic_id, name)
            for _ in range(8):
                publish(host.hub, name, {"linear": {"x": 0.3}}, source="test")
                assert await device.frame(topic_id) != ZERO
                await asyncio.sleep(0.1)

    async def test_the_stop_of_all_stops_it(self, infos: list, topic_id: int, name: str) -> None:  # type: ignore[type-arg]
        async with daemon() as host, fake_device(host.tcp, infos) as device:
            await driven(host, device, topic_id, name)
            began_s = asyncio.get_running_loop().time()
            assert (await host.rest("POST", "/api/stop"))[0] == 200
            await heard(device, topic_id, is_zero=True)
            assert asyncio.get_running_loop().time() - began_s < 0.4

    async def test_the_daemons_end_stops_it(self, infos: list, topic_id: int, name: str) -> None:  # type: ignore[type-arg]
        async with daemon() as host, fake_device(host.tcp, infos) as device:
            await driven(host, device, topic_id, name)
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(host.hub.shutdown())
                frames = []
                while not frames or frames[-1].topic_id != Id.STOP:
                    frames.append(await device.next())
            velocities = [frame.payload for frame in frames if frame.topic_id == topic_id]
            assert velocities
            assert velocities[-1] == ZERO

    async def test_a_link_that_ends_from_here_leaves_it_standing(
        self,
        infos: list,
        topic_id: int,
        name: str,  # type: ignore[type-arg]
    ) -> None:
        async with daemon() as host, fake_device(host.tcp, infos) as device:
            await driven(host, device, topic_id, name)
            link = host.hub.links()[0]
            link.heard_at_s -= 60.0
            link.wake()
            if infos is NO_POSE:
                await heard(device, topic_id, is_zero=True)
            await device.closed()


async def test_a_locked_robot_is_locked_on_its_second_topic() -> None:
    async with daemon() as host, fake_device(host.tcp, SECOND) as device:
        await driven(host, device, 102, "/robot_0/arm_vel")
        assert (await host.rest("POST", "/api/robots/robot_0/lock"))[0] == 200
        await heard(device, 102, is_zero=True)
        async with client(host) as program:
            await program.say(**{**DRIVE, "topic": "/robot_0/arm_vel"})
            assert "locked" in (await program.hear())["msg"]


async def test_a_twist_that_is_no_velocity_by_its_name_stays_as_it_was_sent() -> None:
    plain = [topic(Id.SUBSCRIBER, 100, "/show/target", "geometry_msgs/Twist")]
    async with daemon() as host, fake_device(host.tcp, plain) as device:
        await expect(lambda: host.hub.topics.find("/show/target").devices)
        publish(host.hub, "/show/target", {"linear": {"x": 0.3}}, source="test")
        assert struct.unpack("<6d", await device.frame(100))[0] == 0.3
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.8):
                await device.frame(100)
