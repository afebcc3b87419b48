"""Standstills: what the odometry of robots says after a stop or a lock. It waits; the stop has been sent before."""

import asyncio
from collections.abc import Sequence

from hostlink.hub.gates import Gates
from hostlink.hub.remote_robot import RemoteRobot
from hostlink.hub.robot import Robot
from hostlink.robot.presence import SURE_S
from hostlink.robot.standstill import OLD_S, Speeds, Standstill, StandstillState, StopWatch

WAIT_S = 1.5  # the simulated robot stands after 0.2 s, and its odometry shows that 0.4 s later
MAX_WAIT_S = 10.0
POLL_S = 0.05
MAX_WATCHED = 256  # robots, by all who wait; one who waits alone may have more


class Standstills:
    """Measures; a flood of stops is measured in part only, and what is not measured is said to be unknown."""

    def __init__(self, gates: Gates) -> None:
        self._gates = gates
        self._watched = 0

    async def measure(
        self, robots: Sequence[Robot | RemoteRobot], since_s: float, *, wait_s: float = WAIT_S
    ) -> list[Standstill]:
        """What each of these robots does after a stop at `since_s`; returns when all stand, after `wait_s` at most."""
        if self._watched > 0 and self._watched + len(robots) > MAX_WATCHED:
            reason = "too many stops are measured at once"
            return [Standstill(StandstillState.UNKNOWN, reason=reason) for _ in robots]
        self._watched += len(robots)
        try:
            return await self._measure(robots, since_s, since_s + wait_s)
        finally:
            self._watched -= len(robots)

    async def _measure(self, robots: Sequence[Robot | RemoteRobot], since_s: float, until_s: float) -> list[Standstill]:
        watches = [StopWatch(since_s) for _ in robots]
        while True:
            now_s = asyncio.get_running_loop().time()
            is_awaited = False
            for robot, watch in zip(robots, watches, strict=True):
                if not watch.is_standing:
                    is_awaited |= _observe(watch, robot, now_s)
            if not is_awaited or now_s >= until_s:
                break
            await asyncio.sleep(min(POLL_S, until_s - now_s))
        return [
            watch.result(self._why_moving(robot), _why_unknown(robot))
            for robot, watch in zip(robots, watches, strict=True)
        ]

    def _why_moving(self, robot: Robot | RemoteRobot) -> str:
        drivables = [robot] if isinstance(robot, RemoteRobot) else self._gates.beside(robot)
        drivers = [each.gate.owner_name for each in drivables if each.gate.owner_name is not None]
        if robot.is_played:
            return "it is a recording, which obeys nobody"
        if drivers:
            return f"driven by {drivers[0]}"
        if robot.refusals.cause is not None:
            return f"its device cannot receive the stop: {robot.refusals.cause}"
        if any(not each.gate.current.is_zero for each in drivables):
            return "it slows down within its deceleration limits"
        return "the stop was sent, and its device has not obeyed it yet"


def _observe(watch: StopWatch, robot: Robot | RemoteRobot, now_s: float) -> bool:
    """Observe the newest odometry; returns whether waiting for more may tell more."""
    odometry = robot.odometry.snapshot(now_s)
    if robot.link is None or odometry is None or odometry.age_s >= SURE_S:
        return False
    watch.observe(Speeds(odometry.twist.speed_m_s, odometry.twist.yaw_rad_s), now_s - odometry.age_s)
    return not watch.is_standing


def _why_unknown(robot: Robot | RemoteRobot) -> str:
    if robot.link is None:
        return "its device is not connected"
    if robot.odometry.count == 0:
        return "it sends no odometry"
    if isinstance(robot, RemoteRobot):
        return f"no odometry of it has come from {robot.host} since the stop"
    if robot.link.silent_s > OLD_S:
        return f"nothing has come from its device for {robot.link.silent_s:.1f} s"
    return "no odometry has come since the stop"
