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
    """One robot of a host; get one from `Host.robot`."""

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
        """Name of this connection at the daemon, as in `holder` of `state()`; None before the first command."""
        return self._driver.client_name

    async def state(self) -> RobotState:
        """Connected, holder, velocity (m/s, rad/s) and odometry, as they are now.

        Raises:
            HostlinkError: no robot of that name, no hostlink.
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

        m/s forward, rad/s counter-clockwise, m/s to the left. Returns when the daemon has accepted the command, with
        what the robot's limits have made of it; it is then repeated ten times a second. `drive(0, 0)` slows down and
        continues to drive; `stop()` stops and lets go. A stop or a lock by any program ends it as a refusal does, and
        so do 10 s without a call of the thread (with asyncio of the task) that drives: `connect` has `idle_timeout_s`.

        With `for_s` it returns when the time is over and a zero was sent, or when something has stopped the robot
        earlier: a Motion whose `outcome` is `reached` or `stopped`. With `keep` the robot drives on without calls, and
        after the end of a notebook's cell, which else stops it.

        Another source of the same priority keeps the robot until it lets go; with `take_over` this one takes it over.
        Who was taken over must let go before it drives or takes over again.

        Raises:
            HostlinkError: and the robot is not driven: no robot of that name, its device is not connected, a source
                with a higher priority drives it, or one with the same priority and `take_over` is not given, it is
                locked, the numbers are not finite, it cannot move sideways, there is no connection to hostlink. Also
                after the velocity that was held before was dropped: by a cut of the connection, by such a refusal, by
                a stop, because the robot's device connected again, this program did not run, or could not send, for
                half a second, or made no call for `idle_timeout_s`. Then each `drive()` raises until the program lets
                go: by `stop()`, a zero, or half a second without `drive()`; or until it says `resume`.
            CommandRefused: one of these, with `kind` for programs. `holder` is who drives the robot, for `held`.
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
        """Move along a line by odometry, and stop; negative `metres` lead backwards.

        It returns when the robot has stopped, or when something has stopped it earlier: `outcome` is `reached`,
        `blocked` (the odometry does not advance), `stopped` (with `kind`, `by` and `reason`) or `timed_out`. The robot
        is also stopped when it has no odometry for half a second, or leaves the line by 0.3 m. `on_progress` is called
        with a Progress for each pose. `timeout_s` is by default 10 s and four times what the speed needs. `take_over`
        and `resume` are those of `drive`.

        Raises:
            HostlinkError: nothing was driven: the first command was refused, as `drive` tells, the robot has no pose,
                or a number is invalid.
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
        """Turn on the spot by odometry, and stop; counter-clockwise is positive. It ends as `move` does.

        Raises:
            HostlinkError: nothing was driven: the first command was refused, as `drive` tells, the robot has no pose,
                or a number is invalid.
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
        """Send one velocity, which lasts for half a second and is not repeated: for programs that decide each time.

        It does not wait for the answer; `refusal` has it. Commands less than half a second apart are one motion: after
        a stop, a lock or a reconnection of the device the motion is refused, until a zero or half a second without
        commands ends it. A command that the network delivers too late is refused, too. `epoch` is the robot's, as in
        `state()`, when the decision was made: after an interruption since then the command is refused. `is_planar` is
        False for a Twist with other components that are not zero: no robot obeys it, and it is refused. `take_over`
        is that of `drive`.

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
        """Stop the robot, also if others drive it; return what was measured since. Its decelerations apply.

        What else its devices take that looks like a command is sent a zero; `endpoints` of the result has these topics.

        The stop is sent at once. The measurement lasts until the robot has stopped, at most `wait_s` seconds; 0 does
        not wait. A source that was driving must let go before it can drive again.

        Raises:
            HostlinkError: hostlink was not reached within a second; what this script held ends anyway.
        """
        self._driver.stop_repeating(self.name)
        try:
            path = f"{self._path}/stop?wait_s=0"
            answer = await self._http.request("POST", path, timeout_s=CLOSE_TIMEOUT_S)
        finally:
            await self._driver.send_zero(self.name, self.priority)
        return await self._stopped(answer, wait_s)

    async def lock(self, reason: str, *, wait_s: float = WAIT_S) -> StoppedRobot:
        """The emergency stop: zero at once, and every command of everybody is refused until `unlock`.

        Returns what was measured since, as `stop` does.

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
        """Let it be driven again; nothing that was held before drives it.

        This script knows of the lock: its next `drive()` drives, unless the robot was interrupted again meanwhile.

        Raises:
            HostlinkError: hostlink was not reached.
        """
        answer = await self._http.request("POST", f"{self._path}/unlock")
        self._driver.note_own_unlock(self.name, answer)

    async def reset_odometry(self) -> None:
        """Make the present place the origin.

        Raises:
            HostlinkError: the robot cannot do that, or is not connected.
        """
        await self._http.request("POST", f"{self._path}/odometry/reset")

    async def odometry(self) -> AsyncIterator[Odometry]:
        """The newest pose (m, rad), then each new one once, with twist (m/s, rad/s), stamp (ns), age (s) and rate (Hz).

        It pauses while the robot or the connection is gone, and continues afterwards. A slow reader gets fewer
        of them.

        Raises:
            HostlinkError: when it begins: no robot of that name, no hostlink; with `reconnect=False` also when the
                connection is lost.
        """
        count = None
        async for event in self._connection.events(f"{self._path}/odometry/events"):
            if event.data["count"] != count:  # else it is the one that was sent before the connection was lost
                count = event.data["count"]
                yield cast(Odometry, event.data)
