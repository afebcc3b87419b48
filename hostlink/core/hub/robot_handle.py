"""RobotHandle: one robot for a component that drives, stops and follows it."""

from collections.abc import Awaitable, Callable
from typing import NamedTuple, TypedDict, Unpack

from hostlink.core.hub.any_robot import LOCK_REASON, AnyRobot
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.robot_topic_publisher import twist_topic
from hostlink.core.hub.robots import Robots
from hostlink.core.hub.standstills import WAIT_S, Standstills
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.odometry import OdometryEstimator, OdometrySnapshot
from hostlink.core.robot.standstill import Standstill
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.loop_time import loop_time_s


class How(TypedDict, total=False):
    """Keywords of `Participant.drive`: what is known of a command, and how it is meant."""

    priority: int | None
    received_s: float | None
    sent_s: float | None
    epoch: int | None
    is_planar: bool
    take_over: bool
    reason: str


class RecordedMotion(NamedTuple):
    """Topics by which recorded messages tell of a robot's motion, named as in the graph."""

    robot: str
    odometry: tuple[str, str] | None  # topic and type; None: no single topic tells its pose
    commands: str  # topic on which its velocities are Twists
    estimator: OdometryEstimator  # with the robot's settings, which has seen nothing
    present: OdometrySnapshot | None  # its odometry now; None: none arrived


class Measured(NamedTuple):
    """State of a robot after a stop, and what its odometry says of the stop."""

    state: RobotState
    standstill: Standstill


class RobotHandle:
    """One robot, here or at another daemon. It remains the same robot if it disconnects, or is forgotten."""

    __slots__ = ("_robot", "_robots", "_standstills", "name")

    def __init__(self, robot: AnyRobot, robots: Robots, standstills: Standstills) -> None:
        self.name, self._robot, self._robots, self._standstills = robot.name, robot, robots, standstills

    @property
    def is_known(self) -> bool:
        """Whether the robot is not forgotten."""
        return self._robots.is_known(self._robot)

    @property
    def link(self) -> int | None:
        """Number of its device's connection; None if it is not connected."""
        link = self._robot.link
        return None if link is None else link.number

    @property
    def resumed_link(self) -> int:
        """Number of the connection since which no reconnection was an interruption."""
        return self._robot.resumed_link

    @property
    def epoch(self) -> int:
        """Number of its interruptions: commands with an earlier one are refused."""
        return self._robot.admission.epoch

    @property
    def lease_s(self) -> float:
        """Duration for which a command holds."""
        return self._robot.admission.lease_s

    def state(self) -> RobotState:
        """Return its present state."""
        return self._robot.state(loop_time_s())

    def odometry(self) -> OdometrySnapshot | None:
        """Return its newest pose with its age; None before the first."""
        return self._robot.odometry.snapshot(loop_time_s())

    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether it is stopped."""
        return self._robot.why_unknown()

    def recorded_motion(self) -> RecordedMotion | None:
        """Return how recorded messages tell of its motion; None for a robot of another daemon, which has the record."""
        robot = self._robots.get_here(self.name)
        if robot is None or robot is not self._robot:
            return None
        name, type_name = robot.shown.odometry, robot.shown.odometry_type
        odometry = None if name is None or type_name is None else (name, type_name)
        return RecordedMotion(robot.name, odometry, twist_topic(robot), robot.odometry.anew(), self.odometry())

    # -- commands -----------------------------------------------------------------------------------------------------

    def drive(
        self,
        participant: Participant,
        velocity: PlanarVelocity,
        **how: Unpack[How],
    ) -> PlanarVelocity:
        """Drive for the length of a lease; as `Participant.drive`. Return the velocity after the limits."""
        return participant.drive(self._robot, velocity, **how)

    def answer(self, participant: Participant) -> Awaitable[PlanarVelocity] | None:
        """Return the later answer to the newest command of a source; None if `drive` has returned it.

        Raises (when it is awaited):
            DeviceGone: the robot's daemon did not answer in time, or its device is not connected.
            CommandRefused, FrameTooLarge, WrongType, UnknownTopic: the robot's daemon refused the command.
        """
        return self._robot.answer(participant)

    async def driven(self, participant: Participant, limited: PlanarVelocity) -> PlanarVelocity:
        """Wait for the answer to the newest `drive`: `limited` for a robot of this daemon. Raises as `answer`."""
        return await participant.driven(self._robot, limited)

    def limited_by(self, velocity: PlanarVelocity) -> str | None:
        """Return the setting that slows a velocity down most; None if none does, or another daemon has the robot."""
        return self._robot.limited_by(velocity)

    def follow(self, participant: Participant, receive: Callable[[], None]) -> None:
        """Call `receive` after each new pose, until the participant leaves.

        Raises:
            BadRequest: the participant has left.
        """
        participant.follow(self._robot, receive)

    # -- stops --------------------------------------------------------------------------------------------------------

    def stop(self, *, by: str) -> None:
        """Stop the robot, for every source. The zero is sent before this returns.

        Raises:
            HostlinkError: the zero does not fit the device.
        """
        self._robot.stop(by=by)

    def lock(self, reason: str = LOCK_REASON, *, by: str) -> None:
        """Stop the robot at once, and refuse commands until `unlock`.

        Raises:
            HostlinkError: the zero does not fit the device; the robot is locked nevertheless.
        """
        self._robot.lock(reason, by=by)

    def unlock(self, *, by: str) -> None:
        """Admit commands again. It moves nothing.

        Raises:
            DeviceGone: several robots have this name.
        """
        self._robot.unlock(by=by)

    def endpoints(self) -> list[CommandEndpoint]:
        """Return what else its devices take that looks like a command, after a stop or a lock."""
        return self._robot.unguarded_endpoints

    async def measure(self, since_s: float, *, wait_s: float = WAIT_S) -> list[Measured]:
        """Measure whether the robot is stopped since a time. It waits for `wait_s` at most. The result is one."""
        (found,) = await self._standstills.measure([self._robot], since_s, wait_s=wait_s)
        return [Measured(self.state(), found)]
