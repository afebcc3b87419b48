"""Robots: which devices are robots, and the one way by which velocity reaches them: each robot's gate."""

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import structlog

from hostlink.config import RobotConfig
from hostlink.errors import BadPayload, DeviceGone, HostlinkError, UnknownTopic
from hostlink.hub.isolation import Isolation
from hostlink.hub.message import Message
from hostlink.hub.subscriptions import Deliver, Unsubscribe, resolve
from hostlink.link.link import Link, LinkEnd
from hostlink.logs import printable
from hostlink.messages.catalog import Catalog
from hostlink.robot.directory import RobotTopics
from hostlink.robot.odometry import OdometryView, Twist
from hostlink.robot.velocity import ZERO, Velocity
from hostlink.robot.velocity_gate import Limits, VelocityGate

log = structlog.get_logger()

_NS_PER_S = 1_000_000_000
TICK_S = 0.05  # how late the end of a lease may be noticed
ENDING = "hostlink is stopping, and drives no robot any more"
LOCK_REASON = "emergency stop"  # of whoever does not say
FEED_INTERVAL_S = 0.125  # a source that commands at 10 Hz feeds the device by itself; a quarter of its own watchdog
DEMO_PRIORITY = 0  # whoever comes is more important
PROGRAM_PRIORITY = 50  # a client of the API that does not say
MAX_PRIORITY = 100  # a person at keys or a joystick says 60
LOG_INTERVAL_S = 10.0  # for what is refused again and again: a driver repeats his command ten times a second


@dataclass(slots=True)
class Refusals:
    """Velocities that a robot's device could not take."""

    count: int = 0
    cause: str | None = None  # of the last velocity; None: it was taken
    log_at_s: float = float("-inf")
    logged: int = 0

    def add(self, robot: str, error: HostlinkError) -> None:
        """Log the first, then one in LOG_INTERVAL_S with the number of those since."""
        self.count += 1
        self.cause = str(error)
        now_s = _now_s()
        if now_s >= self.log_at_s:
            log.warning("robot.unreachable", robot=robot, cause=self.cause, count=self.count - self.logged)
            self.log_at_s, self.logged = now_s + LOG_INTERVAL_S, self.count


@dataclass(slots=True)
class Robot:
    """A differential-drive robot (or any other that takes a Twist and tells its pose), as long as it is known.

    It outlives its link: a robot that comes back goes on with the same gate, at zero.
    """

    name: str
    gate: VelocityGate
    topics: RobotTopics
    link: Link | None
    odometry: OdometryView
    sent: Velocity = ZERO
    sent_at_s: float = 0.0
    unsubscribe: Unsubscribe | None = None
    refusals: Refusals = field(default_factory=Refusals)

    def see(self, message: Message) -> None:
        """Take a message of the robot's odometry topic."""
        try:
            self.odometry.see(message.decoded, now_s=_now_s(), wall_ns=self._stamp_ns(message))
        except BadPayload as error:
            log.debug("odometry.unreadable", robot=self.name, reason=str(error))

    def _stamp_ns(self, message: Message) -> int:
        """When the message was made, in the host's time: its header's stamp where it has one, else its arrival."""
        header: Any = message.decoded.get("header")
        if header is None or self.link is None:
            return message.stamp_ns
        stamp_ns = header["stamp"]["secs"] * _NS_PER_S + header["stamp"]["nsecs"]
        return self.link.session.device_clock.to_host_ns(stamp_ns, message.stamp_ns)


