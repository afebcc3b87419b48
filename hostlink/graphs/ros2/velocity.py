"""Velocities of ROS 2's topics as commands of the daemon. Each publisher in ROS 2 is an owner there, with a connection
of its own: it ends with the publisher, and the robot stops.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from typing import NamedTuple

from hostlink.client import Host
from hostlink.client.connection import waits
from hostlink.errors import HostlinkError
from hostlink.graphs.ros2.commands import LEASE_S, Commands
from hostlink.graphs.ros2.plan import VelocityInput

HEARTBEAT_S = 0.05
STALL_S = LEASE_S  # this process did not run for longer than a velocity holds: what comes next may have waited
MAX_COMMANDS_S = 600.0  # of an owner; the daemon closes a connection that sends 1000 messages a second
MAX_OWNERS = 32
MATCH_S = 3.0  # until ROS 2 has connected a publisher and a subscription that know of each other
GRACE_S = 1.0  # until ROS 2's graph has a publisher whose first message came
ZERO = (0.0, 0.0)
Report = Callable[[str], None]
Connect = Callable[[], contextlib.AbstractAsyncContextManager[Host]]
Key = bytes | str  # of a publisher: its gid, or its topic where rclpy does not say who has sent a message


class VelocityDriver:
    """All velocity topics together. `running`, beside the routes."""

    def __init__(self, connect: Connect, priority: int, report: Report) -> None:
        self._connect, self._priority, self._report = connect, priority, report
        self._links: Mapping[str, int] = {}
        self._is_updated = False
        self._owners: dict[Key, _Owner] = {}
        self._older: dict[str, _Older] = {}  # by robot
        self._tasks: asyncio.TaskGroup | None = None
        self._beat_s = asyncio.get_running_loop().time()

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Owners may drive for the length of the block; at its end all stop."""
        async with asyncio.TaskGroup() as self._tasks:
            beats = self._tasks.create_task(self._beat())
            try:
                yield
            finally:
                beats.cancel()
                for owner in self._owners.values():
                    owner.close()

    @contextlib.contextmanager
    def driving(self, route: VelocityInput) -> Iterator[None]:
        """The topic drives the robot for the length of the block."""
        try:
            yield
        finally:
            for owner in self._owners.values():
                owner.end(route)

    def receive(self, route: VelocityInput, velocity: tuple[float, float], key: Key, *, is_first: bool = False) -> None:
        """A velocity came on a topic, from this publisher; `is_first`: of all that it has published there."""
        self._note_time()
        owner = self._owners.get(key) or self._add(key)
        if owner is not None:
            older = self._older.get(route.robot)
            interrupted_until_s = None if older is None or is_first or key not in older.keys else older.until_s
            owner.receive(route, velocity, self._links.get(route.robot), interrupted_until_s)

    def update(self, links: Mapping[str, int], publishers: frozenset[Key]) -> None:
        """The connections of the robots' devices, and the publishers that ROS 2 has now: who is gone drives no more."""
        if self._is_updated:  # who streams already when the bridge begins is heard
            until_s = asyncio.get_running_loop().time() + MATCH_S
            come = [robot for robot, link in links.items() if self._links.get(robot) != link]
            self._older.update(dict.fromkeys(come, _Older(publishers, until_s)))
        self._older = {robot: older for robot, older in self._older.items() if robot in links}
        self._links, self._is_updated = links, True
        for key, owner in list(self._owners.items()):
            if owner.is_gone(is_there=key in publishers):
                del self._owners[key]
                owner.close()

    def _add(self, key: Key) -> "_Owner | None":
        if len(self._owners) >= MAX_OWNERS or self._tasks is None:
            self._report(f"more than {MAX_OWNERS} publishers drive: the others are not heard")
            return None
        owner = self._owners[key] = _Owner(self._connect, self._priority, self._report)
        owner.task = self._tasks.create_task(owner.run())
        return owner

    async def _beat(self) -> None:
        while True:
            self._note_time()
            await asyncio.sleep(HEARTBEAT_S)

    def _note_time(self) -> None:
        """This process runs now; where it did not run for too long, what comes next may have waited."""
        now_s = asyncio.get_running_loop().time()
        if now_s > self._beat_s + STALL_S:
            self._report(f"this program did not run for {now_s - self._beat_s:.1f} s: velocities of then are void")
            for owner in self._owners.values():
                owner.interrupt()
        self._beat_s = now_s


class _Older(NamedTuple):
    """The publishers that were there before a robot's device, and until when a stream of them may reach the bridge."""

    keys: frozenset[Key]
    until_s: float


