"""Links: the connections of all devices: opened and served, identified as robots, and removed from the graph."""

import asyncio
import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import structlog
from structlog.contextvars import bind_contextvars, unbind_contextvars

from hostlink.core.config import Config, LinkConfig
from hostlink.core.hub.device import Device, ShownNames
from hostlink.core.hub.device_calls import DeviceCalls
from hostlink.core.hub.memories import Memories
from hostlink.core.hub.parameters import ParameterAnswers, ParameterSource
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.hub.robot_settings import command_settings
from hostlink.core.hub.robot_topic_publisher import RobotTopicPublisher
from hostlink.core.hub.robots import Robots
from hostlink.core.hub.shared import Shared
from hostlink.core.link.capture_buffer import CaptureRoom
from hostlink.core.link.link import Link
from hostlink.core.link.serving import Authenticate, LinkEnd, trust
from hostlink.core.protocol import events
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.robot.events import EventKind
from hostlink.core.robot.model import (
    CommandSettings,
    RobotTopicNames,
    Suggestion,
    find_robot,
    misfit,
    name_of,
    name_of_node,
    namespace_of,
    suggest,
    suggestion,
    unannounced,
)
from hostlink.core.robot.names import SURE_S, UNNAMED, Accepted, Directory, Origin, Places, Remembered, Undecided
from hostlink.core.robot.parts import Membership
from hostlink.core.runtime.logs import of_peer, printable
from hostlink.core.transport.base import Transport
from hostlink.errors import ConfigError, HostlinkError, ReloadRefused

log = structlog.get_logger()

SILENCE_TIMEOUT_S = 0.5  # for the request for silence before a link ends
UNGUARDED, REFUSED = "unguarded_command", "settings_refused"  # codes of findings
MAX_TEXT = 500  # characters of a warning: a device has many topics with long names
END_S = 0.0005  # CPU time for removing a device from the graph
DECIDE_INTERVAL_S = 0.05  # a robot sends every 0.1 s


