"""RobotsHere: the robots and boards of this daemon alone, for a component through which other daemons use them."""

from collections.abc import Callable, Hashable
from typing import TYPE_CHECKING, NamedTuple, Unpack

from hostlink.core.hub.participant import Participant
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.hub.robot_handle import How
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import DeviceGone

if TYPE_CHECKING:
    from hostlink.core.hub.robots import Robots


class RobotHere(NamedTuple):
    """A robot of this daemon, in short. `topics`: names in the graph of its commands, its odometry and its reset."""

    name: str
    link: int | None  # None: its device is not connected
    epoch: int
    lock_reason: str | None
    also_at: tuple[str, ...]
    topics: tuple[str, ...]


class RobotsHere:
    """Robots and boards of this daemon. No call reaches a robot that a component announces, in a circle of daemons.

    Methods are synchronous. `by` is who asks, for texts.
    """

    def __init__(self, robots: "Robots") -> None:
        self._robots = robots
        self._noted: set[str] = set()  # robots with other hosts

    def all(self) -> list[RobotHere]:
        """Return the robots by name, connected or not yet forgotten."""
        return [_in_short(robot) for robot in self._robots.here()]

    def get(self, name: str) -> RobotHere | None:
        """Return the robot of this name; None if there is none."""
        robot = self._robots.get_here(name)
        return None if robot is None else _in_short(robot)

    def state(self, name: str) -> RobotState:
        """Return the state of a robot.

        Raises:
            UnknownTopic: there is none of this name.
        """
        return self._robots.find_here(name).state(loop_time_s())

    def require(self, name: str, *, driver: Callable[[], Hashable] | None = None) -> None:
        """Check that there is a robot of this name.

        Raises:
            UnknownTopic: there is none. A stream of the source that `driver` returns moves no later robot of this name.
        """
        self._robots.find_here(name, driver=driver)

    def drive(
        self,
        participant: Participant,
        name: str,
        velocity: PlanarVelocity,
        **how: Unpack[How],
    ) -> PlanarVelocity:
        """Drive a robot; as `Host.drive`.

        Raises:
            UnknownTopic, NoRole, CommandRefused, FrameTooLarge, WrongType: as `Host.drive`.
            DeviceGone: other daemons have a robot of this name, too; or its device is not connected.
        """
        robot = self._robots.find_here(name)
        if robot.also_at and not velocity.is_zero:
            raise DeviceGone(name, f"several robots have this name, also at {', '.join(robot.also_at)}")
        return participant.drive(robot, velocity, **how)

    def stop(self, name: str | None, *, by: str) -> None:
        """Stop a robot; None: every robot and board.

        Raises:
            UnknownTopic: there is none of this name.
            HostlinkError: the zero does not fit a device; all others have been stopped.
        """
        if name is None:
            self._robots.stop_all_here(by=by)
        else:
            self._robots.find_here(name).stop_here(by=by)

    def lock(self, name: str | None, reason: str, *, by: str | None = None) -> None:
        """Stop a robot and refuse commands until it is unlocked; None: every robot and board, also later ones.

        Raises:
            UnknownTopic: there is none of this name.
            HostlinkError: the zero does not fit a device; it is locked nevertheless.
        """
        if name is None:
            self._robots.lock_all_here(reason, by=by)
        else:
            self._robots.find_here(name).lock_here(reason, by=by)

    def unlock(self, name: str | None, *, by: str) -> None:
        """Admit commands of a robot again; None: of every board, and of the robots whose name no other daemon has.

        Raises:
            UnknownTopic: there is none of this name.
        """
        if name is None:
            self._robots.unlock_all_here(by=by)
        else:
            self._robots.find_here(name).unlock(by=by)

    def endpoints(self, name: str | None) -> list[CommandEndpoint]:
        """Return the endpoints that command a motion and are not a robot's: those of a robot's devices; None: all.

        Raises:
            UnknownTopic: there is none of this name.
        """
        return self._robots.endpoints() if name is None else self._robots.find_here(name).unguarded_endpoints

    @property
    def boards_lock_reason(self) -> str | None:
        """Reason of the lock of all boards; None: they are not locked."""
        return self._robots.boards.lock_reason

    def note_others(self, name: str, hosts: tuple[str, ...]) -> None:
        """Note the other hosts of a robot of this name: a stop or a lock of it reaches them, too.

        Programs here drive the robot that is here, and programs of other daemons neither. Nothing is noted of a robot
        that is not here.
        """
        robot = self._robots.get_here(name)
        if robot is not None:
            robot.also_at = hosts
            (self._noted.add if hosts else self._noted.discard)(name)

    def close(self) -> None:
        """Forget the other hosts."""
        for name in tuple(self._noted):
            self.note_others(name, ())


def _in_short(robot: LocalRobot) -> RobotHere:
    shown = robot.shown
    topics = (*(each.name for each in shown.commands), shown.odometry, shown.reset)
    link = None if robot.connection is None else robot.connection.link.number
    found = tuple(filter(None, topics))
    return RobotHere(robot.name, link, robot.admission.epoch, robot.admission.lock_reason, robot.also_at, found)
