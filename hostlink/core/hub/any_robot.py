"""AnyRobot: interface of a robot. `robot.py` has those of this daemon, `remote_robot.py` those of other hosts."""

from abc import abstractmethod
from collections.abc import Awaitable, Callable, Hashable, Iterable
from typing import Any

from hostlink.core.hub.gates import VelocityTarget
from hostlink.core.hub.message import Message
from hostlink.core.hub.remote_state import RemoteLink, RemoteOdometry
from hostlink.core.link.link import Link
from hostlink.core.robot.admission import Command
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.names import SURE_S
from hostlink.core.robot.odometry import OdometryEstimator, OdometrySnapshot
from hostlink.core.robot.state import RobotState
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.runtime.logs import printable

LOCK_REASON = "emergency stop"  # default
MAX_LOCK_REASON = 200  # characters, as many as a fleet passes on; a longer reason ends with an ellipsis

Follow = Callable[[Message | None], None]


def shown_reason(reason: str) -> str:
    """Return the reason of a lock as it is kept: printable, and with an ellipsis if it is cut."""
    if len(reason) <= MAX_LOCK_REASON:
        return printable(reason, MAX_LOCK_REASON)
    return printable(reason[: MAX_LOCK_REASON - 1].rstrip(), MAX_LOCK_REASON) + "…"


class AnyRobot(VelocityTarget):
    """Robot, connected or not. Methods are synchronous; another daemon answers later."""

    host: str | None  # name of its daemon; None for this one
    also_at: tuple[str, ...]  # other daemons with a robot of this name
    odometry: OdometryEstimator | RemoteOdometry
    followers: dict[Hashable, Follow]  # called after each new pose; the message is None for a remote robot
    resumed_link: int  # number of the connection since which no reconnection was an interruption

    @property
    @abstractmethod
    def link(self) -> Link | RemoteLink | None:
        """Connection of the device; None if it is not connected."""

    @abstractmethod
    def state(self, now_s: float) -> RobotState:
        """Return the robot's state for all APIs."""

    @abstractmethod
    def command(self, command: Command[PlanarVelocity]) -> PlanarVelocity:
        """Drive for the length of a lease; as `VelocityTarget.command`."""

    @abstractmethod
    def answer(self, owner: Hashable) -> Awaitable[PlanarVelocity] | None:
        """Return the later answer to the newest command of a source; None if `command` has returned it.

        Raises (when it is awaited):
            DeviceGone: the robot's daemon did not answer in time, or its device is not connected.
            CommandRefused, FrameTooLarge, WrongType, UnknownTopic: the robot's daemon refused the command.
        """

    def let_go(self, owner: Hashable, reason: str) -> None:
        """Stop what a source drives, if it is this robot; `reason` is why the source drives no more."""

    @abstractmethod
    def limited_by(self, velocity: PlanarVelocity) -> str | None:
        """Return the setting that slows a velocity down most; None if none does, or for a remote robot."""

    @property
    def unguarded_endpoints(self) -> list[CommandEndpoint]:
        """Return what else its devices take that looks like a command, after a stop or a lock; none of a remote one."""
        return []

    @abstractmethod
    def stop(self, *, by: str | None = None) -> None:
        """Stop the robot and all velocity topics of its devices, within the deceleration limits, for every source.

        What else its devices take that looks like a command is sent a zero, if its type has one.
        `by` is who stops it, for refusals.

        Raises:
            HostlinkError: the zero does not fit the device.
        """

    @abstractmethod
    def lock(self, reason: str = LOCK_REASON, *, by: str | None = None) -> None:
        """Send zero at once, and refuse commands until `unlock`, also while the device is not connected.

        `by` is who locks it, for refusals.

        Raises:
            HostlinkError: the zero does not fit the device; the robot is locked nevertheless.
        """

    @abstractmethod
    def unlock(self, *, by: str | None = None) -> None:
        """Admit commands again. Unlocking moves nothing.

        Raises:
            DeviceGone: several robots have this name.
        """

    @abstractmethod
    def why_moving(self) -> str:
        """Return the reason why the robot moves after a stop."""

    @abstractmethod
    def why_unknown(self) -> str:
        """Return the reason why odometry does not show whether the robot is stopped."""

    @property
    def answer_s(self) -> float:
        """Seconds that the robot's device took to answer the host; 0 if that is not known, and for a remote robot."""
        return 0.0

    def measured(self, now_s: float) -> OdometrySnapshot | None:
        """Return the newest odometry if it is recent enough to show whether the robot moves; else None."""
        odometry = self.odometry.snapshot(now_s)
        return None if self.link is None or odometry is None or odometry.age_s >= SURE_S else odometry


def reason_for_motion(
    *,
    is_played: bool,
    drivers: Iterable[str | None],
    unreachable: str | None,
    velocities: Iterable[PlanarVelocity | Any],
) -> str:
    """Return the reason why a robot moves after a stop."""
    driver = next(filter(None, drivers), None)
    if is_played:
        return "it is a recording, which obeys nobody"
    if driver is not None:
        return f"driven by {driver}"
    if unreachable is not None:
        return unreachable
    if not all(velocity.is_zero for velocity in velocities):
        return "it slows down within its deceleration limits"
    return "the stop was sent, and its device has not obeyed it yet"