class Links:
    """Opens, serves and ends the links, and answers what devices request: services, parameters, the time.

    `Directory` decides which robot a device is. This class carries the decision out. `Robots.devices` has the `Device`
    of each live link; events of a link that was replaced are ignored.
    """

    def __init__(
        self,
        shared: Shared,
        robots: Robots,
        robot_topics: RobotTopicPublisher,
        log_line: Callable[[str, events.DeviceLogged], None],
        first_call: Callable[[], int],
    ) -> None:
        """`log_line` shows a line of a device's log in the graph, by the name of its source.

        `first_call` draws the number of a connection's first call of a service.
        """
        self.parameter_source: ParameterSource | None = None  # for parameters that are not set here
        self.wall_ns = shared.wall_ns  # time in answers to devices
        self.undelivered = 0  # dropped messages of devices that were not identified yet
        self.late_answers = 0  # answers of devices' services after the timeout of the call
        self.on_named: Callable[[], None] = lambda: None  # called when a robot has its name
        self.memories = Memories()
        self._shared, self._robots, self._devices = shared, robots, robots.devices
        self._robot_topics, self._log_in_graph, self._first_call = robot_topics, log_line, first_call
        self._directory = Directory(addresses_of(shared.config), commands_by_name(shared.config))
        self._ends = shared.turns()
        self.calls = DeviceCalls(shared, give_up=self._give_up, name_of=self._service_name)
        # What every session and link gets, made once.
        self._capture_room = CaptureRoom()
        self._react, self._wall_ns, self._pauses = self.react, self._read_wall_ns, shared.gates.pauses
        self._parameters = ParameterAnswers(shared.parameters, lambda: self.parameter_source, shared.spawn)
        self._reactions: dict[type[Any], Callable[[Device, Any], None]] = {
            events.TopicsNegotiated: self._announce,
            events.TopicRefused: _log_refused_topic,
            events.TopicsRequested: _note_request,
            events.TopicsAnswered: _note_answer,
            events.ServiceRequested: lambda device, event: self.calls.accept(device.link, event),
            events.ServiceResponded: self._pass_answer,
            events.ResponseRefused: self._fail_call,
            events.ParameterRequested: self._answer_parameter,
            events.DeviceLogged: self._log_line,
            events.VersionRefused: _log_version,
        }

    # -- connections --------------------------------------------------------------------------------------------------

    def open(self, transport: Transport, protocol: DeviceProtocol, link_config: LinkConfig | None = None) -> Link:
        """Create the link of one connection, whose device speaks this protocol. `serve` must follow.

        If this device is remembered, the link continues where the last one ended.
        """
        shared = self._shared
        config = shared.config.link if link_config is None else link_config
        session = protocol.resumed(
            shared.catalog,
            self.memories.of(protocol, transport.kind, transport.peer, transport.address),
            uart_bytes_s=self._uart_bytes_s(transport, config),
            max_topics=config.max_topics,
            is_lossy=transport.kind == "udp",
        )
        session.number_calls(self._first_call())
        link = Link(
            transport,
            session,
            config,
            number=self._robots.new_number(),
            on_event=self._react,
            share=shared.share,
            room=self._capture_room,
            wall_ns=self._wall_ns,
            pauses=self._pauses,
        )
        self._devices[link.number] = Device(
            link,
            shared.diagnoses.begin(link),
            self._directory.presence(link.number),
            shared,
            self._robots,
            self._suggest,
        )
        self._capture_room.divide(len(self._devices))
        if session.is_recalled:
            self.memories.join(link)
        return link

    async def serve(self, link: Link, authenticate: Authenticate = trust) -> LinkEnd:
        """Serve a link to its end. The protocol begins when `authenticate` returns."""
        shared, end = self._shared, LinkEnd.CRASHED
        bound = {"link": link.number, "peer": printable(link.peer), **of_peer(link.address)}
        bind_contextvars(**bound)  # `bound_contextvars` would keep a generator for each link
        try:
            log.info("link.opened")
            shared.events.note(EventKind.LINK_OPENED, "", link=link.number, peer=link.peer)
            try:
                with shared.isolation.around("link"):  # a bug in one link must not stop another robot
                    end = await link.run(authenticate)
                    await self._ends.wait(END_S, is_flooding=True)  # many links that end at once are removed one by one
            except asyncio.CancelledError:
                end = LinkEnd.STOPPED
                raise
            finally:
                with shared.isolation.around("link"):
                    played = self._played_robot(link)
                    self._forget(link)
                    if played is not None:
                        self._robots.forget_played(played)
                    self.calls.leave(link)
                    shared.diagnoses.finish(link, end)
                shared.events.note(EventKind.LINK_CLOSED, "", link=link.number, peer=link.peer, reason=end.value)
                facts = dataclasses.asdict(link.facts())
                log.info("link.closed", reason=end.value, **facts.pop("counts"), **facts)
        finally:
            unbind_contextvars(*bound)
        return end

    def all(self) -> list[Link]:
        """Return the live links, oldest first."""
        return [device.link for device in self._devices.values()]

    async def silence(self) -> None:
        """Send every device the request for silence. Return when all were sent."""
        await _silence(self.all())

    def end_all(self) -> None:
        """End every link, because the daemon ends."""
        for link in self.all():
            link.end(LinkEnd.STOPPED)

    def shown_name(self, link: Link, name: str) -> str:
        """Return the name in the graph of a device's topic, service or parameter."""
        device = self._devices.get(link.number)
        return name if device is None else device.shown.of(name)

    def _read_wall_ns(self) -> int:
        return self.wall_ns()

    def _uart_bytes_s(self, transport: Transport, config: LinkConfig) -> int | None:
        here = (transport.peer, transport.address)
        rates = (robot.uart_bytes_s for robot in self._shared.config.robots.values() if robot.address in here)
        return next((rate for rate in rates if rate is not None), config.uart_bytes_s)

    async def _give_up(self, link: Link) -> None:
        """Stop a device that waits for an answer that does not fit its buffer, and end its link."""
        device = self._devices.get(link.number)
        self._shared.gates.stop_at_once([] if device is None else device.drivables)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SILENCE_TIMEOUT_S):
                await _silence([link])
        link.end(LinkEnd.UNANSWERABLE)

    def _service_name(self, link: Link, name: str) -> str:
        """Return the service in the robot's namespace if it exists; else the announced name."""
        shown = self.shown_name(link, name)
        return shown if self._shared.services.is_offered(shown) else name

    # -- events of sessions -------------------------------------------------------------------------------------------

    def react(self, link: Link, event: events.Event) -> None:
        """React to an event of a live link."""
        device = self._devices.get(link.number)
        if device is None:
            return
        device.presence.note_read(link.received_at_s)
        if not isinstance(event, events.MessageReceived):
            self._shared.diagnoses.note(device.diagnosis, event)
            reaction = self._reactions.get(type(event))
            if reaction is not None:  # otherwise the session alone has reacted
                reaction(device, event)
        elif device.is_undecided:
            self.undelivered += device.early.add(event, (link.received_at_s, link.came_s))
        elif not self._shared.gates.is_closed:
            device.receive(event)

    def _announce(self, device: Device, event: events.TopicsNegotiated) -> None:
        log.info("topics.negotiated", count=len(event.topics), gap_at=event.gap_at, is_changed=event.is_changed)
        if event.is_changed:
            device.link.last_frames = ()  # its id may belong to another topic now
            device.infos = event.topics
            self._identify(device)
        else:
            device.announced_again()

    def _log_line(self, device: Device, event: events.DeviceLogged) -> None:
        robot, link = device.robot, device.link
        name = "" if robot is None else robot.name
        self._shared.events.note(EventKind.LOGGED, name, link=link.number, level=event.level, text=event.text)
        self._log_in_graph(name or link.peer, event)

    def _answer_parameter(self, device: Device, event: events.ParameterRequested) -> None:
        shown = device.shown.of(event.name)
        self._parameters.answer(device.link, event.name, shown, functools.partial(device.note_parameter, shown))

    def _pass_answer(self, device: Device, event: events.ServiceResponded) -> None:
        service = device.services.get(event.service.name)
        if service is None or not service.answered(event.payload, event.request):
            self._note_late(device, event.service.name)

    def _fail_call(self, device: Device, event: events.ResponseRefused) -> None:
        service = device.services.get(event.service.name)
        if service is None or not service.refused(event.reason, event.request):
            self._note_late(device, event.service.name)

    def _note_late(self, device: Device, service: str) -> None:
        if service != device.stop_service:  # no call waits for the answers to zeros
            self.late_answers += 1
            log.warning("service.late", service=printable(service))

    # -- which robot a device is --------------------------------------------------------------------------------------

    @property
    def remembered(self) -> dict[str, Remembered]:
        """Names like robot_0 and their owners, for the next start of the daemon."""
        return dict(self._directory.remembered)

    def remember(self, remembered: Mapping[str, Remembered]) -> None:
        """Remember owners of names from before this start."""
        self._directory.remember(remembered)

    def forget_robot(self, robot: LocalRobot) -> None:
        """Forget a robot that has been disconnected for long."""
        self._directory.forget(robot.name)
        self._robot_topics.forget(robot)

    def check(self, places: Places) -> None:
        """Check whether robots may be named by these places.

        Raises:
            ReloadRefused: a robot that is driven or locked would have another name.
        """
        for name in self._directory.misplaced(places):
            robot = self._robots.get_here(name)
            if robot is None:
                continue
            if any(drivable.gate.is_driven for drivable in robot.beside):
                raise ReloadRefused(f"{name} is driven: stop it before its name changes")
            if robot.gate.lock_reason is not None:
                raise ReloadRefused(f"{name} is locked: unlock it before its name changes")
        for device in self._devices.values():
            for name in sorted(self._freed(device, places)):
                robot = self._robots.get_here(name)
                if robot is not None and robot.gate.lock_reason is not None:
                    raise ReloadRefused(f"{name} is locked: unlock it before {device.link.peer} leaves it")

    def _freed(self, device: Device, places: Places) -> set[str]:
        """Return the robots whose lock holds for a device by the settings, and would no longer hold by these places."""
        member, origin, may_be = device.member, _origin(device.link), self._robots.may_be(device)
        here = {name for name in self._directory.placed(origin) if name in may_be and self._robots.is_free(name)}
        if member is not None and not places.keeps(member.robot, member, is_connected=True):
            here.add(member.robot)
        return here.difference(places.nearest(origin))

    def reconfigure(self, places: Places, settings: Mapping[str, CommandSettings]) -> dict[str, str]:
        """Replace the configured addresses and commands of robots.

        Return the new names of connected robots by their old ones.
        """
        misplaced = self._directory.reconfigure(places, settings)
        links = {name: link for name, link in misplaced.items() if link is not None}
        touched = sorted({*links.values(), *self._commanded_otherwise()}, key=self._order)  # each keeps its place
        for link in touched:
            self._leave_graph(self._devices[link])
        for name in misplaced:
            self._robots.forget(name)
        for link in touched:
            self._identify(self._devices[link])
        joined = set[str]()
        for device in self._devices.values():  # what the settings place where a device is may be another robot now
            if device.robot is None and not device.is_undecided and device.infos:
                joined |= self._note_candidate(device)
        self._regroup(joined)
        found = {name: self._devices[link].robot for name, link in links.items()}
        return {name: robot.name for name, robot in found.items() if robot is not None}

    def _order(self, number: int) -> tuple[bool, int]:
        """Return what orders devices that claim anew: those that wait for another's place are the last ones."""
        member = self._devices[number].member
        return member is not None and member.is_waiting, number

    def _commanded_otherwise(self) -> list[int]:
        """Return the links of devices whose commands have other settings than they were identified with."""
        found = []
        for number, device in self._devices.items():
            link = device.link
            settings = self._directory.find(device.endpoints, _origin(link))[1]
            if device.infos and settings != device.settings:
                found.append(number)
        return found

    def _forget(self, link: Link) -> None:
        """Remove the device of a link that ended or was replaced."""
        device = self._devices.pop(link.number, None)
        self.memories.leave(link)
        self._capture_room.divide(len(self._devices))
        if device is not None:
            self.undelivered += len(device.early)
            self._directory.leave(link.number)
            self._leave_graph(device)
            self._shared.gates.release(link)  # the device may have driven another one

    def _played_robot(self, link: Link) -> LocalRobot | None:
        """Return the robot of a link on which a recording is played; None for a device, or after a replacement."""
        device = self._devices.get(link.number)
        return device.robot if device is not None and device.diagnosis.is_played else None

    def _identify(self, device: Device) -> None:
        """Identify a device: accept it, refuse it, or wait for the Directory to decide."""
        link, infos = device.link, device.infos
        claim = self._directory.claim(
            link.number,
            link.address,
            device.endpoints,
            now_s=asyncio.get_running_loop().time(),
            peer=link.peer,
            announced=infos,
            node=link.session.node,
        )
        if isinstance(claim, Undecided):
            self._wait(device, claim)
        elif claim.robot is not None and not self._robots.make_room(claim.robot.name):
            self._refuse(link, claim.robot.name)
        else:
            self._accept(device, claim)

    def _wait(self, device: Device, claim: Undecided) -> None:
        """Request the topics of other links that may be the same device, and identify this one again soon."""
        for number in claim.probe:
            rival = self._devices[number].link
            rival.session.probe()
            rival.wake()
        if not device.is_undecided:
            device.is_undecided = True
            self._leave_graph(device)
            device.stand()
            self._shared.spawn(self._decide(device), name=f"identity of link {device.link.number}")

    async def _decide(self, device: Device) -> None:
        while device.is_undecided:
            await asyncio.sleep(DECIDE_INTERVAL_S)
            if self._devices.get(device.link.number) is not device:
                return
            self._identify(device)

    def _refuse(self, link: Link, name: str) -> None:
        self._directory.leave(link.number)
        self._directory.forget(name)
        log.warning("link.refused", reason="too many robots are known: unlock those that are locked and not there")
        link.end(LinkEnd.REFUSED)

    def _accept(self, device: Device, claim: Accepted) -> None:
        """Put a device into the graph, as its robot if it has one."""
        if claim.replaces is not None:
            self._replace(claim.replaces)
        joined = {each.robot for each in (device.member, claim.member) if each is not None}
        before_member = device.member
        device.settings, device.member = claim.settings, claim.member
        if claim.member is not None and claim.member.is_waiting and claim.member != before_member:
            name, place, _ = claim.member
            log.warning("robot.device_twice", robot=name, device=printable(place), peer=printable(device.link.peer))
        device.refused_settings = ""
        touched, before = device.names, device.robot
        changed = [] if before is None else [before]
        robot = None if claim.robot is None else self._accept_robot(device, claim, claim.robot)
        if robot is None:
            named = () if claim.robot is None else (claim.robot.name,)  # its command does not fit
            joined |= self._note_candidate(device, *named)
            self._robots.vanish(device)
            device.announce(device.infos, ShownNames())
        else:
            joined |= self._robots.forget_candidate(device)
            changed.append(robot)
        device.is_undecided = False
        joined |= {each.name for each in changed if self._robots.has_candidate(each.name)}
        changed += self._regroup(joined)
        device.refused_settings = self._misfit(device, claim)
        self._robot_topics.update(changed, touched | device.names)
        self._log_name(device, claim)
        self.on_named()
        self._log_unguarded(device)
        for each in self._devices.values() if joined else ():  # what does not fit together concerns all of them
            if each is not device and each.member is not None and each.member.robot in joined:
                self._log_unguarded(each)
        for message, read in device.early.pop_all():
            device.receive(message, read)

    def _note_candidate(self, device: Device, *named: str) -> set[str]:
        """Note which robots a device without one may be: those that are named, and those that are placed where it is.

        Return the robots whose candidates change. Neither a part of a robot nor a recording is a candidate.
        """
        if device.member is not None or device.diagnosis.is_played:
            return self._robots.forget_candidate(device)
        return self._robots.note_candidate(device, [*named, *self._directory.placed(_origin(device.link))])

    def _misfit(self, device: Device, claim: Accepted) -> str:
        """Return what does not fit in the settings of a robot, now that its device is accepted; empty: nothing."""
        settings, boards = claim.settings, self._robots.boards_of(device)
        if device.diagnosis.is_played:
            return device.refused_settings
        endpoints = [each for board in boards for each in board.endpoints]
        services = [name for board in boards for name in board.services]
        others = unannounced(settings, endpoints, services) if boards else ""
        problems = (device.refused_settings, misfit(settings, endpoints) if boards else "", others)
        return "; ".join(filter(None, problems))

    def _accept_robot(self, device: Device, claim: Accepted, names: RobotTopicNames) -> LocalRobot | None:
        """Return the device's robot; None if the settings of its command do not fit the device's topics.

        A device that is a robot by itself is one with wrong settings, too: with its name, limits, stop and lock.
        """
        before, robots = device.robot, self._robots
        own = dataclasses.replace(names, name=claim.own_name)
        shown = ShownNames(own, names.name)
        known = robots.get_here(names.name)
        is_new = known is None or known.last_address != device.link.address
        try:
            robot = robots.appear(names.name, own, shown.of_robot(own), device)
        except ConfigError as error:
            device.refused_settings = str(error)
            by_itself = find_robot(device.endpoints, claim.settings._replace(kind=None, topics=()))
            if by_itself is None or by_itself.commands == names.commands:
                return None
            own = dataclasses.replace(by_itself, name=by_itself.name or UNNAMED)
            shown = ShownNames(own, names.name)
            robot = robots.appear(names.name, own, shown.of_robot(own), device)
        self._displace(robot)
        device.announce(device.infos, shown, robot)
        if before is not robot and robot.gate.lock_reason is None:
            other = None if claim.is_certain else robots.locked_likewise(robot)
            other = other or self._locked_before(device, robot, claim)
            other = other or robots.locked_on(device.link)
            if other is None and not self._directory.placed(_origin(device.link)):  # else the settings tell them apart
                other = robots.locked_at(device.link.address, robot, is_new=is_new)
            if other is not None:
                with contextlib.suppress(HostlinkError):  # the lock holds even if the device refuses the zero
                    reason = f"it may be {other.name}: {other.gate.lock_reason}"
                    robot.lock(reason, by=other.gate.admission.locked_by)
        return robot

    def _locked_before(self, device: Device, robot: LocalRobot, claim: Accepted) -> LocalRobot | None:
        """Return the locked robot whose name a device without its topics had until the right one connected."""
        name = self.origin_of(device)[1] if misfit(claim.settings, device.endpoints) else None
        other = None if name is None else self._robots.get_here(name)
        return other if other is not None and other is not robot and other.gate.lock_reason is not None else None

    def _displace(self, robot: LocalRobot) -> None:
        """Remove other devices from the robot's own topics if they have another type.

        Another robot keeps a topic of its own, unless it is this robot's velocity topic.
        """
        for name, type_name in robot.shown.own.items():
            for key in self._shared.topics.devices_against(name, type_name):
                device = self._robots.device(key)
                other = None if device is None else device.robot
                is_command = name in {topic.name for topic in robot.shown.commands}
                is_own = other is not None and name in other.shown.own and not is_command
                if device is not None and other is not robot and not is_own:
                    device.displace(name, type_name, other)

    def _log_name(self, device: Device, claim: Accepted) -> None:
        """Note names for the diagnosis, which distinguishes a reboot from another board. Log a numbered name."""
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

    def _log_unguarded(self, device: Device) -> None:
        """Note for the diagnosis what nothing guards, and which settings do not fit. Log what is new."""
        noted, before = dict[str, str](), device.diagnosis.noted
        if device.refused:
            noted[REFUSED] = device.refused
            if noted[REFUSED] != before.get(REFUSED):
                name = device.robot_name or device.diagnosis.robot or self.origin_of(device)[1]
                log.warning("robot.settings_refused", robot=name, reason=printable(device.refused, MAX_TEXT))
        if device.unguarded:
            topics = ", ".join(f"{device.shown.of(info.name)} ({info.type})" for info in device.unguarded)
            noted[UNGUARDED] = f"{topics}\n{device.suggestion}".strip()
            if noted[UNGUARDED] != before.get(UNGUARDED):
                lines = device.suggestion
                advice = f"in hostlink.toml: {printable(lines, MAX_TEXT)}" if lines else "correct its settings"
                log.warning("device.unguarded_command", topics=printable(topics, MAX_TEXT), advice=advice)
        device.diagnosis.noted = noted

    def _suggest(self, device: Device) -> Suggestion | None:
        """Return the settings that make a device a robot; None if it is one, or nothing looks like a command."""
        suspects, robots = device.unguarded_topics, self._robots
        if not suspects or device.robot_name is not None:
            return None
        others: dict[str, Suggestion | None] = {
            each.suggested.name: each.suggested
            for each in self._devices.values()
            if each is not device and each.suggested is not None
        }
        address = device.link.address
        name = self.origin_of(device)[1]
        if name is not None and robots.is_free(name) and name not in others:  # its table gets the lines
            if command_settings(robots.config_of(name)).topics:
                return None  # it has a command: what does not fit in it is a finding
            return Suggestion(name, address, suggestion(suspects, name, "", is_configured=True))
        others |= dict.fromkeys(robots.taken_names())
        name = name_of(suspects[0].name) or "my_robot"
        return suggest(suspects, name, address, device.link.peer, others)

    def origin_of(self, device: Device) -> tuple[str, str | None]:
        """Return the source of the name of a device's robot, and the robot whose settings apply to the device.

        The first is empty if it is not a robot.
        """
        link, configured = device.link, self._shared.config.robots
        found, chosen = self._directory.explain(device.endpoints, _origin(link))
        robot = device.robot
        settings = chosen if chosen is not None else robot.name if robot and robot.name in configured else None
        if robot is None:
            return "", settings
        own = "" if found is None else found.name
        node = name_of_node(link.session.node)
        if chosen == robot.name:
            return f"[robots.{chosen}] in hostlink.toml", settings
        if own and robot.name == own:
            command = robot.topics.velocity
            return f"the {'namespace' if namespace_of(command) else 'name'} of its command {command}", settings
        if own:
            return f"its command {robot.topics.velocity}, with a number: another device has the name {own}", settings
        if node:
            numbered = "" if robot.name == node else f", with a number: another device has the name {node}"
            return f"the node {link.session.node} of its device{numbered}", settings
        return (
            f"a number, which is kept for {link.address}: its command {robot.topics.velocity} tells no name",
            settings,
        )

    def _replace(self, number: int) -> None:
        """End the old link of a device that reconnected. Its last frame is a zero if it is a robot's."""
        old = self._devices.get(number)
        if old is not None:
            self._forget(old.link)
            old.link.end(LinkEnd.REPLACED)

    def _leave_graph(self, device: Device) -> None:
        touched, robot = device.names, self._robots.vanish(device)
        device.leave()
        member, device.member = device.member, None
        joined = self._robots.forget_candidate(device)
        if member is not None:
            joined.add(member.robot)
        if robot is not None and self._robots.has_candidate(robot.name):
            joined.add(robot.name)
        changed = self._regroup(joined)
        if robot is not None and robot not in changed:
            changed.append(robot)
        if changed or touched:
            self._robot_topics.update(changed, touched)

    def _regroup(self, names: Iterable[str]) -> list[LocalRobot]:
        """Find the parts of robots of several devices anew. Return these robots."""
        names = sorted(set(names))
        found = [self._robots.regroup(name) for name in names]
        for device in self._devices.values() if names else ():
            member = device.member
            if member is not None and member.is_waiting and member.robot in names and self._directory.is_free(member):
                self._shared.spawn(self._take_place(device, member), name=f"place of link {device.link.number}")
        return [robot for robot in found if robot is not None]

    async def _take_place(self, device: Device, member: Membership) -> None:
        """Let a device that waits take its place, if the one before has not come back when the robot has stopped."""
        await asyncio.sleep(SURE_S)
        while device.member is member and self._directory.is_free(member):
            if not self._robots.may_robot_move(member.robot):
                peer = printable(device.link.peer)
                log.warning("robot.device_replaced", robot=member.robot, device=printable(member.place), peer=peer)
                self._directory.offer(device.link.number)
                self._identify(device)
                return
            await asyncio.sleep(DECIDE_INTERVAL_S)


def _origin(link: Link) -> Origin:
    return Origin("", link.address, link.peer)


def commands_by_name(config: Config) -> dict[str, CommandSettings]:
    """Return what the settings say of robots' commands, by name of the robot."""
    return {name: command_settings(robot) for name, robot in config.robots.items()}


def addresses_of(config: Config) -> dict[str, str | None]:
    """Return the configured addresses of robots, by name."""
    return {name: robot.address for name, robot in config.robots.items()}


async def _silence(links: list[Link]) -> None:
    for link in links:
        link.session.stop()
        link.wake()
    for link in links:
        await link.drained()


def _log_refused_topic(_: Device, event: events.TopicRefused) -> None:
    log.warning("topic.refused", topic=printable(event.topic.name), reason=str(event.reason))


def _note_request(device: Device, event: events.TopicsRequested) -> None:
    device.presence.note_asked(asyncio.get_running_loop().time())
    log.debug("topics.requested", reason=event.reason)


def _note_answer(device: Device, event: events.TopicsAnswered) -> None:
    device.presence.note_answered(event.asked_at_s, device.link.received_at_s)


def _log_version(_: Device, event: events.VersionRefused) -> None:
    name = f"protocol.{event.version}"
    log.error(name, advice=event.advice)
