"""Robots: which devices are robots, and the one way by which velocity reaches them: each robot's gate."""

import asyncio
import contextlib
import math
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any

import structlog

from hostlink.config import RobotConfig
from hostlink.errors import BadPayload, DeviceGone, HostlinkError, RobotHeld, UnknownTopic
from hostlink.hub.guard import Guard
from hostlink.hub.isolation import Isolation
from hostlink.hub.message import Message
from hostlink.hub.refusals import Refusals
from hostlink.hub.robot_settings import limits_of, of_namesake
from hostlink.hub.shown_names import ShownNames
from hostlink.hub.topic_graph import Deliver, Unsubscribe
from hostlink.hub.ungated import UngatedVelocities
from hostlink.link.link import Link, LinkEnd
from hostlink.logs import printable
from hostlink.messages.catalog import Catalog
from hostlink.robot.away import Away
from hostlink.robot.directory import RobotTopicNames
from hostlink.robot.odometry_estimator import OdometryEstimator, Twist
from hostlink.robot.presence import SURE_S
from hostlink.robot.velocity import ZERO, Velocity
from hostlink.robot.velocity_gate import VelocityGate

log = structlog.get_logger()

_NS_PER_S = 1_000_000_000
TICK_S = 0.05  # how late the end of a lease may be noticed
ENDING = "hostlink is stopping, and drives no robot any more"
LOCK_REASON = "emergency stop"  # of whoever does not say
FEED_INTERVAL_S = 0.125  # a source that commands at 10 Hz feeds the device by itself; a quarter of its own watchdog
DEMO_PRIORITY = 0  # whoever comes is more important
PROGRAM_PRIORITY = 50  # a client of the API that does not say
MAX_PRIORITY = 100  # a person at keys or a joystick says 60
MAX_ROBOTS = 4096  # connected or locked, which are never forgotten: over it no new one is taken


@dataclass(slots=True)
class Robot:
    """A differential-drive robot (or any other that takes a Twist and tells its pose), as long as it is known.

    It outlives its link: a robot that comes back goes on with the same gate, at zero.
    """

    name: str
    config: RobotConfig
    gate: VelocityGate
    odometry: OdometryEstimator
    topics: RobotTopicNames  # as its device calls them
    shown: RobotTopicNames  # as the graph calls them
    link: Link | None = None
    locked_link: Link | None = None  # the one that it had when it was locked
    last_frame: bytes = b""  # its zero, as its device takes it
    sent: Velocity = ZERO
    sent_at_s: float = 0.0
    left_at_s: float = 0.0
    unreadable: int = 0  # messages of its odometry that are none
    unsubscribe: Unsubscribe | None = None
    refusals: Refusals = field(default_factory=Refusals)

    def see(self, message: Message) -> None:
        """Take a message of the robot's odometry, which came by its own link."""
        try:
            self.odometry.see(message.decoded, now_s=_now_s(), wall_ns=self._stamp_ns(message))
        except BadPayload as error:
            self.unreadable += 1
            log.debug("odometry.unreadable", robot=self.name, reason=str(error))

    def _stamp_ns(self, message: Message) -> int:
        """When the message was made, in the host's time: its header's stamp where it has one, else its arrival."""
        header: Any = message.decoded.get("header")
        if header is None or self.link is None:
            return message.stamp_ns
        stamp_ns = header["stamp"]["secs"] * _NS_PER_S + header["stamp"]["nsecs"]
        return self.link.session.device_clock.to_host_ns(stamp_ns, message.stamp_ns)


