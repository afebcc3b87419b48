"""Links: the connections of all devices. Each is opened and served here, and leaves the graph at its end."""

import asyncio
import contextlib
import dataclasses
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import structlog
from structlog.contextvars import bound_contextvars

from hostlink.config import Config, LinkConfig, ParameterValue
from hostlink.hub.device import Device, check_type
from hostlink.hub.device_calls import DeviceCalls
from hostlink.hub.device_events import DeviceEvents, Receivers
from hostlink.hub.diagnoses import Diagnoses
from hostlink.hub.identities import Affected, Identities
from hostlink.hub.isolation import Spawn
from hostlink.hub.node import Node
from hostlink.hub.parameters import ParameterAnswers, ParameterSource
from hostlink.hub.participant import Parts
from hostlink.hub.robot import LocalRobot
from hostlink.hub.robot_events import EventKind
from hostlink.hub.rosout import Rosout
from hostlink.link.fair_share import FairShare, Turns
from hostlink.link.link import Authenticate, Link, LinkEnd, trust
from hostlink.logs import of_peer, printable
from hostlink.protocol.control import Parameter
from hostlink.protocol.session import Session
from hostlink.robot.directory import Directory, Places
from hostlink.transport.base import Transport

log = structlog.get_logger()

SILENCE_TIMEOUT_S = 0.5  # for what a device is sent before its link ends
END_S = 0.0005  # what it costs to take a device out of the graph


class Surroundings(NamedTuple):
    """What of the hub links use."""

    parts: Parts
    affected: Affected
    diagnoses: Diagnoses
    node: Node
    rosout: Rosout
    share: FairShare
    spawn: Spawn


