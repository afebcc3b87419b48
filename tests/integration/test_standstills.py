"""Stops and locks report what was measured since, not what was sent."""

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator

import pytest

from hostlink.client import StandstillState, connect
from hostlink.hub.standstills import WAIT_S
from tests.support.background import meanwhile
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

SPEED_M_S = 0.15


@contextlib.asynccontextmanager
async def moving(device: FakeDevice) -> AsyncIterator[None]:
    """Send odometry that moves at SPEED_M_S, regardless of commands."""

    async def send() -> None:
        for number in itertools.count():
            await device.send(pose(SPEED_M_S * number / 10))
            await asyncio.sleep(0.1)

    async with meanwhile(send()):
        yield


def now_s() -> float:
    return asyncio.get_running_loop().time()


async def drive(host: Daemon) -> int:
    return (await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.15, "angular": 0.0}'))[0]


async def test_lock_answer_has_the_measured_time_and_speed() -> None:
    async with daemon() as host, simulated_robot(host.tcp) as body:
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 5)

        async def repeat() -> None:
            while True:
                await drive(host)
                await asyncio.sleep(0.1)

        async with meanwhile(repeat()):  # the source continues without reading the answers
            await expect(lambda: body.speed_m_s > 0.1)
            status, robot = await host.rest("POST", "/api/robots/robot_0/lock")
            assert (status, robot["name"], robot["locked"]) == (200, "robot_0", True)
            measured = robot["standstill"]
            assert (measured["state"], measured["reason"]) == ("stopped", "")
            assert 0.0 < measured["after_s"] < WAIT_S
            assert abs(measured["speed_m_s"]) < 0.005
            assert abs(body.speed_m_s) < 0.005


async def test_a_robot_that_moves_on_is_reported_after_the_wait_and_its_zero_is_not_delayed() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, moving(device):
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 5)
        assert await drive(host) == 200
        assert await device.velocity_other_than((0.0, 0.0)) == (SPEED_M_S, 0.0)
        began_s = now_s()
        async with asyncio.TaskGroup() as tasks:
            stop = tasks.create_task(host.rest("POST", "/api/stop"))
            assert await device.velocity_other_than((SPEED_M_S, 0.0)) == (0.0, 0.0)
            assert not stop.done()
        (robot,) = stop.result()[1]["robots"]
        assert now_s() - began_s >= WAIT_S
        assert robot["standstill"]["state"] == "moving"
        assert robot["standstill"]["speed_m_s"] == pytest.approx(SPEED_M_S, abs=0.1)
        assert robot["standstill"]["reason"] == "the stop was sent, and its device has not obeyed it yet"


async def test_invalid_wait_is_refused_but_the_robot_is_stopped() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device:
        await expect(lambda: host.hub.robots.has("robot_0"))
        assert await drive(host) == 200
        assert await device.velocity_other_than((0.0, 0.0)) == (SPEED_M_S, 0.0)
        status, answer = await host.rest("POST", "/api/robots/robot_0/stop?wait_s=soon")
        assert (status, answer["error"]["kind"]) == (400, "BadRequest")
        assert await device.velocity_other_than((SPEED_M_S, 0.0)) == (0.0, 0.0)


async def test_the_standstill_can_be_read_without_a_stop() -> None:
    async with daemon() as host, simulated_robot(host.tcp), connect(host.url) as me:
        await expect(lambda: host.hub.robots.find("robot_0").odometry.count > 5)
        stops = host.hub.robots.find("robot_0").gate.counts.stops
        assert (await me.standstill())["robot_0"].state is StandstillState.STOPPED
        assert (await host.rest("GET", "/api/robots/robot_0/standstill"))[1]["standstill"]["state"] == "stopped"
        assert host.hub.robots.find("robot_0").gate.counts.stops == stops
