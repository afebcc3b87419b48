"""Standstills and the lock services: what is said of a robot after a stop."""

import asyncio
import struct

import pytest

from hostlink.core.hub.standstills import MAX_WATCHED, own_services
from hostlink.core.robot.standstill import StandstillState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import BadRequest, UnknownTopic
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.scripted_device import ScriptedDevice


async def send_poses(device: ScriptedDevice, *, speed_m_s: float) -> None:
    number = 0
    while True:
        await device.send(125, struct.pack("<3d", 0.1 * speed_m_s * number, 0.0, 0.0))
        number += 1
        await asyncio.sleep(0.1)


def test_standing_robot_is_measured_before_the_wait_is_over() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        sending = asyncio.get_running_loop().create_task(send_poses(device, speed_m_s=0.0))
        await asyncio.sleep(1.0)
        began_s = made.now_s
        (found,) = await made.hub.standstills.measure([made.robot()], began_s)
        assert found.state is StandstillState.STOPPED
        assert made.now_s - began_s < 1.0
        sending.cancel()

    in_hub(test)


def test_robot_whose_device_answers_late_is_measured_after_that_time() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        sending = asyncio.get_running_loop().create_task(send_poses(device, speed_m_s=0.0))
        await asyncio.sleep(1.0)
        link = made.robot().link
        assert link is not None
        link.session.device_clock.answer_s = 0.3
        began_s = made.now_s
        (found,) = await made.hub.standstills.measure([made.robot()], began_s)
        assert found.state is StandstillState.STOPPED
        assert found.after_s > 0.3
        sending.cancel()

    in_hub(test)


def test_moving_robot_is_reported_after_the_wait_with_its_driver() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        sending = asyncio.get_running_loop().create_task(send_poses(device, speed_m_s=0.3))
        await asyncio.sleep(1.0)
        began_s = made.now_s
        drive_gate(made.robot(), PlanarVelocity(0.3), owner="ann")
        (found,) = await made.hub.standstills.measure([made.robot()], began_s, wait_s=0.4)
        assert found.state is StandstillState.MOVING
        assert "driven by ann" in str(found.reason)
        assert made.now_s - began_s == pytest.approx(0.4, abs=0.06)
        sending.cancel()

    in_hub(test)


def test_robot_without_odometry_is_unknown_at_once() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect()
        began_s = made.now_s
        (found,) = await made.hub.standstills.measure([made.robot()], began_s)
        assert (found.state, found.reason) == (StandstillState.UNKNOWN, "it sends no odometry")
        assert made.now_s == began_s

    in_hub(test)


def test_measurements_at_one_time_are_bounded() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        sending = asyncio.get_running_loop().create_task(send_poses(device, speed_m_s=0.3))
        await asyncio.sleep(1.0)
        robots = [made.robot()] * (MAX_WATCHED + 1)  # one that waits alone may have more
        first = asyncio.get_running_loop().create_task(made.hub.standstills.measure(robots, made.now_s))
        await asyncio.sleep(0.1)
        (found,) = await made.hub.standstills.measure([made.robot()], made.now_s)
        assert (found.state, found.reason) == (StandstillState.UNKNOWN, "too many stops are measured at once")
        assert {each.state for each in await first} == {StandstillState.MOVING}
        (found,) = await made.hub.standstills.measure([made.robot()], made.now_s)
        assert found.state is StandstillState.MOVING
        sending.cancel()

    in_hub(test)


def test_lock_service_with_an_unknown_field_locks() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect()
        answer = await made.hub.join("ann").call("robot_0/lock", {"reason": "smoke"})
        assert answer["success"] is True
        assert made.robot().gate.lock_reason == "emergency stop"

    in_hub(test)


def test_lock_service_of_a_robot_that_moves_on_answers_how_fast() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        sending = asyncio.get_running_loop().create_task(send_poses(device, speed_m_s=0.3))
        await asyncio.sleep(1.0)
        answer = await made.hub.join("ann").call("robot_0/lock", {})
        assert answer["success"] is False
        assert "robot_0 still moves at 0.30 m/s" in str(answer["message"])
        sending.cancel()

    in_hub(test)


def test_services_lock_and_unlock_a_robot_as_long_as_it_is_known() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect()
        ann = made.hub.join("ann")
        answer = await ann.call("robot_0/lock", {})
        assert answer["success"] is True
        assert str(answer["message"]).startswith("robot_0 is locked until robot_0/unlock is called; ")
        assert made.robot().gate.admission.locked_by == "a call of robot_0/lock"
        assert made.robot().gate.lock_reason == "emergency stop"
        with pytest.raises(BadRequest, match="the request has no field 'data'; its fields: none"):
            await ann.call("robot_0/unlock", {"data": 1})
        assert made.robot().gate.lock_reason == "emergency stop"
        assert await ann.call("robot_0/unlock", {}) == {"success": True, "message": "robot_0 may be driven"}
        assert made.robot().gate.lock_reason is None
        await device.aclose()
        await asyncio.sleep(0.05)
        assert made.hub.services.is_offered("robot_0/lock")
        made.hub.robots.forget("robot_0")
        with pytest.raises(UnknownTopic):
            await ann.call("robot_0/lock", {})
        assert own_services("robot_0") == ("robot_0/lock", "robot_0/unlock")

    in_hub(test)