class Robots:
    """All robots by name. Methods are synchronous; `run` is the one clock of all gates."""

    def __init__(
        self,
        configs: Mapping[str, RobotConfig],
        catalog: Catalog,
        isolation: Isolation | None = None,
        *,
        subscribe: Callable[[str, Deliver], Unsubscribe],
        show: Callable[[str, bytes], None],
    ) -> None:
        """`subscribe` gives the odometry; `show` lets the subscribers of a velocity topic see what was sent."""
        twist = catalog.message("geometry_msgs/Twist")
        assert twist is not None  # noqa: S101 - of the store that the project is built on
        self.twist = twist
        self._isolation = Isolation(reraises=True) if isolation is None else isolation
        self._is_closed = False
        self._configs = configs
        for name in configs:
            self._limits(name)  # a ConfigError belongs to the start, not to the robot's first connection
        self._subscribe, self._show = subscribe, show
        self._robots: dict[str, Robot] = {}
        self._by_velocity_topic: dict[str, Robot] = {}
        self._by_reset_topic: dict[str, Robot] = {}
        self._wake = asyncio.Event()

    def all(self) -> list[Robot]:
        """Every robot that was seen since the daemon started, by name."""
        return [self._robots[name] for name in sorted(self._robots)]

    def find(self, name: str) -> Robot:
        """The robot of that name, connected or not."""
        robot = self._robots.get(name.strip("/"))
        if robot is None:
            raise UnknownTopic("robot", name, tuple(self._robots))
        return robot

    def of_velocity_topic(self, topic: str) -> Robot | None:
        """The robot that is driven by the topic of this full name."""
        return self._by_velocity_topic.get(topic)

    def expect_reset(self, topic: str) -> None:
        """A message goes to this topic: if it resets a robot's odometry, its next pose is at the origin."""
        robot = self._by_reset_topic.get(topic)
        if robot is not None:
            robot.odometry.expect_reset(_now_s())

    def appear(self, name: str, topics: RobotTopics, link: Link) -> None:
        """A robot's device is ready: whatever was commanded before means nothing now, its first velocity is zero."""
        robot = self._robots.get(name)
        if robot is None:
            gate, odometry = VelocityGate(name, self._limits(name)), self._odometry(name)
            robot = self._robots[name] = Robot(name, gate, topics, link, odometry)
        else:
            self._forget_topics(robot)
            robot.topics, robot.link = topics, link
        self._by_velocity_topic[resolve(topics.velocity)] = robot
        if topics.reset is not None:
            self._by_reset_topic[resolve(topics.reset)] = robot
        if robot.unsubscribe is not None:
            robot.unsubscribe()
        robot.unsubscribe = self._subscribe(topics.odometry, robot.see)
        robot.gate.restart()
        with contextlib.suppress(HostlinkError):  # a device that takes no velocity needs no zero
            link.last_frame = link.session.frame_to(topics.velocity, self.twist.encode(ZERO.to_twist()))
        log.info("robot.appeared", robot=name, velocity=topics.velocity, odometry=topics.odometry)
        self._wake.set()

    def vanish(self, link: Link) -> None:
        """A link ended: its robots stand without a device."""
        for robot in self._robots.values():
            if robot.link is link:
                robot.link = None
                robot.gate.restart()
                if robot.unsubscribe is not None:
                    robot.unsubscribe()
                    robot.unsubscribe = None
                self._forget_topics(robot)
                log.warning("robot.gone", robot=robot.name)

    def command(self, robot: Robot, velocity: Velocity, *, owner: str, priority: int = PROGRAM_PRIORITY) -> Velocity:
        """Drive for the length of a lease; returns the velocity after the limits.

        Raises DeviceGone, RobotHeld, BadRequest; FrameTooLarge, WrongType or UnknownTopic when the device cannot take
        it: then nobody drives.
        """
        if self._is_closed:
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
        self._is_closed = True

    def stop(self, robot: Robot) -> None:
        """Stop, whoever drives, as fast as the robot's decelerations allow; raises what `command` does of a device."""
        robot.gate.stop(now_s=_now_s())
        _raise(self._tell(robot))

    def stop_all(self) -> None:
        """Stop every robot; a refusal of one is raised when the others have been told."""
        refusals = []
        for robot in self.all():
            robot.gate.stop(now_s=_now_s())
            refusals.append(self._tell(robot))
        _raise(next(filter(None, refusals), None))

    def halt(self, robot: Robot) -> None:
        """Zero at once, whatever the limits say; for the daemon's own end."""
        robot.gate.halt()
        self._tell(robot)

    def lock(self, robot: Robot, reason: str) -> None:
        """The emergency stop: zero at once, and no command until `unlock`; also while the robot is not connected.

        Raises what `command` does of a device; the robot is locked then, too.
        """
        robot.gate.lock(printable(reason))
        log.warning("robot.locked", robot=robot.name, reason=robot.gate.lock_reason)
        _raise(self._tell(robot))

    def unlock(self, robot: Robot) -> None:
        """Let the robot be driven again."""
        if robot.gate.lock_reason is not None:
            log.warning("robot.unlocked", robot=robot.name, reason=robot.gate.lock_reason)
        robot.gate.unlock()

    def leave(self, owner: str) -> None:
        """A source of commands is gone: what it drives stops."""
        for robot in self._robots.values():
            if robot.gate.holder == owner:
                log.info("robot.stopped", robot=robot.name, reason="owner left", owner=owner)
                robot.gate.release(owner, now_s=_now_s())
                self._tell(robot)

    async def run(self) -> None:
        """Step every gate that is active; sleep while none is."""
        while True:
            if any(robot.gate.is_active for robot in self._robots.values()):
                for robot in self._robots.values():
                    if robot.gate.is_active:
                        self._step(robot)
                await asyncio.sleep(TICK_S)
            else:
                self._wake.clear()
                await self._wake.wait()

    def _forget_topics(self, robot: Robot) -> None:
        for robots, topic in (
            (self._by_velocity_topic, robot.topics.velocity),
            (self._by_reset_topic, robot.topics.reset),
        ):
            if topic is not None and robots.get(resolve(topic)) is robot:
                del robots[resolve(topic)]

    def _tell(self, robot: Robot) -> HostlinkError | None:
        self._wake.set()
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
        self._show(robot.topics.velocity, payload)
        return None

    def _odometry(self, name: str) -> OdometryView:
        config = self._configs.get(name, RobotConfig())
        fastest = Twist(config.max_linear_m_s, config.max_angular_rad_s)
        return OdometryView(goes_on=config.odometry_after_restart == "continue", fastest=fastest)

    def _limits(self, name: str) -> Limits:
        config = self._configs.get(name, RobotConfig())
        return Limits(
            max_linear_m_s=config.max_linear_m_s,
            max_angular_rad_s=config.max_angular_rad_s,
            max_wheel_m_s=config.max_wheel_m_s,
            wheel_separation_m=config.wheel_separation_m,
            max_linear_acceleration_m_s2=config.max_linear_acceleration_m_s2,
            max_angular_acceleration_rad_s2=config.max_angular_acceleration_rad_s2,
            max_linear_deceleration_m_s2=config.max_linear_deceleration_m_s2,
            max_angular_deceleration_rad_s2=config.max_angular_deceleration_rad_s2,
        )


def _raise(refusal: HostlinkError | None) -> None:
    if refusal is not None:
        raise refusal


def _now_s() -> float:
    return asyncio.get_running_loop().time()
