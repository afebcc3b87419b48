"""Answers of stops and locks: what odometry has measured since. A simulated robot in virtual time."""

from hostlink.client import StandstillState
from hostlink.core.hub.standstills import WAIT_S
from tests.support.bench import with_robot
from tests.support.virtual_loop import virtual
from tests.support.waiting import expect


@virtual
async def test_lock_returns_the_measured_time_and_speed() -> None:
    async with with_robot() as (here, robot):
        await here.other.robot("robot_0").drive(0.15, 0.0)  # it is repeated
        await expect(lambda: robot.speed_m_s > 0.1)
        measured = await here.me.robot("robot_0").lock("smoke")
        assert (measured.state, measured.reason) == (StandstillState.STOPPED, "")
        assert measured.after_s is not None
        assert 0.0 < measured.after_s < WAIT_S
        assert measured.speed_m_s is not None
        assert abs(measured.speed_m_s) < 0.005
        assert abs(robot.speed_m_s) < 0.005


@virtual
async def test_standstill_is_measured_without_a_stop() -> None:
    async with with_robot() as (here, _):
        stops = here.robot.gate.counts.stops
        assert (await here.me.standstill())["robot_0"].state is StandstillState.STOPPED
        assert here.robot.gate.counts.stops == stops
