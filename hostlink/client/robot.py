"""Robot: one robot of a host, as a script drives and reads it."""

from collections.abc import AsyncIterator
from typing import cast
from urllib.parse import quote

from hostlink.client.connection import Connection
from hostlink.client.driver import Driver
from hostlink.client.http_client import CLOSE_TIMEOUT_S, HttpClient
from hostlink.client.views import Driven, Odometry, Refusal, RobotState

PRIORITY = 50  # of a program; a person at the keys is 60


class Robot:
    """One robot of a host; get one from `Host.robot`."""

    def __init__(self, name: str, priority: int, *, http: HttpClient, driver: Driver, connection: Connection) -> None:
        self.name = name.strip("/")
        self.priority = priority
        self._http, self._driver, self._connection = http, driver, connection
        self._path = f"/api/robots/{quote(self.name, safe='')}"

    def __repr__(self) -> str:
        return f"<Robot {self.name} at {self._http.url}, priority {self.priority}>"

    @property
    def is_driven(self) -> bool:
        """Whether this connection holds a velocity of the robot."""
        return self.name in self._driver.robots

    @property
    def client_name(self) -> str | None:
        """What the daemon calls this connection, as in `holder` of `state()`; None: nothing was commanded yet."""
        return self._driver.client_name

    async def state(self) -> RobotState:
        """Connected, holder, velocity (m/s, rad/s) and odometry, as they are now.

        Raises:
            HostlinkError: no robot of that name, no hostlink.
        """
        return cast(RobotState, await self._http.request("GET", self._path))

    async def drive(self, linear_m_s: float, angular_rad_s: float, *, is_yielding: bool = False) -> Driven:
        """Drive until the next `drive` or `stop`, or until the connection's block is left.

        m/s forward, rad/s counter-clockwise. Returns when the daemon has accepted the command, with what the robot's
        limits have made of it; it is then repeated ten times a second. `drive(0, 0)` slows down and goes on driving;
        `stop()` stops and lets go. With `is_yielding` a stop of anybody ends it as a refusal does: for motions that
        no person oversees.

        Raises:
            HostlinkError: and the robot is not driven: no robot of that name, its device is not connected, somebody
                with a higher priority drives it or it is locked, the numbers are not finite, there is no connection to
                hostlink. Also once after the velocity that was held before was dropped: by a cut of the connection, by
                such a refusal, because the robot's device connected again or this program did not run for half a
                second.
        """
        return await self._driver.drive(self.name, linear_m_s, angular_rad_s, self.priority, is_yielding=is_yielding)

    async def command(self, linear_m_s: float, angular_rad_s: float, *, link: int | None = None) -> None:
        """Send one velocity, which lasts for half a second and is not repeated: for who decides ten times a second.

        It does not wait for the answer; `refusal` has it. `link` is the number of the device's connection for which it
        is meant, as in `state()`: when the device has connected again, the command is refused. A command that the
        network delivers too late is refused anyway.

        Raises:
            HostlinkError: the numbers are not finite, or there is no connection to hostlink.
        """
        await self._driver.command(self.name, (linear_m_s, angular_rad_s), self.priority, link=link)

    @property
    def refusal(self) -> Refusal | None:
        """Why the newest `command` that was answered was refused; None: it was not."""
        return self._driver.refusals.get(self.name)

    async def stop(self) -> None:
        """Stop, whoever drives, as fast as the robot's decelerations allow.

        Raises:
            HostlinkError: hostlink was not reached within a second; what this script held ends anyway.
        """
        self._driver.stop_repeating(self.name)
        try:
            await self._http.request("POST", f"{self._path}/stop", timeout_s=CLOSE_TIMEOUT_S)
        finally:
            await self._driver.send_zero(self.name, self.priority)

    async def lock(self, reason: str) -> None:
        """The emergency stop: zero at once, and every command of everybody is refused until `unlock`.

        Raises:
            HostlinkError: hostlink was not reached within a second.
        """
        self._driver.stop_repeating(self.name)
        await self._http.request("POST", f"{self._path}/lock", {"reason": reason}, timeout_s=CLOSE_TIMEOUT_S)

    async def unlock(self) -> None:
        """Let it be driven again; nothing that was held before drives it.

        Raises:
            HostlinkError: hostlink was not reached.
        """
        await self._http.request("POST", f"{self._path}/unlock")

    async def reset_odometry(self) -> None:
        """Make the present place the origin.

        Raises:
            HostlinkError: the robot cannot do that, or is not connected.
        """
        await self._http.request("POST", f"{self._path}/odometry/reset")

    async def odometry(self) -> AsyncIterator[Odometry]:
        """The newest pose (m, rad), then each new one once, with twist (m/s, rad/s), stamp (ns), age (s) and rate (Hz).

        It waits while the robot or the connection is gone, and goes on when it is back. A reader that is slow gets
        fewer of them.

        Raises:
            HostlinkError: when it begins: no robot of that name, no hostlink; with `reconnect=False` also when the
                connection is lost.
        """
        count = None
        async for event in self._connection.events(f"{self._path}/odometry/events"):
            if event.data["count"] != count:  # else it is the one that was sent before the connection was lost
                count = event.data["count"]
                yield cast(Odometry, event.data)
