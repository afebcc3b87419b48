"""DeviceEvents: what the hub does about each event of a device's session."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import structlog

from hostlink.hub.device_calls import DeviceCalls
from hostlink.hub.diagnoses import Diagnoses
from hostlink.hub.gates import Gates
from hostlink.hub.identities import Identities
from hostlink.hub.parameters import ParameterAnswers
from hostlink.hub.robot_events import EventKind
from hostlink.hub.rosout import Rosout
from hostlink.link.link import Link
from hostlink.logs import printable
from hostlink.protocol import events

log = structlog.get_logger()


class Receivers(NamedTuple):
    """What of the hub receives events."""

    gates: Gates
    identities: Identities
    diagnoses: Diagnoses
    calls: DeviceCalls
    parameters: ParameterAnswers
    rosout: Rosout


class DeviceEvents:
    """One reaction for each kind of event; events of a link that was replaced are ignored."""

    def __init__(self, receivers: Receivers) -> None:
        self.late_answers = 0  # of services, that nobody waited for any more
        self._receivers = receivers
        self._devices = receivers.identities.devices
        self._reactions: dict[type[Any], Callable[[Link, Any], None]] = {
            events.TopicsNegotiated: self._announce,
            events.TopicRefused: _log_refused_topic,
            events.TopicsRequested: _log_request,
            events.ServiceRequested: receivers.calls.accept,
            events.ServiceResponded: self._pass_answer,
            events.ParameterRequested: self._answer_parameter,
            events.DeviceLogged: self._log_line,
            events.Protocol1Recognised: _log_protocol_1,
        }

    def react(self, link: Link, event: events.Event) -> None:
        """Do what an event of a live link means."""
        device = self._devices.get(link.number)
        if device is None:
            return
        if link.received_at_s != device.received_at_s:  # else more came in one read
            device.received_at_s = link.received_at_s
            self._receivers.identities.note_read(link)
        if not isinstance(event, events.MessageReceived):
            self._receivers.diagnoses.note(link, event)
            reaction = self._reactions.get(type(event))
            if reaction is not None:  # else the session has done all that there is to do
                reaction(link, event)
        elif device.is_undecided:
            self._receivers.identities.keep(device, event)
        elif not self._receivers.gates.is_closed:
            device.receive(event)

    def _announce(self, link: Link, event: events.TopicsNegotiated) -> None:
        log.info("topics.negotiated", count=len(event.topics), gap_at=event.gap_at, is_changed=event.is_changed)
        if event.is_changed:
            link.last_frame = b""  # its id may be another's now
            self._receivers.identities.announce(link, event.topics)
        else:
            self._devices[link.number].announced_again()

    def _log_line(self, link: Link, event: events.DeviceLogged) -> None:
        drivables = self._devices[link.number].drivables
        facts = {"link": link.number, "level": event.level, "text": event.text}
        self._receivers.gates.events.note(EventKind.LOGGED, drivables[0].name if drivables else "", **facts)
        self._receivers.rosout.log(link, event)

    def _answer_parameter(self, link: Link, event: events.ParameterRequested) -> None:
        device = self._devices[link.number]
        shown = device.shown.of(event.name)
        note = functools.partial(device.note_parameter, shown)
        self._receivers.parameters.answer(link, event.name, shown, note)

    def _pass_answer(self, link: Link, event: events.ServiceResponded) -> None:
        service = self._devices[link.number].services.get(event.service.name)
        if service is None or not service.answered(event.payload):
            self.late_answers += 1
            log.warning("service.late", service=printable(event.service.name))


def _log_refused_topic(_: Link, event: events.TopicRefused) -> None:
    log.warning("topic.refused", topic=printable(event.topic.name), reason=str(event.reason))


def _log_request(_: Link, event: events.TopicsRequested) -> None:
    log.debug("topics.requested", reason=event.reason)


def _log_protocol_1(_: Link, __: events.Protocol1Recognised) -> None:
    log.error(
        "protocol.version_1", advice="the device speaks rosserial of before 2013: rebuild it with a newer library"
    )