class Robots:
    """All robots by name. Methods are synchronous; `run` is the one clock of all gates.

    A robot is forgotten when it has been away for `forget_after_s`, or when MAX_AWAY others left after it; one that is
    configured or locked never is.
    """

    def __init__(
        self,
        configs: Mapping[str, RobotConfig],
        catalog: Catalog,
        isolation: Isolation | None = None,
        *,
        subscribe: Callable[[str, Deliver], Unsubscribe],
        show: Callable[[Robot, bytes], None],
        forget_after_s: float = math.inf,
        on_forgotten: Callable[[Robot], None] = lambda _: None,
    ) -> None:
        """`subscribe` notes who reads the odometry; `show` is told what was sent."""
        twist = catalog.message("geometry_msgs/Twist")
        assert twist is not None  # noqa: S101 - of the store that the project is built on
        self.twist = twist
        self._isolation = Isolation(reraises=True) if isolation is None else isolation
        self.is_closed = False  # the daemon ends, and drives nobody any more
        self.forgotten = 0
        self.max_robots = MAX_ROBOTS + len(configs)
        self._configs = configs
        for config in configs.values():
            limits_of(config)  # a ConfigError belongs to the start, not to the robot's first connection
        self.guard: Guard | None = None  # who stops the robots when this process cannot
        self._subscribe, self._show = subscribe, show
        self._on_forgotten = on_forgotten
        self._robots: dict[str, Robot] = {}
        self._of_link: dict[Hashable, Robot] = {}
        self._away = Away(forget_after_s)  # who may be forgotten
        self._locked: dict[str, Robot] = {}
        self._active: dict[str, Robot] = {}  # whose gate may have something to say
        self._by_velocity_topic: defaultdict[str, dict[str, Robot]] = defaultdict(dict)
        self._by_reset_topic: defaultdict[str, dict[str, Robot]] = defaultdict(dict)
        self._wake = asyncio.Event()
        zero = twist.encode(ZERO.to_twist())
        self.ungated = UngatedVelocities(zero, self._isolation, check=self._check_lock, on_active=self._wake.set)

    def all(self) -> list[Robot]:
        """Every robot that is connected, or was and is not forgotten, by name."""
        return [self._robots[name] for name in sorted(self._robots)]

    def find(self, name: str) -> Robot:
        """The robot of that name, connected or not."""
        robot = self._robots.get(name.strip("/"))
        if robot is None:
            raise UnknownTopic("robot", name, self._robots)
        return robot

    def is_known(self, robot: Robot) -> bool:
        """Whether it is not forgotten."""
        return self._robots.get(robot.name) is robot

    def of_link(self, link: Hashable) -> Robot | None:
        """The robot whose device has this link."""
        return self._of_link.get(link)

    def of_velocity_topic(self, topic: str) -> tuple[Robot, ...]:
        """The robots that are driven by the topic of this full name: one, unless several share a name outside."""
        return tuple(self._by_velocity_topic.get(topic, {}).values())

    def expect_reset(self, topic: str) -> None:
        """A message goes to this topic: if it resets a robot's odometry, its next pose is at the origin."""
        for robot in self._by_reset_topic.get(topic, {}).values():
            robot.odometry.expect_reset(_now_s())

    def make_room(self, name: str) -> bool:
        """Whether a robot of this name may come, if need be in the place of one that is away."""
        if name not in self._robots and len(self._robots) >= self.max_robots:
            self._forget(self._away.take_first())
        return name in self._robots or len(self._robots) < self.max_robots

    def appear(
        self,
        name: str,
        topics: RobotTopicNames,
        link: Link,
        *,
        shown: RobotTopicNames | None = None,
        is_certain: bool = True,
    ) -> Robot:
        """A robot's device is ready: whatever was commanded before means nothing now, its first velocity is zero.

        `shown`: its topics as the graph calls them. A device that is not certainly this robot may be a locked one that
        has come back under another name: then it is locked as well.
        """
        before = self._of_link.get(link)
        if before is not None and before.name != name:
            self.vanish(link)
        robot = self._robots.get(name)
        shown = ShownNames().of_robot(topics) if shown is None else shown
        if robot is None:
            robot = self._robots[name] = self._make(name, topics, shown)
        else:
            self._forget_topics(robot)
            if robot.link is not None and robot.link is not link:
                self._of_link.pop(robot.link, None)
        robot.topics, robot.shown, robot.link = topics, shown, link
        self._of_link[link] = robot
        self._away.remove(name)
        self._by_velocity_topic[shown.velocity][name] = robot
        if shown.reset is not None:
            self._by_reset_topic[shown.reset][name] = robot
        robot.unsubscribe = self._subscribe(shown.odometry, _read_by_link)
        robot.gate.restart()
        self.ungated.forget(link, topics.velocity)
        self.guard_link(link, topics.velocity)
        robot.last_frame = link.last_frame
        self._activate(robot)
        log.info("robot.appeared", robot=name, velocity=shown.velocity, odometry=shown.odometry)
        if not is_certain and before is not robot:
            self._lock_likewise(robot)
        return robot

    def vanish(self, link: Link) -> Robot | None:
        """A link has no robot any more: the one that it had is told to stop, and stands without a device."""
        self.ungated.stop(link, now_s=_now_s())
        if self.guard is not None:
            self.guard.release(link.number)
        robot = self._of_link.pop(link, None)
        if robot is None:
            return None
        self._send_last_zero(robot, link)
        robot.link = None
        robot.gate.restart()
        self._activate(robot)
        self._forget_topics(robot)
        log.warning("robot.gone", robot=robot.name)
        self._put_away(robot)
        return robot

    def command(self, robot: Robot, velocity: Velocity, *, owner: str, priority: int = PROGRAM_PRIORITY) -> Velocity:
        """Drive for the length of a lease; returns the velocity after the limits.

        Raises DeviceGone, RobotHeld, BadRequest; FrameTooLarge, WrongType or UnknownTopic when the device cannot take
        it: then nobody drives.
        """
        if self.is_closed:
            raise DeviceGone(robot.name, ENDING)
        if robot.link is None:
            raise DeviceGone(robot.name)
        limited = robot.gate.command(owner, velocity, priority=priority, now_s=_now_s())
        if robot.gate.holder in (owner, None):  # another's idle zero changes nothing, so it is no news for the device
            refusal = self._tell(robot)
            if refusal is not None:
                robot.gate.release(owner, now_s=_now_s())
                raise refusal
        return limited

    def close(self) -> None:
        """The daemon ends: no command is taken any more, for good."""
        self.is_closed = True

    def stop(self, robot: Robot) -> None:
        """Stop, whoever drives, as fast as the robot's decelerations allow; raises what `command` does of a device."""
        robot.gate.stop(now_s=_now_s())
        self._stop_ungated(robot)
        _raise(self._tell(robot))

    def stop_all(self) -> None:
        """Stop every robot; a refusal of one is raised when the others have been told."""
        refusals = []
        self.ungated.stop(now_s=_now_s())
        for robot in self.all():
            robot.gate.stop(now_s=_now_s())
            refusals.append(self._tell(robot))
        _raise(next(filter(None, refusals), None))

    def halt(self, robot: Robot) -> None:
        """Zero at once, whatever the limits say; for the daemon's own end."""
        robot.gate.halt()
        self._stop_ungated(robot)
        self._tell(robot)

    def lock(self, robot: Robot, reason: str) -> None:
        """The emergency stop: zero at once, and no command until `unlock`; also while the robot is not connected.

        Raises what `command` does of a device; the robot is locked then, too.
        """
        robot.gate.lock(printable(reason))
        robot.locked_link = robot.link
        self._locked[robot.name] = robot
        self._away.remove(robot.name)
        log.warning("robot.locked", robot=robot.name, reason=robot.gate.lock_reason)
        self._stop_ungated(robot)
        _raise(self._tell(robot))

    def unlock(self, robot: Robot) -> None:
        """Let the robot be driven again."""
        if robot.gate.lock_reason is not None:
            log.warning("robot.unlocked", robot=robot.name, reason=robot.gate.lock_reason)
        robot.gate.unlock()
        self._locked.pop(robot.name, None)
        self._put_away(robot)

    def leave(self, owner: str) -> None:
        """A source of commands is gone: what it drives stops."""
        for robot in list(self._active.values()):
            is_driving = robot.gate.holder == owner
            robot.gate.release(owner, now_s=_now_s())  # also what it has claimed without driving now
            if is_driving:
                log.info("robot.stopped", robot=robot.name, reason="owner left", owner=owner)
                self._tell(robot)

    async def run(self) -> None:
        """Step every gate that is active; sleep while none is. Robots that are away long enough are forgotten."""
        while True:
            for robot in list(self._active.values()):
                if robot.gate.is_active:
                    self._step(robot)
                elif not robot.gate.is_claimed(_now_s()):
                    self._active.pop(robot.name, None)
            self.ungated.step(_now_s())
            if self._active or self.ungated.is_active:
                await asyncio.sleep(TICK_S)
            else:
                self._wake.clear()
                forgets_at_s = self._away.next_s()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout_at(None if math.isinf(forgets_at_s) else forgets_at_s):
                        await self._wake.wait()
            self._forget_some()

    def _make(self, name: str, topics: RobotTopicNames, shown: RobotTopicNames) -> Robot:
        config = self._configs.get(name) or of_namesake(self._configs.get(topics.name))
        fastest = Twist(config.max_linear_m_s, config.max_angular_rad_s)
        odometry = OdometryEstimator(goes_on=config.odometry_after_restart == "continue", fastest=fastest)
        return Robot(name, config, VelocityGate(name, limits_of(config)), odometry, topics, shown)

    def _lock_likewise(self, robot: Robot) -> None:
        """If a locked robot of the same own name may be this one."""
        if robot.gate.lock_reason is not None:
            return
        for other in self._locked.values():
            link = other.link
            is_surely_another = link is not None and link is other.locked_link and link.heard_at_s > _now_s() - SURE_S
            if other.topics.name == robot.topics.name and not is_surely_another:
                with contextlib.suppress(HostlinkError):  # locked it is; a device that takes no zero moves for nobody
                    self.lock(robot, f"it may be {other.name}: {other.gate.lock_reason}")
                return

    def _send_last_zero(self, robot: Robot, link: Link) -> None:
        """To a device that may have told new topics, or has another link by now; most often it is gone."""
        if robot.gate.may_move:
            try:
                link.session.publish(robot.topics.velocity, self.twist.encode(ZERO.to_twist()), is_urgent=True)
            except HostlinkError:
                if robot.last_frame:
                    link.session.send_last(robot.last_frame)
            link.wake()

    def _put_away(self, robot: Robot) -> None:
        """It may be forgotten from now on, unless it is configured or locked."""
        if robot.link is None and robot.gate.lock_reason is None and robot.name not in self._configs:
            self._away.put(robot.name, _now_s())
            self._forget_some()
            self._wake.set()

    def _forget_some(self) -> None:
        for name in self._away.take_forgotten(_now_s()):
            self._forget(name)

    def _forget(self, name: str | None) -> None:
        if name is not None:
            robot = self._robots.pop(name)
            self._active.pop(name, None)
            self.forgotten += 1
            log.info("robot.forgotten", robot=name)
            self._on_forgotten(robot)

    def _stop_ungated(self, robot: Robot) -> None:
        if robot.link is not None:
            self.ungated.stop(robot.link, now_s=_now_s())

    def _check_lock(self, link: Link) -> None:
        robot = self._of_link.get(link)
        if self.is_closed:
            raise DeviceGone(str(link), ENDING)
        if robot is not None and robot.gate.lock_reason is not None:
            raise RobotHeld(robot.name, None, lock_reason=robot.gate.lock_reason)

    def guard_link(self, link: Link, velocity_topic: str) -> None:
        """Let link and guard stop this device when nobody else can; one that takes no velocity cannot be driven."""
        with contextlib.suppress(HostlinkError):
            link.last_frame = link.session.frame_to(velocity_topic, self.twist.encode(ZERO.to_twist()))
            if self.guard is not None:
                topic_id = link.session.topic_id(velocity_topic)
                longest = link.session.longest_to_device_bytes
                self.guard.watch(link.number, link.descriptor, topic_id=topic_id, claim_bytes=longest)

    def _forget_topics(self, robot: Robot) -> None:
        for robots, topic in (
            (self._by_velocity_topic, robot.shown.velocity),
            (self._by_reset_topic, robot.shown.reset),
        ):
            if topic is not None and topic in robots:
                robots[topic].pop(robot.name, None)
                if not robots[topic]:
                    del robots[topic]
        if robot.unsubscribe is not None:
            robot.unsubscribe()
            robot.unsubscribe = None

    def _activate(self, robot: Robot) -> None:
        self._active[robot.name] = robot
        self._wake.set()

    def _tell(self, robot: Robot) -> HostlinkError | None:
        self._activate(robot)
        return self._step(robot, is_news=True)

    def _step(self, robot: Robot, *, is_news: bool = False) -> HostlinkError | None:
        """Send what the gate says, if it is time; returns why the device cannot take it.

        A crash here is the robot's own: its link ends, with a zero as its last frame.
        """
        try:
            return self._send(robot, is_news=is_news)
        except Exception as error:  # noqa: BLE001 - counted; no other robot's gate may miss its turn
            if robot.link is not None:
                robot.link.end(LinkEnd.CRASHED)
            self._isolation.crashed("robot", error, robot=robot.name)
            return DeviceGone(robot.name)

    def _send(self, robot: Robot, *, is_news: bool) -> HostlinkError | None:
        was_held_by, is_first = robot.gate.holder, robot.gate.is_new_device
        velocity = robot.gate.step(_now_s())
        if was_held_by is not None and robot.gate.holder is None:
            log.info("robot.stopped", robot=robot.name, reason="no command came", owner=was_held_by)
        if velocity is None or robot.link is None:
            return None
        now_s = _now_s()
        is_repeat = velocity == robot.sent and not velocity.is_zero and not is_news
        if is_repeat and now_s < robot.sent_at_s + FEED_INTERVAL_S:
            return None
        payload = self.twist.encode(velocity.to_twist())
        try:
            robot.link.session.publish(robot.topics.velocity, payload, is_urgent=True, is_kept=is_first)
            robot.link.session.keep_clear(robot_moves=robot.gate.may_move)
        except HostlinkError as error:
            robot.refusals.add(robot.name, error)
            return error
        robot.refusals.cause = None
        robot.sent, robot.sent_at_s = velocity, now_s
        robot.link.wake()
        self._show(robot, payload)
        return None


def _read_by_link(message: Message) -> None:
    """The hub reads a robot's odometry as it comes by the robot's link; here it is only said that it does."""


def _raise(refusal: HostlinkError | None) -> None:
    if refusal is not None:
        raise refusal


def _now_s() -> float:
    return asyncio.get_running_loop().time()
