"""Commands of teleop for a held key: only to the device that was connected at the key press. In virtual time."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from typing import cast

from hostlink.cli.driving import HOLD_S, SEND_INTERVAL_S, ZEROS, Driving, Key
from hostlink.cli.teleop import KeyDriver, WatchedRobot
from hostlink.client import RobotState
from hostlink.robot.admission import LEASE_S
from tests.support.fake_device import robot_topics
from tests.support.memory_client import memory_host
from tests.support.participants import ROBOT, VELOCITY_ID, Scene, scene
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import within

SPEED_M_S = 0.2
INTERRUPTED = "it was stopped, locked or reconnected while this source was driving"


class Person:
    """A person at the keys."""

    def __init__(self, made: Scene, driving: Driving, driver: KeyDriver) -> None:
        self.made, self.driving, self.driver = made, driving, driver

    async def press(self, name: str, seconds: float) -> None:
        """Hold a key, which repeats, and send what is due."""
        now_s = asyncio.get_running_loop().time
        until_s = now_s() + seconds
        while now_s() < until_s:
            self.driving.receive(Key(name), now_s())
            await self.driver.send_due()
            await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def person() -> AsyncIterator[Person]:
    driving = Driving(layout="original", linear_m_s=SPEED_M_S, angular_rad_s=0.8)
    async with scene() as made, memory_host(made.hub, made.tasks) as me:
        watched = WatchedRobot(cast(RobotState, {}))
        yield Person(made, driving, KeyDriver(me.robot(ROBOT, priority=60), driving, watched))


def speeds(device: ScriptedDevice) -> list[float]:
    """The forward speeds that a device received, in m/s."""
    return [struct.unpack("<6d", payload)[0] for payload in device.payloads(VELOCITY_ID)]


@within(person)
async def test_a_device_that_connects_again_is_not_driven_by_a_key_that_is_still_pressed(keys: Person) -> None:
    await keys.press("w", 0.2)
    robot = keys.made.hub.robots.find(ROBOT)
    await keys.made.robot.aclose()
    new = ScriptedDevice(keys.made.hub, robot_topics(ROBOT), address="10.0.0.1")
    commands = robot.gate.counts.commands
    await keys.press("w", 2 * LEASE_S)
    assert INTERRUPTED in keys.driver.refusal
    assert set(speeds(new)) <= {0.0}
    assert robot.gate.counts.commands - commands <= ZEROS
    await asyncio.sleep(2 * HOLD_S)
    await keys.press("w", 0.2)  # pressed again
    assert speeds(new)[-1] == SPEED_M_S
    assert keys.driver.refusal == ""


@within(person)
async def test_key_that_stays_pressed_through_a_lock_does_not_drive_after_the_unlock(keys: Person) -> None:
    await keys.press("w", 0.2)
    robot = keys.made.hub.robots.find_here(ROBOT)
    robot.lock("a hand in the wheel")
    await keys.press("w", 2 * SEND_INTERVAL_S)
    assert "locked: a hand in the wheel" in keys.driver.refusal
    robot.unlock()
    await keys.press("w", 4 * SEND_INTERVAL_S)
    assert robot.gate.current.is_zero
    await asyncio.sleep(2 * HOLD_S)
    await keys.press("w", 0.2)
    assert speeds(keys.made.robot)[-1] == SPEED_M_S
