"""Diagnoses: what is wrong with each link, live ones and the last that ended; kept for the API, logged."""

import asyncio
import concurrent.futures.thread  # noqa: F401 - asyncio imports it for its first thread; then no descriptor may be free
import dataclasses
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import structlog

from hostlink.core.diagnosis.arrivals import RECENT_S, Arrival, RefusedLately, connection_text, daemon_findings, newest
from hostlink.core.diagnosis.evidence import EarlierLink, Evidence, HostClock, PortSharing, port_finding
from hostlink.core.diagnosis.finding import Finding, finding, words
from hostlink.core.diagnosis.link_monitor import SAMPLE_INTERVAL_S, LinkMonitor
from hostlink.core.diagnosis.rules import diagnose
from hostlink.core.hub.isolation import Isolation
from hostlink.core.hub.robot_events import RobotEvents
from hostlink.core.link.capture_buffer import Captured
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.robot.events import EventKind
from hostlink.core.robot.model import Endpoint
from hostlink.core.robot.names import is_played
from hostlink.core.runtime.host_pauses import HostPauses
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.runtime.rate_limit import RateLimit

log = structlog.get_logger()

ENDED_LINKS = 16  # with their buffers 2 MiB at most
EARLIER_S = 60.0  # what ended before that explains nothing now
AWAY_S = 12.0  # a device that gets no answers for 11 s gives up, as docs/protocol.md#time has it
LOG_AGAIN_S = 60.0  # so that a device that reconnects every second does not fill the log
MAX_ANNOUNCED = 4  # last announcements with changed topics; they are needed to read a capture

Announced = tuple[DeviceEndpoint, ...]


@dataclass(slots=True, eq=False)
class Diagnosis:
    """Diagnosis of one link: its monitor and its findings."""

    link: Link
    monitor: LinkMonitor
    findings: list[Finding] = field(default_factory=list)
    end: LinkEnd | None = None
    ended_at_s: float = 0.0
    was_host_away: bool = False  # the host was paused shortly before the end, which the device did not cause
    last_evidence: Evidence | None = None  # of an ended link, until it is evaluated
    robot: str = ""  # name of the robot here; kept after the end
    own_name: str = ""  # announced name, if the robot's name got a number
    noted: dict[str, str] = field(default_factory=dict)  # codes and details that the hub knows
    is_played: bool = False  # a recording by its topics, not diagnosed: its bytes say nothing about a device
    _announced: list[tuple[int, Announced]] = field(default_factory=list)

    @property
    def baud(self) -> int | None:
        """Baud rate of the serial port; None for other transports."""
        return self.monitor.baud

    @property
    def seconds(self) -> float:
        """Duration of an ended link."""
        return self.ended_at_s - self.link.opened_at_s

    def captured(self, since: tuple[int, int] = (0, 0)) -> Captured:
        """Return the link's captured bytes, with times since its start."""
        found = self.link.captured(since)
        pieces = tuple(each._replace(time_s=each.time_s - self.link.opened_at_s) for each in found.pieces)
        return dataclasses.replace(found, pieces=pieces)

    def note_topics(self) -> None:
        """Note an announcement of topics, including refused ones."""
        session = self.link.session
        self.is_played = is_played([Endpoint(info.name, info.type, info.is_to_device) for info in session.topics])
        topics = session.topics + tuple(info for info, _ in session.refusals)  # the same object if none is refused
        if not self._announced or self._announced[-1][1] != topics:
            self._announced.append((session.counts.bytes_from_device, topics))
            del self._announced[:-MAX_ANNOUNCED]

    def announced_before(self, position: int) -> bytes:
        """Encode the last announcement within the first `position` bytes, or the first announcement if it was later."""
        before = [topics for at, topics in self._announced if at <= position]
        topics = before[-1] if before else next((topics for _, topics in self._announced), ())
        return self.link.session.announcement(topics)

    def is_same_device(self, other: "Diagnosis") -> bool:
        """Whether both links belong to one device: same address and robot, or same topics if it has no robot."""
        mine, its = (self.link.address, self.robot), (other.link.address, other.robot)
        return mine == its and (bool(self.robot) or self.topics == other.topics)

    @property
    def topics(self) -> Announced:
        """Topics of the last announcement, including refused ones."""
        return self._announced[-1][1] if self._announced else ()

    def renaming(self) -> str:
        """Return a text about a robot that was renamed because another device has its name; else empty."""
        return f"{self.own_name} is another device's name; this is {self.robot}" if self.own_name else ""


