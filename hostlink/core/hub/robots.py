"""Robots: the registry of links, devices, robots and their gates, and the retention of robots that disconnected."""

import asyncio
import contextlib
import dataclasses
import itertools
import math
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Iterable, Mapping

import structlog

from hostlink.core.config import Config, RobotConfig
from hostlink.core.hub.any_robot import AnyRobot, shown_reason
from hostlink.core.hub.device import Device
from hostlink.core.hub.gates import Connection, Drivable, Gates
from hostlink.core.hub.remote_robot import RemoteRobot
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.hub.robot_settings import (
    command_settings,
    commands_of,
    correction_of,
    drive_in,
    feedback_of,
    frames_of,
    limits_of,
    of_namesake,
)
from hostlink.core.link.link import Link
from hostlink.core.robot.admission import Admission, EarlierCommands
from hostlink.core.robot.command_endpoint import CommandEndpoint
from hostlink.core.robot.command_types import CommandType, TopicType, TwistCommand
from hostlink.core.robot.events import OTHER_TOPICS, EventKind
from hostlink.core.robot.feedback import Feedback, FeedbackSettings
from hostlink.core.robot.model import CommandKind, RobotTopicNames, motion_of
from hostlink.core.robot.odometry import OdometryEstimator
from hostlink.core.robot.parts import Membership, Parts, parts_of
from hostlink.core.robot.velocity import TWIST_TYPE, ZERO, PlanarVelocity
from hostlink.core.robot.velocity_gate import LOCKED_ZERO_INTERVAL_S, VelocityGate
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import ConfigError, FrameTooLarge, HostlinkError, UnknownTopic

log = structlog.get_logger()

MAX_AWAY = 64  # disconnected robots that are not configured

MAX_ROBOTS = 4096  # connected or locked robots, which are never forgotten; further ones are refused


class RetentionPolicy:
    """Retention of disconnected robots, in the order in which they disconnected. Times are monotonic, in seconds."""

    def __init__(self, forget_after_s: float = math.inf) -> None:
        self._forget_after_s = forget_after_s
        self._left_at_s: OrderedDict[str, float] = OrderedDict()

    def __len__(self) -> int:
        return len(self._left_at_s)

    def put(self, name: str, now_s: float) -> None:
        """Note that a robot disconnected."""
        self._left_at_s.pop(name, None)
        self._left_at_s[name] = now_s

    def remove(self, name: str) -> None:
        """Keep a robot: it is connected, or must not be forgotten."""
        self._left_at_s.pop(name, None)

    def pop_forgotten(self, now_s: float) -> list[str]:
        """Remove and return the names whose retention ended."""
        popped: list[str] = []
        while len(self._left_at_s) > MAX_AWAY or now_s >= self.next_s():
            popped.append(self._left_at_s.popitem(last=False)[0])
        return popped

    def pop_first(self) -> str | None:
        """Remove and return the name that disconnected first; None if there is none."""
        return self._left_at_s.popitem(last=False)[0] if self._left_at_s else None

    def next_s(self) -> float:
        """Time at which the next name is forgotten; infinite if there is none."""
        return next(iter(self._left_at_s.values()), math.inf) + self._forget_after_s


