"""KeyDriver: from the velocity of the keys to commands for one robot, whose state is watched meanwhile."""

import asyncio
import contextlib
from collections.abc import AsyncIterator

from hostlink.cli.driving import Driving
from hostlink.client import Event, Host, Refusal, Robot, RobotState
from hostlink.errors import HostlinkError, RefusalKind, UnknownTopic

TICK_S = 0.02


class WatchedRobot:
    """The robot as the daemon shows it."""

    def __init__(self, state: RobotState) -> None:
        self.state = state

    async def follow(self, events: AsyncIterator[Event]) -> None:
        """Until the connection is lost.

        Raises:
            HostlinkError: it is lost.
            UnknownTopic: the daemon has forgotten the robot.
        """
        async for event in events:
            if event.name == "robots":
                states: dict[str, RobotState] = {robot["name"]: robot for robot in event.data["robots"]}
                if self.state["name"] not in states:
                    raise UnknownTopic("robot", self.state["name"], tuple(states))
                self.state = states[self.state["name"]]


@contextlib.asynccontextmanager
async def watched_robot(host: Host, state: RobotState) -> AsyncIterator["WatchedRobot"]:
    """The robot's state, kept up to date for the length of the block.

    Raises:
        HostlinkError: the connection is lost; it ends the block.
        UnknownTopic: the daemon has forgotten the robot; it ends the block.
    """
    watched = WatchedRobot(state)
    try:
        async with asyncio.TaskGroup() as tasks:
            watching = tasks.create_task(watched.follow(host.watch()), name="watch")
            try:
                yield watched
            finally:
                watching.cancel()
    except BaseExceptionGroup as group:
        raise group.exceptions[0] from None


class KeyDriver:
    """Sends the velocity of the keys as commands."""

    def __init__(self, robot: Robot, driving: Driving, watched: WatchedRobot) -> None:
        self.refusal = ""
        self._robot, self._driving, self._watched = robot, driving, watched
        self._refused: Refusal | None = None
        self._is_moving = False

    async def send_what_is_due(self) -> None:
        """What is refused must be released and pressed again, unless somebody more important drives for a while."""
        refused, before = self._robot.refusal, self._refused
        self._refused = refused
        if refused is not None and refused is not before:  # one more command was refused
            self.refusal = refused.reason
            if refused.kind != RefusalKind.HELD:
                self._driving.bar(_now_s())
        elif refused is None and self._is_moving:  # what moves it was accepted; a zero always is
            self.refusal = ""
        velocity = self._driving.due(_now_s())
        if velocity is not None:
            await self.send(velocity)

    async def send(self, velocity: tuple[float, float]) -> None:
        """Send one velocity."""
        self._is_moving = velocity != (0.0, 0.0)
        await self._robot.command(*velocity)

    async def stop(self) -> None:
        """Stop the robot, whoever drives. A connection that is lost shows by the next command."""
        try:
            await self._robot.stop(wait_s=0.0)
            self.refusal = ""
        except HostlinkError as error:
            self.refusal = str(error)

    async def unlock(self) -> None:
        """Unlock the robot, if it is locked; what is held must be released and pressed again."""
        if not self._watched.state.get("locked"):
            return
        self._driving.bar(_now_s())
        try:
            await self._robot.unlock()
            self.refusal = ""
        except HostlinkError as error:
            self.refusal = str(error)

    async def finish(self) -> None:
        """Send the zeros at the end."""
        while (velocity := self._driving.due(_now_s())) is not None or self._driving.is_ending:
            if velocity is not None:
                await self.send(velocity)
            await asyncio.sleep(TICK_S)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
