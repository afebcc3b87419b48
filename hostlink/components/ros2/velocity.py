"""Velocities of ROS 2's topics as commands of the daemon. Each publisher in ROS 2 is an owner there, with a connection
of its own: it ends with the publisher, and the robot stops.
"""

import asyncio
import contextlib
from collections import defaultdict
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from typing import NamedTuple

from hostlink.client import Host
from hostlink.client.connection import waits
from hostlink.components.ros2.plan import VelocityInput
from hostlink.core.robot.admission import LEASE_S, EarlierMotion, Freshness
from hostlink.core.robot.newest import newest
from hostlink.core.robot.velocity import Twist
from hostlink.core.runtime.log_budget import Budget
from hostlink.errors import HostlinkError, RefusalKind

HEARTBEAT_S = 0.05
HELD_S = 5.0  # after an interruption, until the middleware has passed on what it holds
STALL_S = LEASE_S  # after a longer pause of this process, later velocities may be old
MAX_COMMANDS_S = 600.0  # of an owner; the daemon closes a connection that sends 1000 messages a second
MAX_OWNERS = 32
MATCH_S = 3.0  # until ROS 2 has connected a publisher and a subscription that know of each other
GRACE_S = 1.0  # until ROS 2's graph has a publisher whose first message came
Report = Callable[[str], None]
Connect = Callable[[], contextlib.AbstractAsyncContextManager[Host]]
Key = bytes | str  # of a publisher: its gid, or its topic where rclpy does not say who has sent a message


class Sent(NamedTuple):
    """Publication of a message, as the middleware describes it; None: it does not tell.

    `at_s` is a time of the publisher's own clock, `number` counts its publications on the topic from 1.
    """

    at_s: float | None = None
    number: int | None = None

    def is_after_a_pause(self, before: "Sent") -> bool:
        """Whether the publisher paused for a lease after `before`, and published nothing between the two."""
        if self.at_s is None or before.at_s is None or before.number is None:
            return False
        return self.number == before.number + 1 and self.at_s >= before.at_s + LEASE_S


UNTOLD = Sent()


class VelocityDriver:
    """Velocities of all topics, sent by one connection for each publisher."""

    def __init__(self, connect: Connect, priority: int, report: Report, warn: Report) -> None:
        """`warn` is called with a line for each kind of refusal, at a limited rate."""
        self._connect, self._priority, self._report, self._warn = connect, priority, report, warn
        self._robots: frozenset[str] = frozenset()
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

    def receive(
        self,
        route: VelocityInput,
        twist: Twist,
        key: Key,
        *,
        came_s: float | None = None,
        sent: Sent = UNTOLD,
    ) -> None:
        """A velocity of this publisher came on a topic `came_s`; None: now.

        One that has waited for a lease is dropped when it is sent.
        """
        self._note_time()
        owner = self._owners.get(key) or self._add(key)
        if owner is not None:
            older = self._older.get(route.robot)
            is_older = older is not None and sent.number != 1 and key in older.keys
            older_until_s = older.until_s if older is not None and is_older else None
            came_s = asyncio.get_running_loop().time() if came_s is None else came_s
            owner.note_sent(route, sent)
            if not owner.is_held_back(twist, came_s, sent):
                owner.receive(route, twist, came_s, older_until_s)

    def update(self, robots: Iterable[str], publishers: frozenset[Key]) -> None:
        """The robots that the daemon knows, and the publishers that ROS 2 has now: who is gone drives no more.

        A robot whose device is away is still subscribed to, so the daemon knows who drives it when the device is back.
        """
        until_s, before = asyncio.get_running_loop().time() + MATCH_S, self._robots
        self._robots = frozenset(robots)
        self._older.update(dict.fromkeys(self._robots - before, _Older(publishers, until_s)))
        self._older = {robot: older for robot, older in self._older.items() if robot in self._robots}
        for key, owner in list(self._owners.items()):
            if owner.is_gone(is_there=key in publishers):
                del self._owners[key]
                owner.close()

    def _add(self, key: Key) -> "_Owner | None":
        if len(self._owners) >= MAX_OWNERS or self._tasks is None:
            self._report(f"more than {MAX_OWNERS} publishers drive: the others are not heard")
            return None
        owner = self._owners[key] = _Owner(self._connect, self._priority, self._warn)
        owner.task = self._tasks.create_task(owner.run())
        return owner

    async def _beat(self) -> None:
        while True:
            self._note_time()
            await asyncio.sleep(HEARTBEAT_S)

    def _note_time(self) -> None:
        """Note that this process runs. After a pause over STALL_S, velocities that follow may be old."""
        now_s = asyncio.get_running_loop().time()
        if now_s > self._beat_s + STALL_S:
            self._report(f"this program did not run for {now_s - self._beat_s:.1f} s: velocities of then are void")
            for owner in self._owners.values():
                owner.interrupt()
        self._beat_s = now_s


class _Older(NamedTuple):
    """The publishers that were there before the robot or the bridge, and until when a stream of them may come."""

    keys: frozenset[Key]
    until_s: float


class _WaitingVelocity(NamedTuple):
    """Velocity of a topic, until it is sent."""

    robot: str
    twist: Twist
    epoch: int | None
    at_s: float


