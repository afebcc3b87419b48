"""Robot: one robot of a host, as a script drives and reads it."""

from collections.abc import AsyncIterator, Mapping
from typing import Any, cast, overload
from urllib.parse import quote

from hostlink.client.connection import HostConnection
from hostlink.client.driver import VelocitySender
from hostlink.client.http_client import CLOSE_TIMEOUT_S, HttpClient, endpoints, measured
from hostlink.client.motion import Begin, OnProgress, drive_for, follow, line, require_pose, turn
from hostlink.client.views import Driven, Motion, Odometry, Refusal, RobotState, StoppedRobot
from hostlink.core.robot.velocity import PlanarVelocity

PRIORITY = 50  # of a program; a person at the keys is 60
WAIT_S = 1.5  # for the odometry of a robot that was stopped


class Robot:
    """Handle of one robot of a host, from `Host.robot`."""

    def __init__(
        self, name: str, priority: int, *, http: HttpClient, driver: VelocitySender, connection: HostConnection
    ) -> None:
        self.name = name.strip("/")
        self.priority = priority
        self._http, self._driver, self._connection = http, driver, connection
        self._path = f"/api/robots/{quote(self.name, safe='')}"

    def __repr__(self) -> str:
        return f"<Robot {self.name} at {self._http.url}, priority {self.priority}>"

    @property
    def is_driven(self) -> bool:
        """Whether this connection holds a velocity of the robot."""
        self._connection.callers.note()
        return self.name in self._driver.robots

    @property
    def client_name(self) -> str | None:
        """Name of this connection at the daemon, as `holder` of `state()` shows it; None before the first command."""
        return self._driver.client_name

    async def state(self) -> RobotState:
        """Return the present state: connected, holder, velocity (m/s, rad/s), odometry.

        Raises:
            HostlinkError: the robot does not exist, or hostlink was not reached.
        """
        return cast(RobotState, await self._http.request("GET", self._path))

    @overload
    async def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        for_s: None = None,
        keep: bool = False,
        take_over: bool = False,
        resume: bool = False,
    ) -> Driven: ...

    @overload
    async def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        for_s: float,
        take_over: bool = False,
        resume: bool = False,
    ) -> Motion: ...

    @overload
    async def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        for_s: float | None,
        keep: bool = False,
        take_over: bool = False,
        resume: bool = False,
    ) -> Driven | Motion: ...

    async def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        for_s: float | None = None,
        keep: bool = False,
        take_over: bool = False,
        resume: bool = False,
    ) -> Driven | Motion:
        """Drive until the next `drive` or `stop`, or until the connection's block is left; or for `for_s` seconds.

        The call returns when the daemon has accepted the command. The velocity is then repeated ten times a second.
        `drive(0, 0)` slows the robot down and continues to hold it; `stop()` stops the robot and lets it go. A stop or
        a lock by any program ends the drive. So do 10 s without a call of the thread (with asyncio: of the task) that
        drives; `idle_timeout_s` of `connect` changes them.

        Args:
            linear_m_s: velocity forward, in m/s.
            angular_rad_s: velocity of the turn, counter-clockwise, in rad/s.
            linear_y_m_s: velocity to the left, in m/s.
            for_s: duration in seconds. The call returns when a zero was sent after it, or when the robot was stopped
                earlier.
            keep: the drive continues without further calls, and after the end of a notebook's cell.
            take_over: take the robot over from another source of the same priority, which otherwise keeps it until it
                lets go. A source that was taken over must let go before it drives or takes over again.
            resume: continue after an interruption without letting go.

        Returns:
            The velocity after the robot's limits; with `for_s` a Motion whose `outcome` is `reached` or `stopped`.

        Raises:
            HostlinkError: the robot is not driven. It does not exist, its device is not connected, it is locked, it
                cannot move sideways, a source of a higher priority drives it, or one of the same priority without
                `take_over`; the numbers are not finite; or there is no connection to hostlink. After an interruption
                each `drive()` raises until the program lets go by `stop()`, a zero, or half a second without
                `drive()`, or passes `resume`. Interruptions: a lost connection, a refusal, a stop, a reconnection of
                the device, half a second in which this program did not run or could not send, `idle_timeout_s`
                without a call.
            CommandRefused: one of these, with its `kind`; for `held`, `holder` names the source that drives the robot.
        """
        velocity = PlanarVelocity(linear_m_s, linear_y_m_s, angular_rad_s)
        if for_s is None:
            return await self._driver.drive(
                self.name, velocity, self.priority, is_kept=keep, take_over=take_over, resume=resume
            )
        begin = Begin(take_over, resume)
        return await drive_for(self._driver, self.name, velocity, self.priority, for_s=for_s, begin=begin)

    async def move(
        self,
        metres: float,
        *,
        speed_m_s: float = 0.2,
        timeout_s: float | None = None,
        on_progress: OnProgress | None = None,
        take_over: bool = False,
        resume: bool = False,
    ) -> Motion:
        """Move along a line by odometry, and stop.

        The robot is also stopped when no odometry arrives for half a second, or when it is 0.3 m away from the line.

        Args:
            metres: length of the line; negative: backwards.
            speed_m_s: speed in m/s, at least 0.02.
            timeout_s: longest duration in seconds; None: 10 s plus four times the duration at this speed.
            on_progress: called with a Progress for each pose.
            take_over: as for `drive`.
            resume: as for `drive`.

        Returns:
            A Motion. Its `outcome` is `reached`, `blocked` (the odometry does not advance), `stopped` (with `kind`,
            `by` and `reason`) or `timed_out`.

        Raises:
            HostlinkError: nothing was driven. The first command was refused, the robot has no pose, or a number is
                invalid.
        """
        course, begin = line(metres, speed_m_s, timeout_s), Begin(take_over, resume)
        require_pose(await self.state())
        return await follow(self._driver, self.name, self.priority, course, self.odometry(), on_progress, begin)

    async def turn(
        self,
        radians: float,
        *,
        speed_rad_s: float = 0.8,
        timeout_s: float | None = None,
        on_progress: OnProgress | None = None,
        take_over: bool = False,
        resume: bool = False,
    ) -> Motion:
        """Turn on the spot by odometry, and stop. Arguments and result are as for `move`.

        Args:
            radians: angle; positive: counter-clockwise.
            speed_rad_s: speed of the turn in rad/s, at least 0.05.
            timeout_s: longest duration in seconds; None: 10 s plus four times the duration at this speed.
            on_progress: called with a Progress for each pose.
            take_over: as for `drive`.
            resume: as for `drive`.

        Raises:
            HostlinkError: nothing was driven. The first command was refused, the robot has no pose, or a number is
                invalid.
        """
        course, begin = turn(radians, speed_rad_s, timeout_s), Begin(take_over, resume)
        require_pose(await self.state())
        return await follow(self._driver, self.name, self.priority, course, self.odometry(), on_progress, begin)

    async def command(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        linear_y_m_s: float = 0.0,
        *,
        epoch: int | None = None,
        is_planar: bool = True,
        take_over: bool = False,
    ) -> None:
        """Send one velocity, which lasts for half a second and is not repeated. For control loops.

        The call does not wait for the answer, which `refusal` shows. Commands less than half a second apart are one
        motion. After a stop, a lock or a reconnection of the device the motion is refused until a zero, or half a
        second without commands, ends it. A command that arrives more than half a second late is refused, too.

        Args:
            linear_m_s: velocity forward, in m/s.
            angular_rad_s: velocity of the turn, counter-clockwise, in rad/s.
            linear_y_m_s: velocity to the left, in m/s.
            epoch: `epoch` of `state()` at the time of the decision. The command is refused if the robot was
                interrupted since then.
            is_planar: False for a Twist whose other components are not zero, which every robot refuses.
            take_over: as for `drive`.

        Raises:
            HostlinkError: the numbers are not finite, or there is no connection to hostlink.
        """
        velocity = PlanarVelocity(linear_m_s, linear_y_m_s, angular_rad_s)
        await self._driver.command(
            self.name, velocity, self.priority, epoch=epoch, is_planar=is_planar, take_over=take_over
        )

    @property
    def refusal(self) -> Refusal | None:
        """Reason why the newest answered `command` was refused; None if it was accepted."""
        self._connection.callers.note()
        return self._driver.refusals.get(self.name)

    async def stop(self, *, wait_s: float = WAIT_S) -> StoppedRobot:
        """Stop the robot, also if another source drives it. The robot's decelerations apply.

        The stop is sent before the call waits. Other topics of the robot's devices that look like commands are sent
        zeros, too. A source that was driving must let go before it can drive again.

        Args:
            wait_s: longest measurement, in seconds; 0: do not wait.

        Returns:
            What odometry says since the stop; `endpoints` has the other topics.

        Raises:
            HostlinkError: hostlink was not reached within a second. The drives of this connection end anyway.
        """
        self._driver.stop_repeating(self.name)
        try:
            path = f"{self._path}/stop?wait_s=0"
            answer = await self._http.request("POST", path, timeout_s=CLOSE_TIMEOUT_S)
        finally:
            await self._driver.send_zero(self.name, self.priority)
        return await self._stopped(answer, wait_s)

    async def lock(self, reason: str, *, wait_s: float = WAIT_S) -> StoppedRobot:
        """Stop the robot at once, without deceleration, and refuse all commands until `unlock`.

        Arguments and result are as for `stop`; `reason` is shown to every program whose command is refused.

        Raises:
            HostlinkError: hostlink was not reached within a second.
        """
        self._driver.stop_repeating(self.name)
        path = f"{self._path}/lock?wait_s=0"
        answer = await self._http.request("POST", path, {"reason": reason}, timeout_s=CLOSE_TIMEOUT_S)
        return await self._stopped(answer, wait_s)

    async def _stopped(self, answer: Mapping[str, Any], wait_s: float) -> StoppedRobot:
        """Measure since a stop or a lock with this answer, which may also name topics of other robots' stops."""
        found = await self._http.measure(f"{self._path}/standstill", wait_s) if wait_s > 0 else measured(answer)
        return StoppedRobot.of(found, [each for each in endpoints(answer) if each["robot"] == self.name])

    async def unlock(self) -> None:
        """Admit commands again. The robot does not move by this.

        Other sources that were driving must let go first. The next `drive()` of this connection drives, unless the
        robot was interrupted again meanwhile.

        Raises:
            HostlinkError: hostlink was not reached.
        """
        answer = await self._http.request("POST", f"{self._path}/unlock")
        self._driver.note_own_unlock(self.name, answer)

    async def reset_odometry(self) -> None:
        """Set the odometry's origin to the present pose.

        Raises:
            HostlinkError: the robot has no such command, or is not connected.
        """
        await self._http.request("POST", f"{self._path}/odometry/reset")

    async def odometry(self) -> AsyncIterator[Odometry]:
        """Iterate over the odometry: the newest pose (m, rad), then each new one.

        Each has the twist (m/s, rad/s), the stamp (ns), the age (s) and the rate (Hz). The iteration pauses while the
        robot or the connection is lost. A slow reader gets fewer poses, always the newest.

        Raises:
            HostlinkError: at the first pose, the robot does not exist or hostlink was not reached; with
                `reconnect=False` also when the connection is lost.
        """
        count = None
        async for event in self._connection.events(f"{self._path}/odometry/events"):
            if event.data["count"] != count:  # else it is the one that was sent before the connection was lost
                count = event.data["count"]
                yield cast(Odometry, event.data)
