"""LinkMonitor: gathers the evidence of one link. Pure: events, times and the session's counts are arguments."""

import math
import operator
import re
from array import array
from bisect import bisect_left
from collections.abc import Callable, Mapping

from hostlink.core.diagnosis.evidence import (
    RECENT_S,
    UNSHARED,
    Complaint,
    EarlierLink,
    Evidence,
)
from hostlink.core.diagnosis.motion_monitor import MotionMonitor
from hostlink.core.protocol import events
from hostlink.core.protocol.link_evidence import NO_COUNTS, Tally
from hostlink.core.protocol.session import DeviceSession
from hostlink.core.runtime.host_pauses import HostPauses
from hostlink.core.runtime.units import NS_PER_S

SAMPLE_INTERVAL_S = 1.0
MAX_SAMPLES = int(RECENT_S / SAMPLE_INTERVAL_S) + 1
_COUNTS = len(Tally._fields)
TOGETHER_S = 1.0  # time requests that arrive closer together have waited on their way
STAMPS_SAMPLES = 10  # DeviceClock accepts a step after 5 s, and a device sets its clock every 2.5 s
SILENT_S = 3.0  # shorter than QUIET_S of a negotiation; the samples are a second apart
REVIVALS_S = 60.0  # a board that restarts four times a minute has a fault
_MISSED = frozenset({"no_time_requests", "no_answer"})  # reasons of topic requests to a device that may have restarted
_KEPT = 16  # intervals and revivals: more add nothing
_ERROR = 3  # in LOG_LEVELS
_COMPLAINT = re.compile(  # log lines of firmware/due and hostlink sim; a group is the code of a finding
    r"(?:(?:left|right) wheel (?:(?P<wheel_stalled>stalled)|(?P<wheel_runaway>runs away))"
    r"|(?P<battery_low>battery low)|(?P<watchdog_restart>started by its watchdog))\b[ -~]{0,100}"
)
_SIGNAL = re.compile(r"WiFi signal (-\d{1,3}) dBm")  # firmware/esp8266
_FIRMWARE = re.compile(r"firmware ([\w.+-]{1,40} v?\d[\w.+-]{0,23})", re.ASCII)  # any device: docs/robot.md
SIGNAL_S = 150.0  # the line is sent once a minute, and when the signal has changed
_TOO_LARGE_TEXT = "larger than buffer"  # ros_lib: "Message from device dropped: message larger than buffer."


class _Samples:
    """Counts of the last RECENT_S, as rows of numbers: a Tally for each needs five times the memory.

    A row has the time, a Tally and the protocol's own counts.
    """

    __slots__ = ("_columns", "_rows")

    def __init__(self, at_s: float, tally: Tally, own: tuple[int, ...]) -> None:
        self._columns = 1 + _COUNTS + len(own)
        self._rows = array("d", (at_s, *tally, *own))

    def add(self, at_s: float, tally: Tally, own: tuple[int, ...]) -> None:
        """Add a sample, and drop the oldest above MAX_SAMPLES."""
        self._rows.extend((at_s, *tally, *own))
        del self._rows[: -MAX_SAMPLES * self._columns]

    @property
    def newest_s(self) -> float:
        """Time of the last sample."""
        return self._rows[-self._columns]

    def since(self, at_s: float) -> tuple[Tally, tuple[int, ...]]:
        """Return the first sample that is not older than `at_s`, or the last one of all."""
        times_s = self._rows[:: self._columns]
        row = min(bisect_left(times_s, at_s), len(times_s) - 1)
        counts = [*map(int, self._rows[row * self._columns + 1 : (row + 1) * self._columns])]
        return Tally(*counts[:_COUNTS]), tuple(counts[_COUNTS:])


def unknown_size(type_name: str) -> int:  # noqa: ARG001 - the signature of `least_bytes`
    """Return 0: no type is known."""
    return 0


