"""Standstills measures a stop by odometry. LockServices provides <robot>/lock and <robot>/unlock.

Every API says `lock` for the emergency stop.
"""

import asyncio
from collections.abc import Mapping, Sequence
from functools import partial

from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.hub.gates import Gates
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.robots import Robots
from hostlink.core.robot.odometry import OdometrySnapshot
from hostlink.core.robot.standstill import Speeds, Standstill, StandstillState, StopWatch, sentence

WAIT_S = 1.5  # the simulated robot is stopped after 0.2 s, and its odometry shows that 0.4 s later
MAX_WAIT_S = 10.0
POLL_S = 0.05
MAX_WATCHED = 256  # robots of all concurrent measurements; a single one may have more
_TYPE = "std_srvs/Trigger"
_LOCK, _UNLOCK = "lock", "unlock"


class Standstills:
    """Measurement of stops by odometry. During a flood of stops, some are reported as unknown instead."""

    def __init__(self) -> None:
        self._watched = 0

    async def measure(self, robots: Sequence[AnyRobot], since_s: float, *, wait_s: float = WAIT_S) -> list[Standstill]:
        """Return the state of each robot after a stop at `since_s`, when all are stopped, or after `wait_s`."""
        if self._watched > 0 and self._watched + len(robots) > MAX_WATCHED:
            reason = "too many stops are measured at once"
            return [Standstill(StandstillState.UNKNOWN, reason=reason) for _ in robots]
        self._watched += len(robots)
        watches = [(robot, StopWatch(since_s, robot.answer_s)) for robot in robots]
        until_s = since_s + wait_s
        try:
            while True:
                now_s = asyncio.get_running_loop().time()
                is_awaited = False
                for robot, watch in watches:
                    odometry = None if watch.is_standing else robot.measured(now_s)
                    if odometry is not None:  # without odometry, waiting would measure nothing
                        watch.observe(_speeds(odometry), now_s - odometry.age_s)
                        is_awaited |= not watch.is_standing
                if not is_awaited or now_s >= until_s:
                    return [watch.result(robot.why_moving, robot.why_unknown) for robot, watch in watches]
                await asyncio.sleep(min(POLL_S, until_s - now_s))
        finally:
            self._watched -= len(robots)


def _speeds(odometry: OdometrySnapshot) -> Speeds:
    twist = odometry.twist
    if twist is None:
        return Speeds(is_moving=odometry.is_moving is not False)
    return Speeds(twist.speed_m_s, twist.yaw_rad_s)


class LockServices:
    """Services to lock and unlock robots, of this daemon and of others, for any program of the graph."""

    def __init__(self, robots: Robots, gates: Gates, standstills: Standstills, participant: Participant) -> None:
        """`participant` provides the services. It must be of the daemon, so that no program can take the names over."""
        self._robots, self._gates, self._standstills, self._participant = robots, gates, standstills, participant
        self._served: set[str] = set()

    def update(self, name: str) -> None:
        """Provide the services of a known robot, and withdraw those of a forgotten one."""
        is_known = self._robots.has(name)
        if is_known and name not in self._served:
            self._served.add(name)
            lock, unlock = own_services(name)
            # A stop is refused for no field.
            self._participant.provide(lock, _TYPE, partial(self._lock, name), ignores_request=True)
            self._participant.provide(unlock, _TYPE, partial(self._unlock, name))
        elif not is_known and name in self._served:
            self._served.discard(name)
            for service in own_services(name):
                self._participant.withdraw(service)

    async def _lock(self, name: str, _: Mapping[str, object]) -> Mapping[str, object]:
        robot, now_s = self._robots.find(name), asyncio.get_running_loop().time()
        robot.lock(by=f"a call of {name}/{_LOCK}")
        await self._gates.settled()
        measured = (await self._standstills.measure([robot], now_s))[0]
        text = f"{name} is locked until {name}/{_UNLOCK} is called; {sentence(name, measured)}"
        return {"success": measured.state is not StandstillState.MOVING, "message": text}

    async def _unlock(self, name: str, _: Mapping[str, object]) -> Mapping[str, object]:
        self._robots.find(name).unlock(by=f"a call of {name}/{_UNLOCK}")
        await self._gates.settled()
        return {"success": True, "message": f"{name} may be driven"}


def own_services(name: str) -> tuple[str, str]:
    """Return the names of a robot's lock and unlock services."""
    return f"{name}/{_LOCK}", f"{name}/{_UNLOCK}"
