"""Connections that the hub hands to its guard, and their release."""

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass, field, replace

import pytest

from hostlink.cli.serve import running
from hostlink.config import ApiConfig, Config, LinkConfig, TcpConfig
from hostlink.hub.hub import Hub
from hostlink.protocol.control import TopicInfo, encode_topic_info
from hostlink.protocol.frame import Id, encode
from hostlink.robot.velocity import PlanarVelocity
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics, topic
from tests.support.waiting import expect

CONFIG = Config(tcp=TcpConfig(host="127.0.0.1", port=0), api=ApiConfig(port=0))


@dataclass
class Guard:
    """Remembers what it was told."""

    calls: list[tuple[object, ...]] = field(default_factory=list)
    connections: dict[int, Callable[[], int | None]] = field(default_factory=dict)
    driven: set[int] = field(default_factory=set)

    def watch(
        self, number: int, connection: Callable[[], int | None], *, topic_ids: Sequence[int], claim_bytes: int
    ) -> None:
        self.calls.append(("watch", number, *topic_ids, claim_bytes))
        self.connections[number] = connection

    def beat(self, driven: set[int]) -> None:
        self.driven = set(driven)

    def release(self, number: int) -> None:
        if self.connections.pop(number, None) is not None:
            self.calls.append(("release", number))


@contextlib.asynccontextmanager
async def guarded(config: Config = CONFIG) -> AsyncIterator[tuple[Guard, Hub, tuple[str, int]]]:
    guard = Guard()
    async with running(config, guard=guard) as (hub, addresses):
        yield guard, hub, addresses.tcp
    assert guard.connections == {}


async def announce_again(device: FakeDevice, topics: list[TopicInfo]) -> None:
    infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in topics)
    await device.send(infos + encode(Id.TIME, bytes(8)))


async def test_a_robot_is_watched_from_its_appearance_to_its_end() -> None:
    async with guarded() as (guard, _, address):
        async with fake_device(address, robot_topics()) as device:
            await expect(lambda: guard.calls == [("watch", 1, 100, 512)])
            descriptor = guard.connections[1]()
            assert descriptor is not None
            with socket.socket(fileno=os.dup(descriptor)) as same:
                assert same.getpeername() == device.address
        await expect(lambda: guard.calls[-1] == ("release", 1))


async def test_a_beat_names_the_link_of_a_robot_from_its_command_to_its_stop() -> None:
    async with guarded() as (guard, hub, address), fake_device(address, robot_topics()) as device:
        await expect(hub.robots.all)
        pilot, robot = hub.join("pilot"), hub.robots.find("robot_0")
        await expect(lambda: guard.calls and not guard.driven)
        pilot.drive(robot, PlanarVelocity(0.2))
        await device.velocity_of((0.2, 0.0))
        await expect(lambda: guard.driven == {1})
        pilot.drive(robot, PlanarVelocity())
        await expect(lambda: guard.driven == set())


async def test_a_second_velocity_topic_is_watched_too() -> None:
    second = topic(Id.SUBSCRIBER, 107, "/robot_0/arm_vel", "geometry_msgs/Twist")
    async with guarded() as (guard, _, address):
        async with fake_device(address, [second, *robot_topics()]):
            await expect(lambda: guard.calls[-1:] == [("watch", 1, 100, 107, 512)])
        await expect(lambda: guard.calls[-1] == ("release", 1))


async def test_device_that_is_not_a_robot_is_not_watched() -> None:
    async with guarded() as (guard, hub, address):
        async with fake_device(address, [topic(Id.PUBLISHER, 125, "/scan", "sensor_msgs/LaserScan")]):
            await expect(lambda: hub.topics.find_or_none("/scan"))
        assert guard.calls == []


async def test_the_guard_is_notified_of_another_id_and_of_larger_frames() -> None:
    async with guarded() as (guard, _, address), fake_device(address, robot_topics()) as device:
        await expect(lambda: guard.calls)
        odometry, velocity, reset = robot_topics()
        await announce_again(device, [odometry, velocity._replace(topic_id=104), reset._replace(buffer_bytes=2048)])
        await expect(lambda: guard.calls[-1] == ("watch", 1, 104, 2048))


async def test_a_device_that_is_a_robot_no_more_is_released() -> None:
    async with guarded() as (guard, _, address), fake_device(address, robot_topics()) as device:
        await expect(lambda: guard.calls)
        await announce_again(device, [robot_topics()[0]._replace(name="/robot_0/map")])  # another sketch, no lost frame
        await expect(lambda: guard.calls[-1] == ("release", 1))


async def test_robot_that_reconnects_is_watched_on_its_new_connection_alone() -> None:
    async with guarded() as (guard, _, address), fake_device(address, robot_topics()):
        await expect(lambda: guard.calls)
        async with fake_device(address, robot_topics()) as again:
            await again.send(pose(1.0))
            await expect(lambda: list(guard.connections) == [2])


@pytest.mark.parametrize("end", ["idle", "hang_up"])
async def test_every_end_of_a_link_releases_it(end: str) -> None:
    config = replace(CONFIG, link=LinkConfig(idle_timeout_s=0.3, silence_timeout_s=0.3))
    async with guarded(config) as (guard, _, address), fake_device(address, robot_topics()) as device:
        await expect(lambda: guard.calls)
        if end == "hang_up":
            device.hang_up()
        await expect(lambda: guard.calls[-1] == ("release", 1))


async def test_a_daemon_without_a_guard_works_alike() -> None:
    async with running(CONFIG) as (hub, addresses), fake_device(addresses.tcp, robot_topics()):
        await expect(lambda: hub.robots.find("robot_0").link is not None)
        await asyncio.sleep(0)
