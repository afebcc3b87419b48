"""Devices: connected devices and their connections as values, for components: views, findings, captures."""

import dataclasses
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, NamedTuple, cast

from hostlink.core.diagnosis.finding import Finding
from hostlink.core.hub.device import Device
from hostlink.core.link.capture_buffer import CapturedPiece
from hostlink.core.robot.command_endpoint import command_endpoint_view
from hostlink.core.robot.device_views import (
    ArrivalView,
    DevicesView,
    DeviceView,
    FindingView,
    LinkView,
    OtherLinksView,
    TopicInfoView,
)
from hostlink.core.robot.model import Role, roles
from hostlink.core.robot.state_views import rounded
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import UnknownTopic

if TYPE_CHECKING:
    from hostlink.core.hub.hub import Hub


class Capture(NamedTuple):
    """Raw bytes that passed on a connection after a position, in order of time. Times are since its start."""

    number: int  # of the connection
    protocol: str  # which the device speaks, as `find_protocol` finds it
    pieces: tuple[CapturedPiece, ...]
    position: tuple[int, int]  # bytes from the device and to it at the end of the capture
    lost: tuple[int, int]  # bytes after the requested position that are no longer kept
    announced: bytes  # the announcement that the device had sent before, if the beginning is lost; else empty
    seconds: float | None  # duration of a connection that has ended; None: it is open


class Devices:
    """Connected devices, and the last connections that ended. All that is returned is a copy."""

    def __init__(self, hub: "Hub") -> None:
        self._robots, self._links, self._diagnoses = hub.robots, hub.links, hub.diagnoses
        self._isolation, self._refused = hub.isolation, hub.counts.refused

    def links(self) -> Iterator[LinkView]:
        """Yield every live connection. Each view is made when it is asked for, so that the work can be spread."""
        devices = self._robots.devices
        return (link_view(each) for each in list(devices.values()) if each.link.number in devices)  # one may end

    def other_links(self) -> OtherLinksView:
        """Return the last connections that ended, and what could not connect."""
        now_s = loop_time_s()
        return {
            "ended": [
                {
                    "number": diagnosis.link.number,
                    "protocol": diagnosis.link.session.protocol,
                    "peer": diagnosis.link.peer,
                    "robot": diagnosis.robot or None,
                    "end": "" if diagnosis.end is None else diagnosis.end.value,
                    "seconds": round(diagnosis.seconds, 3),
                    "ended_ago_s": round(now_s - diagnosis.ended_at_s, 3),
                    "diagnosis": finding_views(diagnosis.findings),
                }
                for diagnosis in reversed(self._diagnoses.ended)
            ],
            "ports": [
                {"name": name, "diagnosis": finding_views([each])} for name, each in self._diagnoses.ports.items()
            ],
            "crashes": self._isolation.crashes.total(),
            "refused": dict(self._refused),
        }

    def all(self) -> DevicesView:
        """Return every connected device that has announced topics, also if all of them were refused."""
        found = self._robots.devices.values()
        devices = [self._view(each) for each in found if each.infos or each.link.session.refusals]
        return {"devices": devices, "lock_reason": self._robots.boards.lock_reason}

    def arrivals(self) -> list[ArrivalView]:
        """Return what came in the last minute and is not a robot, newest first."""
        return [
            {
                "way": each.way,
                "peer": each.peer,
                "cause": each.cause,
                "text": each.text,
                "count": each.count,
                "ago_s": round(each.ago_s, 1),
                "diagnosis": finding_views(each.findings),
            }
            for each in self._diagnoses.arrivals()
        ]

    def findings(self, listening: str) -> list[FindingView]:
        """Return the findings that belong to no connection. `listening`: where the daemon listens, as a text."""
        return finding_views(self._diagnoses.daemon_findings(listening))

    def capture(self, number: int | None, since: tuple[int, int] = (0, 0), *, shown: str = "") -> Capture:
        """Return the bytes on a connection after the first `since` from the device and to it, as far as they are kept.

        `shown`: the number as it was asked for, for the error.

        Raises:
            UnknownTopic: no live connection has this number, and none of the last that ended.
        """
        found = None if number is None else self._diagnoses.find(number)
        if found is None:
            known = tuple(str(each) for each in self._diagnoses.numbers())
            raise UnknownTopic("link", shown or str(number), known)
        captured, link = found.captured(since), found.link
        return Capture(
            link.number,
            link.session.captured_as,
            captured.pieces,
            captured.position,
            captured.lost,
            found.announced_before(captured.lost[0]) if since == (0, 0) and captured.lost[0] else b"",
            None if found.end is None else found.seconds,
        )

    def _view(self, device: Device) -> DeviceView:
        """Return whether one device is a robot, and why."""
        robot, link, shown = device.robot, device.link, device.shown
        commands = () if robot is None else [topic.name for topic in robot.topics.commands]
        feedback = [name for name, _ in device.read_topics]
        found = roles(device.endpoints, device.settings, commands=commands, guarded=device.guarded, feedback=feedback)
        name_from, settings = self._links.origin_of(device)
        return {
            "link": link.number,
            "peer": link.peer,
            "protocol": link.session.protocol,
            "robot": None if robot is None else robot.name,
            "part_of": None if device.member is None else device.member.robot,
            "is_spatial": device.settings.is_spatial,
            "name_from": name_from,
            "settings": settings,
            "refused": device.refused,
            "feedback": "none" if robot is None else robot.feedback.kind.value,
            "lacks": "" if robot is None else robot.feedback.lacks,
            "topics": [
                {"name": shown.of(endpoint.name), "type": endpoint.type_name, "role": role.value}
                for endpoint, role in found
                if role is not Role.DATA
            ],
            "refused_topics": [
                {"name": info.name, "type": info.type, "reason": str(reason)} for info, reason in link.session.refusals
            ],
            "unguarded": [command_endpoint_view(each) for each in device.unguarded_endpoints()],
            "suggestion": device.suggestion,
        }


