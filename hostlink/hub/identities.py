"""Identities: who the device of each link is, which robot it is, and what that means for the graph."""

import asyncio
import contextlib
import dataclasses
from typing import NamedTuple

import structlog

from hostlink.errors import HostlinkError, ReloadRefused
from hostlink.hub.device import Device, ShownNames
from hostlink.hub.gates import Gates
from hostlink.hub.isolation import Spawn
from hostlink.hub.robot import LocalRobot
from hostlink.hub.robot_topic_publisher import RobotTopicPublisher
from hostlink.hub.robots import Robots
from hostlink.hub.topic_graph import TopicGraph
from hostlink.link.link import Link, LinkEnd
from hostlink.logs import printable
from hostlink.protocol.control import TopicInfo
from hostlink.protocol.events import MessageReceived
from hostlink.robot.directory import Accepted, Directory, Places, RobotTopicNames, Undecided

log = structlog.get_logger()

DECIDE_INTERVAL_S = 0.05  # a robot speaks every 0.1 s
LAST_ZERO_S = 0.2  # for the zero to a link that is replaced while its robot drives


class Affected(NamedTuple):
    """What of the hub depends on who a device is."""

    topics: TopicGraph
    gates: Gates
    robots: Robots
    robot_topics: RobotTopicPublisher