class Links:
    """Opens, serves and ends the links, and answers what devices ask of the host: services, parameters, the time."""

    def __init__(self, around: Surroundings, config: Config, parameters: Mapping[str, ParameterValue]) -> None:
        """`parameters`: what devices request; they may change at any time."""
        self.parameter_source: ParameterSource | None = None  # of those that are not set here
        self.wall_ns: Callable[[], int] = time.time_ns  # the time that devices are given
        self._around, self._config, self._events = around, config, around.affected.gates.events
        self._devices = around.affected.robots.devices
        self._ends = Turns(around.share)
        self.calls = DeviceCalls(
            around.parts.services,
            around.parts.catalog,
            spawn=around.spawn,
            give_up=self._give_up,
            name_of=self._service_name,
            turns=Turns(around.share),
        )
        self._identities = Identities(around.affected, Directory(addresses_of(config)), spawn=around.spawn)
        self._device_events = DeviceEvents(
            Receivers(
                around.affected.gates,
                self._identities,
                around.diagnoses,
                self.calls,
                ParameterAnswers(parameters, lambda: self.parameter_source, around.spawn),
                around.rosout,
            )
        )

    def open(self, transport: Transport, link_config: LinkConfig | None = None) -> Link:
        """A link for one connection, to be served from now on."""
        config = self._config.link if link_config is None else link_config
        session = Session(
            check=lambda info: check_type(self._around.parts.catalog, info),
            uart_bytes_s=self._uart_bytes_s(transport, config),
            max_topics=config.max_topics,
            is_lossy=transport.kind == "udp",
        )
        link = Link(
            transport,
            session,
            config,
            number=self._around.affected.robots.new_number(),
            on_event=self._device_events.react,
            share=self._around.share,
            wall_ns=self._read_wall_ns,
            pauses=self._around.affected.gates.pauses,
        )
        diagnosis = self._around.diagnoses.begin(link)
        self._devices[link.number] = Device(link, diagnosis, self._around.parts, self._around.node)
        return link

    async def serve(self, link: Link, authenticate: Authenticate = trust) -> LinkEnd:
        """Serve an opened link to its end; rosserial begins when `authenticate` returns."""
        end = LinkEnd.CRASHED
        with bound_contextvars(link=link.number, peer=printable(link.peer), **of_peer(link.address)):
            log.info("link.opened")
            self._events.note(EventKind.LINK_OPENED, "", link=link.number, peer=link.peer)
            try:
                with self._around.parts.isolation.around("link"):  # a bug in one link must not stop another robot
                    end = await link.run(authenticate)
                    await self._ends.wait(END_S, is_flooding=True)  # a crowd that leaves at once leaves one by one
            except asyncio.CancelledError:
                end = LinkEnd.STOPPED
                raise
            finally:
                with self._around.parts.isolation.around("link"):
                    self._leave(link, end)
                self._events.note(EventKind.LINK_CLOSED, "", link=link.number, peer=link.peer, reason=end.value)
                facts = dataclasses.asdict(link.facts())
                log.info("link.closed", reason=end.value, **facts.pop("counts"), **facts)
        return end

    def _leave(self, link: Link, end: LinkEnd) -> None:
        self._identities.forget(link)
        self.calls.leave(link)
        self._around.diagnoses.finish(link, end)

    def all(self) -> list[Link]:
        """The live links, oldest first."""
        return [device.link for device in self._devices.values()]

    async def silence(self) -> None:
        """Request silence of every device; returns when each has been sent that."""
        await _silence(self.all())

    def end_all(self) -> None:
        """The daemon ends."""
        for link in self.all():
            link.end(LinkEnd.STOPPED)

    # -- who the devices are ------------------------------------------------------------------------------------------

    def shown_name(self, link: Link, name: str) -> str:
        """By which name the graph knows what a device names so."""
        device = self._devices.get(link.number)
        return name if device is None else device.shown.of(name)

    def answered_parameters(self, link: Link) -> Mapping[str, Parameter]:
        """What the device of a link was answered, by the shown names: it uses them until it requests them again."""
        device = self._devices.get(link.number)
        return {} if device is None else device.parameters

    def forget_robot(self, robot: LocalRobot) -> None:
        """It has been away for long."""
        self._identities.forget_robot(robot)

    def check(self, places: Places) -> None:
        """Whether `reconfigure` may follow.

        Raises:
            ReloadRefused: a robot that is driven or locked would have another name.
        """
        self._identities.check_places(places)

    def reconfigure(self, config: Config, places: Places) -> dict[str, str]:
        """Other names of robots from now on; returns the new names of those that are connected, by the old."""
        self._config = config
        return self._identities.reconfigure(places)

    # -- counts -------------------------------------------------------------------------------------------------------

    @property
    def undelivered(self) -> int:
        """Messages that were lost because it was not known in time which device sent them."""
        return self._identities.undelivered

    @property
    def late_answers(self) -> int:
        """Answers of devices' services that nobody waited for any more."""
        return self._device_events.late_answers

    def _read_wall_ns(self) -> int:
        return self.wall_ns()

    def _uart_bytes_s(self, transport: Transport, config: LinkConfig) -> int | None:
        here = (transport.peer, transport.address)
        rates = (robot.uart_bytes_s for robot in self._config.robots.values() if robot.address in here)
        return next((rate for rate in rates if rate is not None), config.uart_bytes_s)

    async def _give_up(self, link: Link) -> None:
        """End the link of a device that waits for an answer that does not fit it; it rests, and waits no more."""
        device = self._devices.get(link.number)
        self._around.affected.gates.stop_at_once([] if device is None else device.drivables)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(SILENCE_TIMEOUT_S):
                await _silence([link])
        link.end(LinkEnd.UNANSWERABLE)

    def _service_name(self, link: Link, name: str) -> str:
        """That of the robot's name here, if anybody provides it; else the name that all of its kind call."""
        shown = self.shown_name(link, name)
        return shown if self._around.parts.services.is_offered(shown) else name


async def _silence(links: list[Link]) -> None:
    for link in links:
        link.session.stop()
        link.wake()
    for link in links:
        await link.drained()


def addresses_of(config: Config) -> dict[str, str | None]:
    """Where its robots are configured to be, by their names."""
    return {name: robot.address for name, robot in config.robots.items()}