class _Owner:
    """One publisher of ROS 2. What it drove stops when its connection ends."""

    def __init__(self, connect: Connect, priority: int, warn: Report) -> None:
        self.task: asyncio.Task[None] | None = None
        self._connect, self._priority, self._warn = connect, priority, warn
        self._motions: dict[VelocityInput, EarlierMotion] = {}
        self._sent: dict[VelocityInput, Sent] = {}  # the newest of each topic
        self._waiting: dict[VelocityInput, list[_WaitingVelocity]] = {}
        self._news = asyncio.Event()
        self._refusals: defaultdict[str, Budget] = defaultdict(Budget)  # by robot
        self._freshness, self._held_until_s = Freshness(), float("-inf")
        self._since_s = asyncio.get_running_loop().time()
        self._was_there = False
        self._free_at_s = 0.0

    def note_sent(self, route: VelocityInput, sent: Sent) -> None:
        """A publisher that paused for a lease by its own clock begins anew, also soon after an interruption."""
        if route in self._sent and sent.is_after_a_pause(self._sent[route]):
            self._motions[route] = EarlierMotion()
        self._sent[route] = sent

    def is_held_back(self, twist: Twist, came_s: float, sent: Sent) -> bool:
        """Whether a velocity is from before an interruption: the middleware may pass it on later than a lease after.

        Only the seconds after an interruption count, because a publisher's clock may be set.
        """
        late_s = 0.0 if sent.at_s is None else self._freshness.late_s(sent.at_s, came_s)
        return not twist.is_zero and came_s < self._held_until_s and late_s > LEASE_S

    def receive(self, route: VelocityInput, twist: Twist, came_s: float, older_until_s: float | None) -> None:
        """Take a velocity of the publisher. `older_until_s`: until then a stream may have started earlier."""
        if route not in self._motions:
            self._motions[route] = EarlierMotion() if older_until_s is None else EarlierMotion(older_until_s)
        epoch, waiting = self._motions[route].pop_epoch(came_s), self._waiting.get(route, [])
        before = waiting[-1] if waiting else None
        if before is not None and before.twist.is_planar and not twist.is_planar:
            return  # the daemon would refuse it, and what waits would be lost
        if before is not None and epoch is None:
            epoch = before.epoch  # of the motion that this velocity continues, and which the daemon does not know yet
        new = _WaitingVelocity(route.robot, twist, None if twist.is_zero else epoch, came_s)
        self._waiting[route] = newest([*waiting, new], lambda each: each.twist.is_zero)
        self._news.set()

    def is_gone(self, *, is_there: bool) -> bool:
        """Whether the publisher has left, as ROS 2's graph has it."""
        was_there, self._was_there = self._was_there, is_there
        is_new = asyncio.get_running_loop().time() < self._since_s + GRACE_S
        return not is_there and (was_there or not is_new)

    def interrupt(self) -> None:
        """Discard waiting velocities: they may be old, or for another daemon."""
        self._waiting.clear()
        self._held_until_s = asyncio.get_running_loop().time() + HELD_S
        for route in self._motions:
            self._expect_earlier_motion(route)

    def _expect_earlier_motion(self, route: VelocityInput) -> None:
        """Take the next velocity for one of an earlier motion, unless the publisher paused.

        The middleware may pass on nothing for longer than a lease, so the arrivals alone show no pause of a publisher
        that numbers what it sends.
        """
        wait_s = LEASE_S if None in self._sent[route] else HELD_S
        self._motions[route] = EarlierMotion(asyncio.get_running_loop().time() + wait_s)

    def end(self, route: VelocityInput) -> None:
        """The topic drives this robot no more."""
        self._sent.pop(route, None)
        if self._motions.pop(route, None) is not None:
            now_s = asyncio.get_running_loop().time()
            self._waiting[route] = [_WaitingVelocity(route.robot, Twist(), None, now_s)]
            self._news.set()

    def close(self) -> None:
        """End the connection, and with it what it drives."""
        if self.task is not None:
            self.task.cancel()

    async def run(self) -> None:
        """Send velocities until cancelled."""
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
                route = next(iter(self._waiting))
                for waiting in self._waiting.pop(route):
                    # A first command is fresh to the daemon: one that waited 2 s for its connection would drive.
                    if loop.time() < waiting.at_s + LEASE_S:
                        await self._send(host, waiting)
                    elif waiting.epoch is not None and route in self._motions:
                        self._expect_earlier_motion(route)  # the daemon was not told by this one

    async def _send(self, host: Host, waiting: _WaitingVelocity) -> None:
        """A zero is sent at once, another when the daemon's limit allows it."""
        loop, twist = asyncio.get_running_loop(), waiting.twist
        if not twist.is_zero and self._free_at_s > loop.time():
            await asyncio.sleep(self._free_at_s - loop.time())
        self._free_at_s = max(self._free_at_s, loop.time() - 1.0) + 1.0 / MAX_COMMANDS_S
        robot = host.robot(waiting.robot, priority=self._priority)
        try:
            x_m_s, y_m_s, yaw_rad_s = twist.planar
            await robot.command(x_m_s, yaw_rad_s, y_m_s, epoch=waiting.epoch, is_planar=twist.is_planar)
        except HostlinkError as error:  # there is no connection, or the velocity is not finite
            self._explain(waiting.robot, error.kind, str(error))
            if twist.planar.is_finite:
                self.interrupt()  # the daemon does not know yet of what motion the next one is
        else:
            is_at_rest = twist.is_zero and robot.refusal is not None and robot.refusal.kind == RefusalKind.HELD
            if robot.refusal is not None and not is_at_rest:  # a joystick at rest publishes zeros
                self._explain(waiting.robot, robot.refusal.kind, robot.refusal.reason)

    def _explain(self, robot: str, kind: str, reason: str) -> None:
        if self._refusals[robot].due(kind, asyncio.get_running_loop().time()):
            what = reason if reason.startswith(robot) else f"{robot}: {reason}"
            self._warn(f"{what} (velocity refused: {kind})")