class _Waiting(NamedTuple):
    """The newest velocity of a topic, until it is sent."""

    robot: str
    velocity: tuple[float, float]
    link: int | None
    at_s: float


class _Owner:
    """One publisher of ROS 2. What it drove stops when its connection ends."""

    def __init__(self, connect: Connect, priority: int, report: Report) -> None:
        self.task: asyncio.Task[None] | None = None
        self._connect, self._priority, self._report = connect, priority, report
        self._commands: dict[VelocityInput, Commands] = {}
        self._waiting: dict[VelocityInput, _Waiting] = {}
        self._news = asyncio.Event()
        self._reported: dict[str, str] = {}  # the cause of the newest refusal, by robot
        self._since_s = asyncio.get_running_loop().time()
        self._was_there = False
        self._free_at_s = 0.0

    def receive(
        self,
        route: VelocityInput,
        velocity: tuple[float, float],
        link: int | None,
        interrupted_until_s: float | None,
    ) -> None:
        """It has published a velocity; `interrupted_until_s`: what it streams until then, it began before."""
        now_s = asyncio.get_running_loop().time()
        if route not in self._commands:
            self._commands[route] = Commands()
            if interrupted_until_s is not None:
                self._commands[route].interrupt(interrupted_until_s)
        commands = self._commands[route]
        is_zero = velocity == ZERO
        if commands.admit(is_zero=is_zero, link=link, now_s=now_s):
            self._waiting[route] = _Waiting(route.robot, velocity, None if is_zero else link, now_s)
            self._news.set()
        else:
            self._explain(
                route.robot,
                "was interrupted (its device or the daemon has connected again, or this program stood still): it moves "
                f"after a zero, or {LEASE_S:g} s without velocities",
            )

    def is_gone(self, *, is_there: bool) -> bool:
        """Whether the publisher has left, as ROS 2's graph has it."""
        was_there, self._was_there = self._was_there, is_there
        is_new = asyncio.get_running_loop().time() < self._since_s + GRACE_S
        return not is_there and (was_there or not is_new)

    def interrupt(self) -> None:
        """What waits or comes next may be old, or was meant for another daemon."""
        self._waiting.clear()
        for commands in self._commands.values():
            commands.interrupt(asyncio.get_running_loop().time())

    def end(self, route: VelocityInput) -> None:
        """The topic drives this robot no more."""
        if self._commands.pop(route, None) is not None:
            now_s = asyncio.get_running_loop().time()
            self._waiting[route] = _Waiting(route.robot, ZERO, None, now_s)
            self._news.set()

    def close(self) -> None:
        """End the connection, and with it what it drives."""
        if self.task is not None:
            self.task.cancel()

    async def run(self) -> None:
        """Send what comes, until cancelled."""
        for wait_s in waits():
            try:
                async with self._connect() as host:
                    await self._send_all(host)
            except HostlinkError:  # the bridge's own connection reports why
                self.interrupt()
            await asyncio.sleep(wait_s)

    async def _send_all(self, host: Host) -> None:
        changes = host.connection()
        loop = asyncio.get_running_loop()
        while True:
            await self._news.wait()
            self._news.clear()
            if changes.pop_all():
                self.interrupt()
            while self._waiting:
                waiting = self._waiting.pop(next(iter(self._waiting)))
                if loop.time() < waiting.at_s + LEASE_S:
                    await self._send(host, waiting)

    async def _send(self, host: Host, waiting: _Waiting) -> None:
        """A zero is sent at once, another when the daemon's limit allows it."""
        loop = asyncio.get_running_loop()
        if waiting.velocity != ZERO and self._free_at_s > loop.time():
            await asyncio.sleep(self._free_at_s - loop.time())
        self._free_at_s = max(self._free_at_s, loop.time() - 1.0) + 1.0 / MAX_COMMANDS_S
        robot = host.robot(waiting.robot, priority=self._priority)
        try:
            await robot.command(*waiting.velocity, link=waiting.link)
        except HostlinkError as error:  # there is no connection, or the velocity is not finite
            self._explain(waiting.robot, str(error))
        else:
            self._explain(waiting.robot, "" if robot.refusal is None else robot.refusal.reason)

    def _explain(self, robot: str, refusal: str) -> None:
        """Once for each cause, until a velocity is accepted."""
        if refusal and refusal != self._reported.get(robot):
            self._report(refusal if refusal.startswith(robot) else f"{robot} {refusal}")
        self._reported[robot] = refusal
