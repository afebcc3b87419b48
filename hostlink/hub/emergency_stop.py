"""EmergencyStop: zero at once, and no command until the release, for one robot; also by services.

The services are <robot>/lock and <robot>/unlock: `lock` is the word of every API.
"""

import asyncio
import contextlib
from collections.abc import Mapping

import structlog

from hostlink.errors import HostlinkError
from hostlink.hub.gates import Gates
from hostlink.hub.participant import Participant
from hostlink.hub.remote_robot import RemoteRobot
from hostlink.hub.robot import Robot
from hostlink.hub.robot_events import EventKind
from hostlink.hub.robots import Robots
from hostlink.hub.standstills import Standstills
from hostlink.logs import printable
from hostlink.robot.presence import SURE_S
from hostlink.robot.standstill import StandstillState, sentence

log = structlog.get_logger()

LOCK_REASON = "emergency stop"  # where none was given
_TYPE = "std_srvs/Trigger"
_LOCK, _UNLOCK = "lock", "unlock"


class EmergencyStop:
    """Which robots are locked."""

    def __init__(self, robots: Robots, gates: Gates, standstills: Standstills, participant: Participant) -> None:
        """`participant` serves the services."""
        self._robots, self._gates, self._standstills, self._participant = robots, gates, standstills, participant
        self._locked: dict[str, Robot] = {}

    def stop(self, robot: Robot | RemoteRobot, reason: str = LOCK_REASON) -> None:
        """Zero at once, and no command until `release`; also while the robot is not connected.

        Raises:
            HostlinkError: the zero does not fit the device; the robot is locked all the same.
        """
        elsewhere = self._gates.elsewhere
        if elsewhere is not None and (isinstance(robot, RemoteRobot) or robot.also_at):
            elsewhere.lock(robot.name, printable(reason))
        if not isinstance(robot, RemoteRobot):
            self.stop_here(robot, reason)

    def stop_here(self, robot: Robot, reason: str) -> None:
        """Lock a robot of this daemon.

        Raises:
            HostlinkError: the zero does not fit the device; the robot is locked all the same.
        """
        robot.locked_link = robot.link
        self._locked[robot.name] = robot
        self._robots.keep(robot)
        try:
            self._gates.lock(self._gates.beside(robot), printable(reason))
        finally:
            log.warning("robot.locked", robot=robot.name, reason=robot.gate.lock_reason)
            self._gates.events.note(EventKind.LOCKED, robot.name, reason=robot.gate.lock_reason)

    def release(self, robot: Robot | RemoteRobot) -> None:
        """Let the robot be driven again.

        Raises:
            DeviceGone: it is not known which robot is meant.
        """
        if isinstance(robot, RemoteRobot):
            robot.check_unique()
            robot.elsewhere.unlock(robot)
            return
        if robot.gate.lock_reason is not None:
            log.warning("robot.unlocked", robot=robot.name, reason=robot.gate.lock_reason)
            self._gates.events.note(EventKind.UNLOCKED, robot.name, reason=robot.gate.lock_reason)
        self._gates.unlock(self._gates.beside(robot))
        self._locked.pop(robot.name, None)
        self._robots.put_away(robot)

    def lock_likewise(self, robot: Robot) -> None:
        """Lock a robot that may be a locked one which has come back under another name."""
        if robot.gate.lock_reason is not None:
            return
        for other in self._locked.values():
            if other.topics.name == robot.topics.name and not _is_surely_there(other):
                with contextlib.suppress(HostlinkError):  # it is locked; a device that refuses a zero obeys nobody
                    self.stop(robot, f"it may be {other.name}: {other.gate.lock_reason}")
                return

    def serve(self, name: str) -> None:
        """Provide the services of the robot of this name; nobody else may provide services of these names."""

        async def lock(_: Mapping[str, object]) -> Mapping[str, object]:
            robot, now_s = self._robots.find(name), asyncio.get_running_loop().time()
            self.stop(robot)
            await self._gates.settled()
            measured = (await self._standstills.measure([robot], now_s))[0]
            text = f"{name} is locked until {name}/{_UNLOCK} is called; {sentence(name, measured)}"
            return {"success": measured.state is not StandstillState.MOVES, "message": text}

        async def unlock(_: Mapping[str, object]) -> Mapping[str, object]:
            self.release(self._robots.find(name))
            await self._gates.settled()
            return {"success": True, "message": f"{name} may be driven"}

        for service, answer in zip(own_services(name), (lock, unlock), strict=True):
            self._participant.provide(service, _TYPE, answer)

    def withdraw(self, name: str) -> None:
        """The robot of this name is forgotten, unless there is another."""
        if not self._robots.has(name):
            for service in own_services(name):
                self._participant.withdraw(service)


def own_services(name: str) -> tuple[str, str]:
    """The names of the services that hostlink has for the robot of this name."""
    return f"{name}/{_LOCK}", f"{name}/{_UNLOCK}"


def _is_surely_there(robot: Robot) -> bool:
    """Whether a locked robot is on the link on which it was locked, and that link lives."""
    link = robot.link
    is_same = link is not None and link is robot.locked_link
    return is_same and link is not None and link.received_at_s > asyncio.get_running_loop().time() - SURE_S