class Robots:
    """Registry of links, devices and robots. Methods are synchronous.

    It owns:
    - `devices`: the Device of each live link, by the number of the link. A Device has its link, its diagnosis, its
      robot, and its drivables with their gates. A robot and each drivable know their Device as their `connection`.
    - the robots of this daemon by name, connected or not.
    - `remote`: the robots that components announce, by name.
    - `boards`: the lock of everything that is not a robot. A lock of all also locks robots that are seen later.
    - the robots that a device without one may be, because the settings place them where it is, or because it has their
      command and their last address. While such a robot is away, its stop and its lock hold for the device.

    The Directory decides from the announced topics which robot a device is; the registry keeps the decisions. No other
    part has a table of links or robots.

    A robot is forgotten after `link.forget_robot_after_s` without a connection, or when MAX_AWAY others disconnected
    after it. A configured or locked robot is never forgotten. A robot that only a recording has played is forgotten
    when that ends.
    """

    def __init__(self, gates: Gates, config: Config, first_epoch: Callable[[], int]) -> None:
        """Create an empty registry. `first_epoch` draws the epoch of a new robot.

        Raises:
            ConfigError: limits of a robot are invalid. They are checked at the start, not at its first connection.
        """
        self._gates, self._configs, self._first_epoch = gates, config.robots, first_epoch
        # Called with the name of a robot that connected, disconnected or was forgotten, and with a forgotten robot.
        self.on_change: Callable[[str], None] = lambda _: None
        self.on_forgotten: Callable[[LocalRobot], None] = lambda _: None
        for each in self._configs.values():
            limits_of(each)
        self.forgotten = 0
        self.max_robots = MAX_ROBOTS + len(self._configs)
        self.devices: dict[int, Device] = {}  # oldest first
        self.remote: dict[str, RemoteRobot] = {}  # other code only reads it; `RemoteRobots` adds and removes
        self.boards = Admission("every board", drive=None)
        self._numbers = itertools.count(1)
        self._robots: dict[str, LocalRobot] = {}
        self._may_be: dict[int, frozenset[str]] = {}  # robots that a device without one may be, by its link
        self._earlier = EarlierCommands()
        self._away = RetentionPolicy(config.link.forget_robot_after_s)  # robots that may be forgotten
        self._wake = asyncio.Event()

    # -- links --------------------------------------------------------------------------------------------------------

    def new_number(self) -> int:
        """Return a number for a new connection, here or at another daemon."""
        return next(self._numbers)

    def device(self, key: Hashable) -> Device | None:
        """Return the device of a live link; None if the key is not a link, or has ended."""
        return self.devices.get(key.number) if isinstance(key, Link) else None

    def of_link(self, key: Hashable) -> LocalRobot | None:
        """Return the robot of a live link; None if it has none."""
        device = self.device(key)
        return None if device is None else device.robot

    def drivables(self) -> list[Drivable]:
        """Return all velocity topics of connected devices."""
        return [drivable for device in self.devices.values() for drivable in device.drivables]

    def may_move(self, now_s: float) -> bool:
        """Whether a device with a velocity topic may move, or a source here drives a robot of another daemon."""
        is_moving = any(drivable.gate.may_move for drivable in self.drivables())
        return is_moving or any(robot.admission.is_held(now_s) for robot in self.remote.values())

    def may_robot_move(self, name: str) -> bool:
        """Whether a velocity topic of this robot's devices may move."""
        members = (each for each in self.devices.values() if each.robot_name == name)
        return any(drivable.gate.may_move for device in members for drivable in device.drivables)

    # -- robots -------------------------------------------------------------------------------------------------------

    def here(self) -> list[LocalRobot]:
        """Return the robots of this daemon by name, connected or not yet forgotten."""
        return [self._robots[name] for name in sorted(self._robots)]

    def all(self) -> list[AnyRobot]:
        """Return all robots by name, including those of other daemons. Of one name, the robot that `find` returns."""
        return list(filter(None, map(self._find, sorted(self._robots.keys() | self.remote.keys()))))

    def find(self, name: str, *, driver: Callable[[], Hashable] | None = None) -> AnyRobot:
        """Return the robot of this name, connected or not.

        Raises:
            UnknownTopic: it does not exist. A stream of the source that `driver` returns moves no later robot.
        """
        plain = name.strip("/")
        here = self._robots.get(plain)
        if here is not None and here.connection is not None:
            return here
        robot = self._find(plain)
        if robot is None:
            self._note_early(plain, driver)
            raise UnknownTopic("robot", name, self._robots.keys() | self.remote.keys())
        return robot

    def find_to_stop(self, name: str) -> AnyRobot:
        """Return the robot of this name, for a stop or a lock; also one of the settings that has never been commanded.

        It is known from then on: what is connected of it is stopped, and a lock holds for what connects later.

        Raises:
            UnknownTopic: it does not exist, and the settings do not name it.
        """
        plain = name.strip("/")
        if plain in self._configs and self._find(plain) is None:
            self._expect(plain)
        return self.find(name)

    def _expect(self, name: str) -> None:
        """Add a robot of the settings whose topics are not known yet."""
        config = self.config_of(name)
        command = TopicType(f"/{name}/cmd_vel", TWIST_TYPE)
        topics = RobotTopicNames(name, (command,))
        feedback = Feedback((), FeedbackSettings(), drive_in(config))
        self._add(self._make(name, topics, topics, TwistCommand(command), feedback))
        self.on_change(name)
        self.regroup(name)

    def _add(self, robot: LocalRobot) -> None:
        """Add a robot. It is locked if all are."""
        self._robots[robot.name] = robot
        self._gates.register(robot.admission)
        self._join_early(robot)
        if self.boards.lock_reason is not None:
            robot.admission.lock(self.boards.lock_reason, loop_time_s(), by=self.boards.locked_by)

    def _note_early(self, name: str, driver: Callable[[], Hashable] | None) -> None:
        if driver is not None:
            self._earlier.note(name, driver(), loop_time_s())

    def _join_early(self, robot: AnyRobot) -> None:
        """Note sources that commanded this name before the robot existed: they are in the middle of a motion."""
        now_s = loop_time_s()
        robot.admission.join(self._earlier.sources(robot.name, now_s), now_s)

    def has(self, name: str) -> bool:
        """Whether a robot of this name exists, here or at another daemon."""
        return self._find(name) is not None

    def _find(self, name: str) -> AnyRobot | None:
        """Find a robot. One of this daemon precedes, unless it is disconnected and another daemon has it."""
        robot, remote = self._robots.get(name), self.remote.get(name)
        is_elsewhere = robot is not None and robot.link is None and remote is not None and remote.link is not None
        return remote if robot is None or is_elsewhere else robot

    def find_here(self, name: str, *, driver: Callable[[], Hashable] | None = None) -> LocalRobot:
        """Return the robot of this daemon with this name, connected or not; as `find`.

        Raises:
            UnknownTopic: it does not exist.
        """
        robot = self.get_here(name)
        if robot is None:
            self._note_early(name, driver)
            raise UnknownTopic("robot", name, self._robots)
        return robot

    def get_here(self, name: str) -> LocalRobot | None:
        """Return the robot of this daemon with this name; None if it does not exist."""
        return self._robots.get(name)

    def taken_names(self) -> set[str]:
        """Return the names that no other device should be given: of configured and of connected robots."""
        return {*self._configs, *(robot.name for robot in self._robots.values() if robot.connection is not None)}

    def is_free(self, name: str) -> bool:
        """Whether no device is the robot of this name."""
        robot = self._robots.get(name)
        return robot is None or robot.connection is None

    def is_known(self, robot: AnyRobot) -> bool:
        """Whether a robot is not forgotten."""
        return robot in (self._robots.get(robot.name), self.remote.get(robot.name))

    def lock_of(self, device: Device) -> Admission:
        """Return the admission whose lock holds for a device without a robot: of one that it may be, or of all."""
        names = self._may_be.get(device.link.number, ())
        known = (self._robots[name] for name in sorted(names) if name in self._robots)
        return next((robot.admission for robot in known if robot.is_away_and_locked), self.boards)

    def may_be(self, device: Device) -> frozenset[str]:
        """Return the robots that a device without one may be."""
        return self._may_be.get(device.link.number, frozenset())

    def has_candidate(self, name: str) -> bool:
        """Whether a device without a robot may be this one."""
        return any(name in names for names in self._may_be.values())

    def note_candidate(self, device: Device, placed: Iterable[str]) -> set[str]:
        """Note which robots a device may be: those `placed` where it is, and those whose command and address it has.

        Return the names of these robots, and of those that it could have been before.
        """
        before = self._may_be.pop(device.link.number, frozenset())
        commands = {(each.name, each.type_name) for each in device.endpoints if each.is_to_device}
        link = device.link
        alike = (
            robot.name
            for robot in self._robots.values()
            if robot.last_link == link.number
            or (robot.last_address == link.address and not commands.isdisjoint(robot.topics.commands))
        )
        names = frozenset(name for name in (*placed, *alike) if not self.config_of(name).devices)
        if names:
            self._may_be[link.number] = names
        return {*before, *names}

    def forget_candidate(self, device: Device) -> set[str]:
        """Note that a device is a robot, or has left. Return the names of the robots that it could have been."""
        return set(self._may_be.pop(device.link.number, ()))

    def locked_on(self, link: Link) -> LocalRobot | None:
        """Return the locked robot that the device of this link was until now; None if there is none."""
        robots = self._robots.values()
        return next((each for each in robots if each.last_link == link.number and each.is_away_and_locked), None)

    def locked_at(self, address: str, robot: LocalRobot, *, is_new: bool) -> LocalRobot | None:
        """Return a locked robot that is away and may be this one, because it had its address; None if there is none.

        It has the same command and another name. `is_new`: this robot has not been at its address before, so that it
        may be any of the others if all of them are locked and away.
        """
        there = [each for each in self._robots.values() if each.last_address == address and each is not robot]
        locked = [each for each in there if each.is_away_and_locked]
        if is_new and locked and locked == there:
            return locked[0]
        renamed = (each for each in locked if each.topics.name != robot.topics.name)
        return next((each for each in renamed if set(each.topics.commands) & set(robot.topics.commands)), None)

    def locked_likewise(self, robot: LocalRobot) -> LocalRobot | None:
        """Return a locked robot that may be this one, reconnected under another name; None if there is none."""
        for other in self._robots.values():
            is_alike = other is not robot and other.topics.name == robot.topics.name
            if is_alike and other.gate.lock_reason is not None and not other.is_surely_there():
                return other
        return None

    def stop_all(self, *, by: str | None = None) -> list[CommandEndpoint]:
        """Stop every robot, including those of other daemons, and every board. `by` is who stops them, for refusals.

        Return the endpoints here that command a motion and are not a robot's, with what became of each.

        Raises:
            HostlinkError: the zero does not fit a robot's device; all others have been stopped.
        """
        self._gates.providers.stop(None)
        return self.stop_all_here(by=by)

    def stop_all_here(self, *, by: str | None = None) -> list[CommandEndpoint]:
        """Stop every robot and every board of this daemon; as `stop_all`."""
        for device in self.devices.values():
            device.stop_unguarded()
        try:
            self._gates.stop(self.drivables(), by=by)
        except HostlinkError:
            of_robots = (each for device in self.devices.values() if device.robot for each in device.drivables)
            if any(each.refusals.cause is not None for each in of_robots):
                raise  # else it is a board's, which is named below
        return self.endpoints()

    def refusal(self, robot: AnyRobot) -> str:
        """Return why a connected robot here refused its last velocity, as that of a stop; empty: it did not."""
        return robot.refusals.cause or "" if isinstance(robot, LocalRobot) and robot.link is not None else ""

    def lock_all(self, reason: str, *, by: str | None = None) -> list[CommandEndpoint]:
        """Lock every robot and every board, including those of other daemons, also boards that connect later.

        Return the endpoints here that command a motion and are not a robot's, with what became of each.

        Raises:
            HostlinkError: the zero does not fit a robot's device; it is locked nevertheless, and so are all others.
        """
        self._gates.providers.lock(None, shown_reason(reason))
        return self._lock({robot: robot.lock for robot in self.all()}, reason, by=by)

    def lock_all_here(self, reason: str, *, by: str | None = None) -> list[CommandEndpoint]:
        """Lock every robot and every board of this daemon; as `lock_all`."""
        return self._lock({robot: robot.lock_here for robot in self.here()}, reason, by=by)

    def _lock(
        self, robots: Mapping[AnyRobot, Callable[..., None]], reason: str, *, by: str | None
    ) -> list[CommandEndpoint]:
        """Lock the boards here, and robots by these methods, which also stop what else the robots' devices take."""
        self.boards.lock(shown_reason(reason), loop_time_s(), by=by)
        log.warning("robots.all_locked", reason=self.boards.lock_reason)
        refusal = None
        for lock in robots.values():
            try:
                lock(reason, by=by)
            except HostlinkError as error:
                refusal = error
        with contextlib.suppress(HostlinkError):  # it is named below
            self._gates.lock(self._without_robot(), self.boards.lock_reason or reason, by=by)
        of_robots = {device for robot in robots if isinstance(robot, LocalRobot) for device in robot.devices}
        for device in self.devices.values():
            if device not in of_robots:
                device.stop_unguarded()
        if refusal is not None:
            raise refusal
        return self.endpoints()

    def unlock_all(self, *, by: str | None = None) -> None:
        """Admit commands of all robots and boards again, including those of other daemons. Unlocking moves nothing.

        Raises:
            DeviceGone: several robots of other daemons have one name; all others are unlocked.
        """
        self._gates.providers.unlock_all()
        self._unlock_boards(by=by)
        refusal = None
        for robot in self.all():
            if robot.admission.lock_reason is not None:
                try:
                    robot.unlock(by=by)
                except HostlinkError as error:
                    refusal = error
        if refusal is not None:
            raise refusal

    def unlock_all_here(self, *, by: str | None = None) -> None:
        """Admit commands of the boards of this daemon again, and of its robots whose name no other daemon has."""
        self._unlock_boards(by=by)
        for robot in self.here():
            if robot.admission.lock_reason is not None and not robot.also_at:
                robot.unlock(by=by)

    def _unlock_boards(self, *, by: str | None) -> None:
        if self.boards.lock_reason is not None:
            log.warning("robots.all_unlocked", reason=self.boards.lock_reason)
        self.boards.unlock(loop_time_s(), by=by)
        self._gates.unlock(self._without_robot(), by=by)
        for device in self.devices.values():
            self._follow_lock(device)

    def endpoints(self) -> list[CommandEndpoint]:
        """Return the endpoints here that command a motion and are not a robot's, after a stop or a lock."""
        unguarded = [each for device in self.devices.values() for each in device.unguarded_endpoints()]
        return [*self._of_no_robot(), *unguarded]

    def _without_robot(self) -> list[Drivable]:
        """Return the velocity topics that belong to no robot."""
        return [each for device in self.devices.values() if device.robot is None for each in device.drivables]

    def _of_no_robot(self) -> list[CommandEndpoint]:
        return [each for device in self.devices.values() for each in device.of_no_robot()]

    # -- which come and leave -----------------------------------------------------------------------------------------

    def make_room(self, name: str) -> bool:
        """Return whether there is room for a robot of this name, after forgetting a disconnected one if necessary."""
        if name not in self._robots and len(self._robots) >= self.max_robots:
            self._forget(self._away.pop_first())
        return name in self._robots or len(self._robots) < self.max_robots

    def appear(self, name: str, topics: RobotTopicNames, shown: RobotTopicNames, device: Device) -> LocalRobot:
        """Connect a robot to its device, with topics as the device names them and as the graph shows them.

        Earlier commands are void: the first velocity is zero.

        Raises:
            ConfigError: the settings of its command do not fit the topics.
        """
        config = self._config_of(name, topics.name)
        commands = commands_of(topics.commands, config, kind=topics.kind, frame_id=frames_of(name, config).base)
        _check_zeros(commands, topics.kind, device)
        try:
            feedback = feedback_of(topics, device.sent_topics, config)
        except ConfigError as error:  # no limit depends on them
            device.refused_settings = str(error)
            feedback = feedback_of(topics, device.sent_topics, dataclasses.replace(config, encoders=None))
        if device.robot is not None and device.robot.name != name:
            self.vanish(device)
        robot = self._robots.get(name)
        if robot is not None and robot.connection is not None:  # otherwise the end of its drive is known
            self._gates.note_end(robot, OTHER_TOPICS)
        self._gates.detach(device)
        if robot is None:
            robot = self._make(name, topics, shown, commands, feedback)
            self._add(robot)
        before = self.device(robot.link)
        if before is not None:
            before.robot = None
            self._gates.detach(before)
        robot.topics, robot.shown, robot.commands, robot.feedback = topics, shown, commands, feedback
        _configure(robot)  # its drive follows from its command
        robot.battery = None
        device.robot = robot
        if not device.diagnosis.is_played:
            robot.last_link, robot.last_address = device.link.number, device.link.address
        device.diagnosis.monitor.motion.topic = topics.odometry or ""
        self._away.remove(name)
        self._gates.attach(robot, device)
        self.on_change(name)
        link = device.link
        self._gates.events.note(EventKind.APPEARED, name, link=link.number, peer=link.peer)
        log.info("robot.appeared", robot=name, velocity=shown.velocity, odometry=shown.odometry)
        return robot

    def vanish(self, device: Device) -> LocalRobot | None:
        """Disconnect the robot of a device, after a last zero. Return the robot; None if the device had none."""
        robot, device.robot = device.robot, None
        was_moving = robot is not None and robot.gate.is_driven and not robot.is_played
        self._gates.detach(device)
        if robot is None:
            return None
        robot.battery = None
        log.warning("robot.gone", robot=robot.name)
        self._gates.events.note(EventKind.GONE, robot.name, link=device.link.number, was_moving=was_moving)
        self._put_away(robot)
        self.on_change(robot.name)
        return robot

    def regroup(self, name: str) -> LocalRobot | None:
        """Find the parts of a robot of several devices anew, after one of them came, left or has other topics.

        While one is missing, no velocity topic of the others is driven. Return the robot; None if it has never been
        commanded.
        """
        robot = self._robots.get(name)
        found = self._members_of(name)
        members = {member.place: device for member, device in found if not member.is_waiting}
        waiting = [(member, device) for member, device in found if member.is_waiting]
        config = self.config_of(name) if robot is None else robot.config
        if not config.devices:
            if robot is not None:
                self._note_parts(robot, (), None)
                self._gates.note_missing([robot], "")
                self._note_candidates(robot)
            return robot
        endpoints = {place: device.endpoints for place, device in members.items()}
        parts = parts_of(name, command_settings(config), endpoints)
        for member, device in waiting:
            device.unfit = _why_waiting(member, device, members.get(member.place))
            self._note_missing(name, device.drivables, device.unfit)
            device.note_missing(device.unfit)
        is_unfit = parts.command is None and len(members) == len(config.devices)
        for device in members.values():
            device.unfit = parts.why_not if is_unfit and device.robot is None else ""
            device.note_missing(parts.why_not)
        drivables = [each for device in members.values() for each in device.drivables]
        if robot is None:
            self._note_missing(name, drivables, parts.why_not)
            return None
        every = (*members.values(), *(device for _, device in waiting))
        self._note_parts(robot, tuple(each for each in every if each is not robot.connection), None)
        before = robot.admission.missing
        self._note_missing(name, dict.fromkeys((robot, *drivables)), parts.why_not)
        if parts.why_not and parts.why_not != before:
            log.warning("robot.incomplete", robot=name, reason=parts.why_not)
        elif before and not parts.why_not:
            log.info("robot.complete", robot=name)
        self._read_parts(robot, parts, members)
        self._note_candidates(robot)
        self._lock_as(robot.admission, robot.beside)
        return robot

    def _note_candidates(self, robot: LocalRobot) -> None:
        """Let the stop and the lock of a robot that is away hold for the devices that may be it."""
        links = (link for link, names in self._may_be.items() if robot.name in names and robot.connection is None)
        before, robot.candidates = robot.candidates, tuple(self.devices[link] for link in links)
        for device in self._connected(dict.fromkeys((*before, *robot.candidates))):
            self._follow_lock(device)
            if device not in before and device.lock.lock_reason is not None:
                device.stop_unguarded()

    def _connected(self, connections: Collection[Connection]) -> list[Device]:
        """Return those devices of these connections that have not left."""
        return [self.devices[each.link.number] for each in connections if each.link.number in self.devices]

    def _follow_lock(self, device: Device) -> None:
        """Lock or unlock the velocity topics of a device without a robot, as the robots that it may be are."""
        if device.robot is not None or device.member is not None:
            return
        self._lock_as(device.lock, device.drivables)
        if device.lock.lock_reason is None:
            self._gates.unlock(each for each in device.drivables if each.admission.lock_reason is not None)

    def _lock_as(self, lock: Admission, drivables: Iterable[Drivable]) -> None:
        """Lock velocity topics that are not locked yet, if this lock is in force."""
        for drivable in drivables:
            if lock.lock_reason is not None and drivable.admission.lock_reason is None:
                with contextlib.suppress(HostlinkError):  # the lock holds even if the device refuses the zero
                    self._gates.lock([drivable], lock.lock_reason, by=lock.locked_by)

    def boards_of(self, device: Device) -> list[Device]:
        """Return all devices of the robot of this one; none while one of several is not connected."""
        if device.member is None:
            return [device]
        found = self._members_of(device.member.robot)
        places = self.config_of(device.member.robot).devices or ()
        return [each for _, each in found] if {member.place for member, _ in found} >= set(places) else []

    def _members_of(self, name: str) -> list[tuple[Membership, Device]]:
        """Return the connected devices of a robot of several devices, also those that wait for a place."""
        found = ((device.member, device) for device in self.devices.values() if not device.is_undecided)
        return [(member, device) for member, device in found if member is not None and member.robot == name]

    def _note_parts(
        self, robot: LocalRobot, parts: tuple[Device, ...], links: dict[tuple[str, str], Link] | None
    ) -> None:
        touched = (*robot.parts, *parts)
        for device in self.devices.values():  # what has left reads nothing
            if device in touched:
                device.read_for(None)
        robot.parts, robot.feedback_links = parts, links

    def _note_missing(self, name: str, drivables: Iterable[Drivable], why_not: str) -> None:
        """Note for each velocity topic of a robot's devices why the robot cannot be driven; empty: it can."""
        own, others = list[Drivable](), list[Drivable]()
        for drivable in drivables:
            (own if drivable.name == name else others).append(drivable)
        self._gates.note_missing(own, why_not)
        self._gates.note_missing(others, why_not and f"robot {name}: {why_not}")

    def _read_parts(self, robot: LocalRobot, parts: Parts, members: dict[str, Device]) -> None:
        """Read the robot's feedback from the devices that send it."""
        odometry = robot.config.feedback.topic
        if odometry is None:
            odometry = parts.odometry()
        offered = [TopicType(each.name, each.type_name) for _, each in parts.feedback]
        topics = dataclasses.replace(robot.topics, odometry=odometry or None)
        try:
            robot.feedback = feedback_of(topics, offered, robot.config)
        except ConfigError as error:
            log.warning("robot.settings_refused", robot=robot.name, reason=str(error))
            return
        places = {topic: parts.place_of(topic) for topic in robot.feedback.topics}
        readers = {topic: members[place] for topic, place in places.items() if place is not None}
        robot.feedback_links = {topic: device.link for topic, device in readers.items()}
        for device in members.values():
            device.read_for(robot)
        first = next(iter(readers.items()), None)
        if robot.connection is not None:
            robot.connection.diagnosis.monitor.motion.topic = odometry or ""
        is_message = first is not None and odometry and robot.config.encoders is None
        name = first[1].shown.of(first[0][0]) if first is not None and is_message else None
        robot.shown = dataclasses.replace(
            robot.shown, odometry=name, odometry_type=first[0][1] if first is not None and is_message else None
        )

    def put_remote(self, robot: RemoteRobot) -> None:
        """Add a robot that a component announces."""
        self.pop_remote(robot.name)
        self.remote[robot.name] = robot
        self._gates.register(robot.admission)
        self._join_early(robot)
        self.on_change(robot.name)

    def pop_remote(self, name: str) -> RemoteRobot | None:
        """Remove and return a robot that a component has announced; None if there is none of this name."""
        robot = self.remote.pop(name, None)
        if robot is not None:
            robot.leave()
            self._gates.unregister(robot.admission)
            self.on_change(name)
        return robot

    def reconfigure(self, configs: dict[str, RobotConfig]) -> None:
        """Replace the settings of robots: their limits, and which ones are never forgotten."""
        self.max_robots += len(configs) - len(self._configs)
        before, self._configs = self._configs, configs
        for robot in list(self._robots.values()):
            robot.config = self._config_of(robot.name, robot.topics.name)
            _configure(robot)
            if robot.name in configs:
                self._away.remove(robot.name)
            elif robot.name in before:
                self._put_away(robot)

    def forget(self, name: str) -> None:
        """Forget a disconnected robot, whose device has another name now."""
        robot = self._robots.get(name)
        if robot is not None and robot.link is None and name not in self._configs:
            self._away.remove(name)
            self._forget(name)

    def forget_played(self, robot: LocalRobot) -> None:
        """Forget a robot whose recording has ended, unless a device has had its name, or it is locked."""
        if not robot.has_had_device and robot.gate.lock_reason is None:
            self.forget(robot.name)

    def _note_lock(self, robot: LocalRobot) -> None:
        """Update the retention of a robot after a lock or unlock, and the lock of what may be it.

        A locked robot is not forgotten.
        """
        for device in self._connected(robot.candidates):
            self._follow_lock(device)
        if robot.gate.lock_reason is not None:
            self._away.remove(robot.name)
        else:
            self._put_away(robot)

    def _put_away(self, robot: LocalRobot) -> None:
        """Start the retention of a robot, unless it is connected, configured or locked."""
        if robot.link is None and robot.gate.lock_reason is None and robot.name not in self._configs:
            self._away.put(robot.name, loop_time_s())
            self._forget_some()
            self._wake.set()

    async def run(self) -> None:
        """Forget robots whose retention ended, until cancelled."""
        while True:
            self._wake.clear()
            forgets_at_s = self._away.next_s()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(None if math.isinf(forgets_at_s) else forgets_at_s):
                    await self._wake.wait()
            self._forget_some()

    async def repeat_zeros(self) -> None:
        """Send zeros again to what is locked and has no gate, until cancelled: the first one may be lost."""
        while True:
            await asyncio.sleep(LOCKED_ZERO_INTERVAL_S)
            for device in list(self.devices.values()):
                if device.unguarded and device.lock.lock_reason is not None:
                    device.stop_unguarded()

    def _make(
        self, name: str, topics: RobotTopicNames, shown: RobotTopicNames, commands: CommandType, feedback: Feedback
    ) -> LocalRobot:
        config = self._config_of(name, topics.name)
        admission = Admission(name, epoch=self._first_epoch())
        robot = LocalRobot(
            name=name,
            gates=self._gates,
            on_lock=self._note_lock,
            commands=commands,
            gate=VelocityGate(admission, limits_of(config, topics.commands), ZERO, motion_of(topics.commands[0].name)),
            config=config,
            odometry=OdometryEstimator(
                continues=config.odometry_after_restart == "continue", correction=correction_of(config)
            ),
            feedback=feedback,
            topics=topics,
            shown=shown,
        )
        _configure(robot)
        return robot

    def config_of(self, name: str) -> RobotConfig:
        """Return the settings of a configured robot, connected or not."""
        return self._configs.get(name, RobotConfig())

    def _config_of(self, name: str, own_name: str) -> RobotConfig:
        return self._configs.get(name) or of_namesake(self._configs.get(own_name))

    def _forget_some(self) -> None:
        for name in self._away.pop_forgotten(loop_time_s()):
            self._forget(name)

    def _forget(self, name: str | None) -> None:
        if name is not None:
            robot = self._robots.pop(name)
            self._gates.unregister(robot.admission)
            self.forgotten += 1
            log.info("robot.forgotten", robot=name)
            self._gates.events.note(EventKind.FORGOTTEN, name)
            self.on_forgotten(robot)
            self.on_change(name)


