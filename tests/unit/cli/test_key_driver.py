"""Commands of teleop for a held key: only to the device that was connected at the key press. In virtual time."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import cast

from hostlink.cli.driving import HOLD_S, SEND_INTERVAL_S, ZEROS, Action, Driving, Key
from hostlink.cli.teleop import KeyDriver, WatchedRobot
from hostlink.client import Robot, RobotState
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.events import LET_GO, EventKind, RobotEvent
from tests.support.fake_device import robot_topics
from tests.support.memory_client import memory_host
from tests.support.participants import ROBOT, VELOCITY_ID, Scene, scene
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual

SPEED_M_S = 0.2
INTERRUPTED = "it was stopped, locked or reconnected while this source was driving"


class Person:
    """A person at the keys."""

    def __init__(self, made: Scene, robot: Robot) -> None:
        self.made = made
        self.driving = Driving(layout="original", linear_m_s=SPEED_M_S, angular_rad_s=0.8)
        self.watched = WatchedRobot(cast(RobotState, {}))
        self.driver = KeyDriver(robot, self.driving, self.watched)

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
    async with scene() as made, memory_host(made.hub, made.tasks) as me:
        yield Person(made, me.robot(ROBOT, priority=60))


def at_the_keys(test: Callable[[Person], Awaitable[None]]) -> None:
    async def run() -> None:
        async with person() as keys:
            await test(keys)

    run_virtual(run())


def speeds(device: ScriptedDevice) -> list[float]:
    """The forward speeds that a device received, in m/s."""
    return [struct.unpack("<6d", payload)[0] for payload in device.payloads(VELOCITY_ID)]


def test_pressed_key_drives_and_its_release_lets_go() -> None:
    async def test(keys: Person) -> None:
        reasons: list[object] = []

        def note(event: RobotEvent) -> None:
            if event.kind is EventKind.STOPPED and event.robot == ROBOT:
                reasons.append(event.facts["reason"])

        await keys.press("w", 0.3)
        assert speeds(keys.made.robot)[-1] == SPEED_M_S
        keys.made.hub.events.observe("test", note)
        keys.driving.receive(Key("w", Action.RELEASED), asyncio.get_running_loop().time())
        for _ in range(30):
            await keys.driver.send_due()
            await asyncio.sleep(0.03)
        assert speeds(keys.made.robot)[-1] == 0.0
        assert reasons == [LET_GO]
        assert keys.driver.refusal == ""

    at_the_keys(test)


def test_a_device_that_connects_again_is_not_driven_by_a_key_that_is_still_pressed() -> None:
    async def test(keys: Person) -> None:
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

    at_the_keys(test)


def test_key_that_stays_pressed_through_a_lock_does_not_drive_after_the_unlock() -> None:
    async def test(keys: Person) -> None:
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

    at_the_keys(test)


def test_a_confirmed_unlock_ends_only_the_lock_that_was_asked_about() -> None:
    async def test(keys: Person) -> None:
        robot = keys.made.hub.robots.find_here(ROBOT)
        locks = []
        for number, reason in enumerate(("a foot", "a hand")):
            robot.lock(reason)
            keys.watched.state = cast(RobotState, {"locked": True, "epoch": number, "lock_reason": reason})
            locks.append(keys.driver.lock)
        await keys.driver.unlock(locks[0])
        await keys.driver.unlock(None)
        assert robot.gate.lock_reason == "a hand"
        await keys.driver.unlock(locks[1])
        assert robot.gate.lock_reason is None

    at_the_keys(test)


def test_shifted_key_moves_the_robot_sideways_unless_its_drive_cannot() -> None:
    async def test(keys: Person) -> None:
        keys.driving.receive(Key("a", is_shifted=True), asyncio.get_running_loop().time())
        await keys.driver.send_due()
        await asyncio.sleep(0.05)
        assert struct.unpack("<6d", keys.made.robot.payloads(VELOCITY_ID)[-1])[1] == SPEED_M_S
        keys.watched.state = cast(RobotState, {"kinematics": "differential"})
        await asyncio.sleep(SEND_INTERVAL_S)
        await keys.driver.send_due()
        await asyncio.sleep(0.05)
        newest = struct.unpack("<6d", keys.made.robot.payloads(VELOCITY_ID)[-1])
        assert (newest[1], newest[5]) == (0.0, 0.8)

    at_the_keys(test)
