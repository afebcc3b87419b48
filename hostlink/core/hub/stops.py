"""Stops: a stop, a lock and an unlock of every robot and board, and the measurement of a stop, for components."""

from hostlink.core.hub.any_robot import LOCK_REASON
from hostlink.core.hub.gates import Gates
from hostlink.core.hub.robot_handle import Measured
from hostlink.core.hub.robots import Robots
from hostlink.core.hub.standstills import WAIT_S, Standstills
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.runtime.loop_time import loop_time_s


class Stops:
    """Stops of all; `RobotHandle` has the same for one. What is synchronous has sent its zeros before it returns."""

    def __init__(self, robots: Robots, gates: Gates, standstills: Standstills) -> None:
        self._robots, self._gates, self._standstills = robots, gates, standstills

    def stop(self, *, by: str) -> None:
        """Stop every robot and every board. `by`: who stops them, for refusals.

        Raises:
            HostlinkError: the zero does not fit a robot's device; all others have been stopped.
        """
        self._robots.stop_all(by=by)

    def lock(self, reason: str = LOCK_REASON, *, by: str) -> None:
        """Stop every robot and board at once, and refuse commands until `unlock`; also of what connects later.

        Raises:
            HostlinkError: the zero does not fit a robot's device; it is locked nevertheless, and so are all others.
        """
        self._robots.lock_all(reason, by=by)

    def unlock(self, *, by: str) -> None:
        """Admit commands of every robot and board again. It moves nothing.

        Raises:
            DeviceGone: several robots of other daemons have one name; all others are unlocked.
        """
        self._robots.unlock_all(by=by)

    def endpoints(self) -> list[CommandEndpoint]:
        """Return the topics here that command a motion and are not a robot's, with what became of each."""
        return self._robots.endpoints()

    def refusals(self) -> list[str]:
        """Return "robot: reason" of each robot here whose device refused the last velocity."""
        found = ((robot.name, self._robots.refusal(robot)) for robot in self._robots.here())
        return [f"{name}: {reason}" for name, reason in found if reason]

    async def settled(self) -> list[CommandEndpoint]:
        """Wait for the answers of the other daemons that were asked; return such topics of theirs, as `endpoints`.

        Raises:
            DeviceGone: one did not answer.
        """
        return await self._gates.settled()

    async def measure(self, since_s: float, *, wait_s: float = WAIT_S) -> list[Measured]:
        """Measure whether every robot is stopped since a time. It waits for `wait_s` at most."""
        robots = self._robots.all()
        measured = await self._standstills.measure(robots, since_s, wait_s=wait_s)
        now_s = loop_time_s()
        return [Measured(robot.state(now_s), found) for robot, found in zip(robots, measured, strict=True)]