class LinkMonitor:
    """Gatherer of one link's evidence.

    Observes every event but messages, and samples the counts each SAMPLE_INTERVAL_S.
    """

    __slots__ = (
        "_complaints", "_device_complaint", "_early_noise", "_excluded", "_fell_silent", "_intervals_s",
        "_is_fresh", "_is_provoked", "_least_bytes", "_negotiated_at_s", "_opened_at_s", "_own_excluded",
        "_previous_at_s", "_revived_at_s", "_samples",
        "_session", "_signal", "_stamps_behind_s", "_time_requested_at_s", "_unknown_before", "_was_host_away", "baud",
        "firmware", "motion", "sharing",
    )  # fmt: skip

    def __init__(
        self, session: DeviceSession, *, now_s: float, least_bytes: Callable[[str], int] = unknown_size
    ) -> None:
        """`least_bytes` returns the size of the smallest message of a type; 0 if the type is unknown."""
        self._least_bytes = least_bytes
        self.baud: int | None = None  # of a serial port
        self.motion = MotionMonitor()  # of the robot's odometry
        self.sharing = UNSHARED  # of a serial port
        self._session = session
        self._opened_at_s = now_s
        self._samples = _Samples(now_s, NO_COUNTS, session.own_counts)
        self._negotiated_at_s: float | None = None
        self._early_noise = b""
        self._unknown_before = 0  # unknown ids that the last negotiation explained
        self._is_provoked = False  # a device sends a time request with its topics
        self._is_fresh = False  # the last time request was read when it was sent
        self._excluded = NO_COUNTS  # losses while the host was paused
        self._own_excluded = (0,) * len(session.own_counts)  # the same of the protocol's own counts
        self._stamps_behind_s: list[float] = []
        self._fell_silent = False
        self._was_host_away = False  # since the last time request: a device without answers falls silent
        self._time_requested_at_s: float | None = None
        self._previous_at_s = -math.inf  # last time request, including provoked ones
        self._intervals_s: list[float] = []
        self._revived_at_s: list[float] = []
        self._device_complaint = ""
        self._complaints: dict[str, tuple[str, float]] = {}  # code -> last log line, and its time
        self._signal = (0, -math.inf)  # dBm, and time of the line
        self.firmware: str | None = None  # name and version, as the device logs them

    def set_baud(self, baud: int, now_s: float) -> None:
        """Note the baud rate at which the line is read. Earlier counts are dropped."""
        self.baud = baud
        self._samples = _Samples(now_s, self._total(), self._own())

    def observe(self, event: events.Event, now_s: float, *, has_waited: bool = False) -> None:
        """Note an event of the session. `has_waited`: it was read right after a pause of the host."""
        match event:
            case events.TopicsRequested(reason):
                self._is_provoked = True
                is_missed = reason in _MISSED and not self._was_host_away
                self._fell_silent |= is_missed and self._is_silent(now_s)
            case events.TimeRequested():
                self._note_time_request(now_s, has_waited=has_waited)
            case events.TopicsNegotiated():
                if self._negotiated_at_s is None and self._session.counts.unknown_ids:
                    # A running device: its first bytes were the middle of a frame, or had waited.
                    self._begin_anew(now_s)
                self._unknown_before = self._session.counts.unknown_ids
                if self._negotiated_at_s is None:
                    self._negotiated_at_s = now_s
                    if not self._excluded.skipped_bytes:
                        self._early_noise = self._session.foreign
            case events.DeviceLogged(_, text) if _TOO_LARGE_TEXT in text:
                self._device_complaint = text
            case events.DeviceLogged(level, text) if level == _ERROR and (found := _COMPLAINT.fullmatch(text)):
                self._complaints[str(found.lastgroup)] = text, now_s
            case events.DeviceLogged(_, text) if found := _SIGNAL.fullmatch(text):
                self._signal = int(found[1]), now_s
            case events.DeviceLogged(_, text) if found := _FIRMWARE.fullmatch(text):
                self.firmware = found[1]

    def sample(self, now_s: float) -> None:
        """Sample the counts. Recent counts are a difference to the samples."""
        if now_s >= self._samples.newest_s + SAMPLE_INTERVAL_S / 2:
            self._samples.add(now_s, self._total(), self._own())
            self.motion.sample(now_s)
            offset_ns = self._session.device_clock.offset_ns
            if offset_ns is not None:
                self._stamps_behind_s.append(offset_ns / NS_PER_S)
                del self._stamps_behind_s[:-STAMPS_SAMPLES]

    def exclude_waited(self) -> None:
        """Exclude the losses since the last sample, because the host was paused."""
        tally, own = self._samples.since(math.inf)
        self._exclude(since=tally)
        self._own_excluded = tuple(map(operator.sub, self._session.own_counts, own))  # then they are as they were
        self._was_host_away = True

    def _begin_anew(self, now_s: float) -> None:
        self._exclude(since=NO_COUNTS)
        self._samples = _Samples(now_s, self._total(), self._own())

    def _exclude(self, since: Tally) -> None:
        total, before = self._total(), self._excluded
        self._excluded = Tally(
            skipped_bytes=before.skipped_bytes + total.skipped_bytes - since.skipped_bytes,
            bad_checksums=before.bad_checksums + total.bad_checksums - since.bad_checksums,
            wrong_sizes=before.wrong_sizes + total.wrong_sizes - since.wrong_sizes,
        )
        self._stamps_behind_s.clear()
        self._fell_silent = False

    @property
    def sampled_at_s(self) -> float:
        """Time of the last sample."""
        return self._samples.newest_s

    @property
    def was_negotiated(self) -> bool:
        return self._negotiated_at_s is not None

    def signal_dbm(self, now_s: float) -> int | None:
        """Signal strength of the device's WiFi; None if the device does not report it."""
        dbm, at_s = self._signal
        return dbm if now_s < at_s + SIGNAL_S else None

    def evidence(
        self,
        now_s: float,
        *,
        silent_s: float,
        pauses: HostPauses | None = None,
        earlier: tuple[EarlierLink, ...] = (),
        end: str | None = None,
        host_clock: str = "",
        noted: Mapping[str, str] | None = None,
    ) -> Evidence:
        """Return the current evidence. The arguments are what the link itself cannot know.

        Times, including `silent_s`, do not count pauses of the host, when nothing was received.
        """
        host = HostPauses() if pauses is None else pauses
        session, total = self._session, self._total()
        before, own_before = self._samples.since(now_s - RECENT_S)
        recent = _difference(total, before)
        return Evidence(
            age_s=host.awake_s(self._opened_at_s, now_s),
            silent_s=silent_s,
            total=total,
            recent=recent,
            own=tuple(map(operator.sub, self._own(), own_before)),
            baud=self.baud,
            requests=session.counts.topic_requests,
            negotiated_s=_ago(self._negotiated_at_s, now_s, host),
            time_requested_s=_ago(self._time_requested_at_s, now_s, host),
            never_requests_time=self._previous_at_s == -math.inf,
            time_intervals_s=tuple(self._intervals_s),
            stamps_behind_s=self._stamps(),
            sharing=self.sharing,
            early_noise=self._early_noise,
            skipped=session.foreign[-recent.skipped_bytes :] if recent.skipped_bytes else b"",
            is_outdated=session.is_outdated,
            explain=session.explain,
            refused=tuple(f"{reason}" for _, reason in session.refusals),
            too_small=tuple(self._too_small()),
            complaints={code: Complaint(text, now_s - at_s) for code, (text, at_s) in self._complaints.items()},
            signal_dbm=self.signal_dbm(now_s),
            revivals=sum(at_s >= now_s - REVIVALS_S for at_s in self._revived_at_s),
            earlier=earlier,
            end=end,
            host_clock=host_clock,
            motion=self.motion.evidence(now_s),
            noted={} if noted is None else noted,
        )

    def _note_time_request(self, now_s: float, *, has_waited: bool) -> None:
        """Note a time request. An interval counts only from a request that was read when it was sent."""
        interval_s, self._previous_at_s = now_s - self._previous_at_s, now_s
        is_provoked, self._is_provoked = self._is_provoked, False
        are_together = interval_s < TOGETHER_S
        was_fresh, self._is_fresh = self._is_fresh, not (is_provoked or are_together or has_waited)
        was_host_away, self._was_host_away = self._was_host_away, self._was_host_away and has_waited
        if is_provoked:
            if was_host_away:  # without answers the device gave up; its requests start again with this one
                self._time_requested_at_s = now_s
            return
        if was_fresh and not are_together and not has_waited:
            self._intervals_s.append(interval_s)
            del self._intervals_s[:-_KEPT]
        if self._fell_silent and self._time_requested_at_s is not None:
            self._revived_at_s.append(now_s)
            del self._revived_at_s[:-_KEPT]
        self._fell_silent = False
        self._time_requested_at_s = now_s

    def _is_silent(self, now_s: float) -> bool:
        """Whether no byte arrived lately. A device may publish all the time, and request the time rarely or never."""
        before, _ = self._samples.since(now_s - SILENT_S)
        return before.bytes_from_device == self._session.counts.bytes_from_device

    def _stamps(self) -> float | None:
        """Smallest recent offset of the device's stamps. Messages that waited have older stamps for a while."""
        if len(self._stamps_behind_s) < STAMPS_SAMPLES:
            return None
        return min(self._stamps_behind_s, key=abs)

    def _total(self) -> Tally:
        """Counts since the link opened, without the losses during pauses of the host."""
        session = self._session
        counts = session.counts
        total = Tally(
            bytes_from_device=counts.bytes_from_device,
            frames=counts.frames_from_device,
            skipped_bytes=counts.skipped_bytes,
            unknown_ids=counts.unknown_ids - self._unknown_before,
            bad_checksums=session.bad_checksums,
            wrong_sizes=session.wrong_sizes,
        )
        return _difference(total, self._excluded)

    def _own(self) -> tuple[int, ...]:
        return tuple(map(operator.sub, self._session.own_counts, self._own_excluded))

    def _too_small(self) -> list[str]:
        """List what exceeds a buffer: by announced sizes, refused frames and the device's log."""
        found = (*self._session.too_small(self._least_bytes), self._session.too_large, self._device_complaint)
        return [text for text in found if text]


def _ago(at_s: float | None, now_s: float, host: HostPauses) -> float | None:
    return None if at_s is None else host.awake_s(at_s, now_s)


def _difference(now: Tally, before: Tally) -> Tally:
    return Tally(*map(operator.sub, now, before))._replace(unknown_ids=now.unknown_ids)