def _why_waiting(member: Membership, device: Device, holder: Device | None) -> str:
    """Return why a device waits for its place in a robot of several devices, which `holder` has."""
    if holder is None:
        return f"its device {member.place} has left, and another one that fits waits until the robot has stopped"
    return (
        f"its device {member.place} is {holder.link.peer}, so that {device.link.peer} is not driven; tell them apart "
        f"by addresses with ports in devices of [robots.{member.robot}]"
    )


def _check_zeros(commands: CommandType, kind: CommandKind, device: Device) -> None:
    """Check that the device takes what stops it: a word that drives it may be shorter.

    Raises:
        ConfigError: it does not. A Twist is not checked: a device that takes no zero takes no other, either.
    """
    if kind in (CommandKind.TWIST, CommandKind.ACKERMANN):
        return
    for topic, zero in zip(commands.topics, commands.encode(ZERO), strict=True):
        try:
            device.link.session.endpoint_of(topic.name, zero)
        except FrameTooLarge as error:
            raise ConfigError(kind, f"what stops it does not fit the board: {error}") from error
        except HostlinkError:  # the topic was refused: nothing drives it
            continue


def _configure(robot: LocalRobot) -> None:
    """Apply the settings that a reload may change."""
    config, admission, odometry = robot.config, robot.admission, robot.odometry
    admission.resume_after_reconnect_s = config.resume_after_reconnect_s
    limits = limits_of(config, robot.topics.commands)
    admission.drive = limits.drive
    admission.max_stamp_age_s = math.inf if config.cmd_vel_max_age_s is None else config.cmd_vel_max_age_s
    odometry.is_differential = not limits.drive.has_y
    odometry.change_fastest(PlanarVelocity(config.max_linear_m_s, yaw_rad_s=config.max_angular_rad_s))
    for drivable in robot.beside:
        drivable.gate.change_limits(limits)