def link_view(device: Device) -> LinkView:
    """Return the present state of one live connection."""
    link, diagnosis = device.link, device.diagnosis
    facts = link.facts()
    clock = facts.clock
    view = {
        "number": link.number,
        "transport": link.kind,
        "protocol": link.session.protocol,
        "peer": link.peer,
        "robot": diagnosis.robot or None,
        "silent_s": round(link.silent_s, 3),
        "diagnosis": finding_views(diagnosis.findings),
        "topics": topic_info_views(device),
        "parameters": {
            name: [*answer.ints, *answer.floats, *answer.strings] for name, answer in device.parameters.items()
        },
        "seconds": round(facts.seconds, 3),
        **dataclasses.asdict(facts.counts),
        "replaced": facts.replaced,
        "rejected": facts.rejected,
        "slowest_wait_s": round(facts.slowest_wait_s, 6),
        "oldest_waiting_s": round(facts.oldest_waiting_s, 6),
        "signal_dbm": diagnosis.monitor.signal_dbm(link.opened_at_s + facts.seconds),
        "clock": None
        if clock is None
        else {
            "offset_s": rounded(clock.offset_s, 6),
            "drift_ppm": rounded(clock.drift_ppm, 1),
            "round_trip_s": rounded(clock.round_trip_s, 6),
            "answer_s": rounded(clock.answer_s, 6),
        },
    }
    return cast(LinkView, view)


def topic_info_views(device: Device) -> list[TopicInfoView]:
    """Return the topics of one device, under the graph's names and the device's own."""
    return [
        {
            "kind": info.kind.name.lower(),
            "id": info.id,
            "name": device.shown.of(info.name),
            "own_name": info.name,
            "type": info.type,
            "md5": info.md5,
            "buffer_bytes": info.buffer_bytes,
        }
        for info in device.link.topics
    ]


def finding_views(findings: Iterable[Finding]) -> list[FindingView]:
    """Return findings in the words of the log and of the documents."""
    return [
        {"code": each.code, "cause": each.cause, "next_step": each.next_step, "detail": each.detail}
        for each in findings
    ]