class Identities:
    """The Directory decides which robot a device is, this does what was decided."""

    def __init__(self, affected: Affected, directory: Directory, *, spawn: Spawn) -> None:
        self.devices = affected.robots.devices
        self.undelivered = 0  # messages of devices that left before it was known who they are, or had too many
        self._affected, self._directory = affected, directory
        self._spawn = spawn

    def note_read(self, link: Link) -> None:
        """A device sent something."""
        self._directory.note_read(link.number, link.received_at_s)

    def announce(self, link: Link, infos: tuple[TopicInfo, ...]) -> None:
        """A device has announced its topics, other ones than before."""
        self.devices[link.number].infos = infos
        self._identify(self.devices[link.number])

    def keep(self, device: Device, message: MessageReceived) -> None:
        """It is not known yet who the device is: its messages are passed on later."""
        self.undelivered += device.early.add(message, device.link.received_at_s)

    def forget(self, link: Link) -> None:
        """The link has ended, or another replaces it."""
        device = self.devices.pop(link.number, None)
        if device is not None:
            self.undelivered += len(device.early)
            self._leave_graph(device)
            self._affected.gates.release(link)  # a device may drive another
            self._directory.leave(link.number)

    def forget_robot(self, robot: LocalRobot) -> None:
        """It has been away for long."""
        self._directory.forget(robot.name)
        self._affected.robot_topics.forget(robot)

    def check_places(self, places: Places) -> None:
        """Whether robots may be named by these.

        Raises:
            ReloadRefused: they change the name of one that is driven or locked, and is known by it to who did that.
        """
        for name in self._directory.misplaced(places):
            robot = self._affected.robots.get_here(name)
            if robot is None:
                continue
            if any(drivable.gate.is_driven for drivable in robot.beside):
                raise ReloadRefused(f"{name} is driven: stop it before its name changes")
            if robot.gate.lock_reason is not None:
                raise ReloadRefused(f"{name} is locked: unlock it before its name changes")

    def reconfigure(self, places: Places) -> dict[str, str]:
        """Name robots by these places from now on; returns the new names of those that are connected, by the old."""
        misplaced = self._directory.reconfigure(places)
        links = {name: link for name, link in misplaced.items() if link is not None}
        for link in links.values():
            self._leave_graph(self.devices[link])
        for name in misplaced:
            self._affected.robots.forget(name)
        for link in links.values():
            self._identify(self.devices[link])
        found = {name: self.devices[link].robot for name, link in links.items()}
        return {name: robot.name for name, robot in found.items() if robot is not None}

    def _identify(self, device: Device) -> None:
        """Find out which device it is, as far as that can be known by now."""
        link, infos = device.link, device.infos
        claim = self._directory.claim(
            link.number,
            link.address,
            [(info.name, info.type, info.is_to_device) for info in infos],
            now_s=asyncio.get_running_loop().time(),
            peer=link.peer,
            announced=infos,
        )
        if isinstance(claim, Undecided):
            self._wait(device, claim)
        elif claim.robot is not None and not self._affected.robots.make_room(claim.robot.name):
            self._refuse(link, claim.robot.name)
        else:
            self._accept(device, claim)

    def _wait(self, device: Device, claim: Undecided) -> None:
        """Another link may be the same device, silent or dead: request its topics, and claim again soon."""
        for number in claim.probe:
            rival = self.devices[number].link
            rival.session.request_topics("claimed_twice")
            rival.wake()
        if not device.is_undecided:
            device.is_undecided = True
            self._leave_graph(device)
            device.stand()
            self._spawn(self._decide(device), name=f"identity of link {device.link.number}")

    async def _decide(self, device: Device) -> None:
        while device.is_undecided:
            await asyncio.sleep(DECIDE_INTERVAL_S)
            if self.devices.get(device.link.number) is not device:
                return
            self._identify(device)

    def _refuse(self, link: Link, name: str) -> None:
        self._directory.leave(link.number)
        self._directory.forget(name)
        log.warning("link.refused", reason="too many robots are known: unlock those that are locked and not there")
        link.end(LinkEnd.REFUSED)

    def _accept(self, device: Device, claim: Accepted) -> None:
        """Put the device into the graph, as the robot that it is."""
        if claim.replaces is not None:
            self._replace(claim.replaces)
        touched, before = device.names, device.robot
        changed = [] if before is None else [before]
        if claim.robot is None:
            self._affected.robots.vanish(device)
            device.announce(device.infos, ShownNames())
        else:
            changed.append(self._accept_robot(device, claim, claim.robot))
        self._affected.robot_topics.update(changed, touched | device.names)
        self._log_name(device, claim)
        device.is_undecided = False
        for message, at_s in device.early.pop_all():
            device.receive(message, at_s)

    def _accept_robot(self, device: Device, claim: Accepted, names: RobotTopicNames) -> LocalRobot:
        before, robots = device.robot, self._affected.robots
        own = dataclasses.replace(names, name=claim.own_name)
        shown = ShownNames(own, names.name)
        robot = robots.appear(names.name, own, shown.of_robot(own), device)
        self._displace(robot)
        device.announce(device.infos, shown, robot)
        if not claim.is_certain and before is not robot and robot.gate.lock_reason is None:
            other = robots.locked_likewise(robot)
            if other is not None:
                with contextlib.suppress(HostlinkError):  # it is locked; a device that refuses a zero obeys nobody
                    robot.lock(f"it may be {other.name}: {other.gate.lock_reason}")
        return robot

    def _displace(self, robot: LocalRobot) -> None:
        """End what other devices have by the robot's own names with another type.

        Another robot whose own name it is keeps it, but not against a velocity.
        """
        for name, type_name in robot.shown.own.items():
            for key in self._affected.topics.devices_against(name, type_name):
                device = self._affected.robots.device(key)
                other = None if device is None else device.robot
                is_own = other is not None and name in other.shown.own and name != robot.shown.velocity
                if device is not None and other is not robot and not is_own:
                    device.displace(name, type_name, other)

    def _log_name(self, device: Device, claim: Accepted) -> None:
        """Which links are one device's distinguishes a reboot from another board; a number in a name is logged."""
        name = "" if claim.robot is None else claim.robot.name
        device.diagnosis.robot = name
        device.diagnosis.own_name = claim.own_name if claim.is_numbered else ""
        if claim.is_numbered:
            log.warning(
                "robot.numbered",
                robot=name,
                own_name=claim.own_name,
                advice=f'choose its name in hostlink.toml: [robots.NAME] address = "{printable(device.link.address)}"',
            )

    def _replace(self, number: int) -> None:
        """End the old link of a device that came back; if it drove, its zero may still arrive."""
        old = self.devices.get(number)
        if old is None:
            return
        is_moving = old.robot is not None and old.robot.gate.may_move
        self.forget(old.link)
        if is_moving:
            self._spawn(_end_replaced(old.link), name=f"end of link {number}")
        else:
            old.link.end(LinkEnd.REPLACED)

    def _leave_graph(self, device: Device) -> None:
        touched, robot = device.names, self._affected.robots.vanish(device)
        device.leave()
        if robot is not None or touched:
            self._affected.robot_topics.update([] if robot is None else [robot], touched)


async def _end_replaced(link: Link) -> None:
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(LAST_ZERO_S):
            await link.drained()
    link.end(LinkEnd.REPLACED)