class Diagnoses:
    """Diagnoses of all links. `run` updates each of them once a second; the rest of the hub only passes events."""

    def __init__(
        self,
        isolation: Isolation,
        events: RobotEvents,
        pauses: Callable[[float], HostPauses],
        least_bytes: Callable[[str], int],
        slept_s: Callable[[], float],
        wall_ns: Callable[[], int],
    ) -> None:
        """`events` gets each new finding. `pauses` returns when the host itself did not run.

        `least_bytes` returns the size of the smallest message of a type; 0 if the type is unknown. `slept_s` returns
        for how long the computer has slept so far, `wall_ns` the time of day.
        """
        self._least_bytes, self._slept_s, self._wall_ns = least_bytes, slept_s, wall_ns
        self._isolation, self._events, self._pauses = isolation, events, pauses
        words()  # read now: later there may be no descriptor for it
        self.ended: deque[Diagnosis] = deque(maxlen=ENDED_LINKS)
        self._live: dict[int, Diagnosis] = {}
        self._clock = HostClock()
        self._host_clock = ""
        self._lines = RateLimit(1 / LOG_AGAIN_S, burst=1)  # of each address and code
        self.ports: dict[str, Finding] = {}  # serial ports that cannot be opened
        self.own: dict[str, Finding] = {}  # of the daemon's own parts, by their names
        self.refused = RefusedLately()

    def observe_port(self, name: str, error: OSError | None) -> None:
        """Note that a serial port was opened, or the error."""
        if error is None:
            self.ports.pop(name, None)
        else:
            self.ports[name] = port_finding(error)

    def observe_own(self, part: str, code: str = "", detail: str = "") -> None:
        """Note what is wrong with a part of the daemon, by the code of its finding; empty: nothing. News are logged."""
        known = self.own.pop(part, None)
        if code:
            found = self.own[part] = finding(code, detail)
            if known is None or known.code != code:
                log.warning("daemon.diagnosed", part=part, **dataclasses.asdict(found))

    def begin(self, link: Link) -> Diagnosis:
        """Create the diagnosis of a new link."""
        diagnosis = Diagnosis(link, LinkMonitor(link.session, now_s=link.opened_at_s, least_bytes=self._least_bytes))
        self._live[link.number] = diagnosis
        return diagnosis

    def observe_baud(self, link: Link, baud: int) -> None:
        """Note the baud rate at which the link's serial port is read from now on."""
        diagnosis = self._live.get(link.number)
        if diagnosis is not None:
            diagnosis.monitor.set_baud(baud, loop_time_s())

    def observe_sharing(
        self, link: Link, names: tuple[str, ...], *, has_login: bool, lost_reads: int, has_changed_settings: bool
    ) -> None:
        """Note the signs of other programs at the link's serial port: PortSharing has their meaning."""
        diagnosis = self._live.get(link.number)
        if diagnosis is not None:
            diagnosis.monitor.sharing = PortSharing(names, has_login, lost_reads, has_changed_settings)

    def note(self, diagnosis: Diagnosis, event: events.Event) -> None:
        """Note an event of a live link's session other than a message."""
        if isinstance(event, events.TopicsNegotiated):
            diagnosis.note_topics()
        now_s = loop_time_s()
        diagnosis.monitor.observe(event, now_s, has_waited=not self._pauses(now_s).has_recovered(now_s))

    def finish(self, link: Link, end: LinkEnd) -> None:
        """End a link's diagnosis. It is kept among the last ENDED_LINKS, with the link's buffers.

        Except that of a link that only found out which protocol its device speaks.
        """
        diagnosis = self._live.pop(link.number, None)
        is_guess = end is LinkEnd.OTHER_PROTOCOL and not link.session.counts.frames_from_device
        if diagnosis is not None and not is_guess:
            diagnosis.end, diagnosis.ended_at_s = end, loop_time_s()
            pauses = self._pauses(diagnosis.ended_at_s)
            diagnosis.was_host_away = pauses.was_paused(diagnosis.ended_at_s - AWAY_S)
            if pauses.was_paused(diagnosis.monitor.sampled_at_s):
                diagnosis.monitor.exclude_waited()
            diagnosis.last_evidence = self._evidence(diagnosis, diagnosis.ended_at_s)
            self.ended.append(diagnosis)

    def of(self, link: Link) -> list[Finding]:
        """Return the findings of a live link, as of the last update."""
        diagnosis = self._live.get(link.number)
        return [] if diagnosis is None else diagnosis.findings

    def find(self, number: int) -> Diagnosis | None:
        """Return the diagnosis of a live link, or of one of the last that ended."""
        ended = (diagnosis for diagnosis in self.ended if diagnosis.link.number == number)
        return self._live.get(number) or next(ended, None)

    def live(self) -> list[Diagnosis]:
        """Return the diagnoses of the live links, oldest first."""
        return list(self._live.values())

    def arrivals(self) -> list[Arrival]:
        """Return what came in the last minute and is not a robot, newest first."""
        now_s = loop_time_s()
        ended = [each for each in self.ended if now_s - each.ended_at_s < RECENT_S]
        links = [each for each in (*self._live.values(), *ended) if not each.robot]
        return newest((*self.refused.recent(now_s), *(_arrival(each, now_s) for each in links)))

    def daemon_findings(self, listening: str) -> list[Finding]:
        """Return the findings that belong to no link. `listening`: where the daemon listens, as a text."""
        now_s = loop_time_s()
        is_connected = bool(self._live) or any(now_s - each.ended_at_s < RECENT_S for each in self.ended)
        refused = self.refused.recent(now_s)
        ports, own = self.ports.values(), self.own.values()
        return daemon_findings(ports, refused, own, is_connected=is_connected, listening=listening)

    def numbers(self) -> list[int]:
        """Return the numbers of all links that have a diagnosis."""
        return sorted([*self._live, *(diagnosis.link.number for diagnosis in self.ended)])

    async def run(self) -> None:
        """Update every diagnosis once a second, until cancelled."""
        while True:
            now_s = loop_time_s()
            self._host_clock = self._clock.check(now_s + self._slept_s(), self._wall_ns())
            for diagnosis in list(self._live.values()):
                with self._isolation.around("diagnosis", link=diagnosis.link.number):
                    await self._observe(diagnosis)
                await asyncio.sleep(0)  # a thousand links are diagnosed one by one, between their messages
            for diagnosis in list(self.ended):
                if diagnosis.last_evidence is not None:
                    evidence, diagnosis.last_evidence = diagnosis.last_evidence, None
                    with self._isolation.around("diagnosis", link=diagnosis.link.number):
                        await self._evaluate(diagnosis, evidence)
            await asyncio.sleep(SAMPLE_INTERVAL_S)

    async def _observe(self, diagnosis: Diagnosis) -> None:
        """Update a live link's findings, unless this process was paused: late bytes would be blamed on the device.

        The findings are unchanged until the process has recovered.
        """
        now_s = loop_time_s()
        pauses = self._pauses(now_s)
        if not pauses.has_recovered(now_s):
            return
        if pauses.was_paused(diagnosis.monitor.sampled_at_s):
            diagnosis.monitor.exclude_waited()
        diagnosis.monitor.sample(now_s)
        await self._evaluate(diagnosis, self._evidence(diagnosis, now_s))

    async def _evaluate(self, diagnosis: Diagnosis, evidence: Evidence) -> None:
        """Evaluate evidence, in a thread if bytes must be examined: the first model of a baud rate is slow."""
        if diagnosis.is_played:
            diagnosis.findings = []
            return
        is_slow = evidence.recent.skipped_bytes > 0
        found = await asyncio.to_thread(diagnose, evidence) if is_slow else diagnose(evidence)
        news = {each.code for each in found} - {each.code for each in diagnosis.findings}
        diagnosis.findings = found
        for each in found:
            if each.code in news:
                self._announce(diagnosis, each)

    def _evidence(self, diagnosis: Diagnosis, now_s: float) -> Evidence:
        pauses = self._pauses(now_s)
        earlier = tuple(
            EarlierLink(
                end="" if other.end is None else other.end.value,
                seconds=other.seconds,
                was_negotiated=other.monitor.was_negotiated,
            )
            for other in self.ended
            if other.is_same_device(diagnosis) and not other.was_host_away and now_s - other.ended_at_s < EARLIER_S
        )
        return diagnosis.monitor.evidence(
            now_s,
            silent_s=pauses.awake_s(diagnosis.link.received_at_s, now_s),
            pauses=pauses,
            earlier=earlier,
            end=None if diagnosis.end is None else diagnosis.end.value,
            host_clock=self._host_clock,
            noted={"flashed_alike": diagnosis.renaming(), **diagnosis.noted},
        )

    def _announce(self, diagnosis: Diagnosis, found: Finding) -> None:
        """Note a new finding as an event. Log it once in LOG_AGAIN_S for each address."""
        link, facts = diagnosis.link, dataclasses.asdict(found)
        self._events.note(EventKind.DIAGNOSED, diagnosis.robot, link=link.number, **facts)
        if self._lines.allows((link.address, found.code), loop_time_s()):
            facts["detail"] = printable(found.detail)
            log.warning("link.diagnosed", link=link.number, peer=printable(link.peer), **facts)


def _arrival(diagnosis: Diagnosis, now_s: float) -> Arrival:
    link, end = diagnosis.link, None if diagnosis.end is None else diagnosis.end.value
    counts = link.session.counts
    text = connection_text(counts.bytes_from_device, counts.frames_from_device, len(diagnosis.topics), end)
    at_s = link.received_at_s if end is None else diagnosis.ended_at_s
    findings = tuple(diagnosis.findings)
    return Arrival(link.kind, link.address, end or "connected", text, now_s - at_s, findings=findings)
