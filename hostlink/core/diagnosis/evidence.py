"""Evidence of a link, of its serial port and of the host's own clock. Pure; both times are arguments."""

import errno
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from hostlink.core.diagnosis.finding import Finding, finding
from hostlink.core.diagnosis.motion_monitor import NO_MOTION, MotionEvidence
from hostlink.core.protocol.link_evidence import NO_COUNTS, Explain, LinkEvidence, Tally, explain_unreadable
from hostlink.core.runtime.units import NS_PER_S

# -- host clock -------------------------------------------------------------------------------------------------------

MIN_WALL_NS = (
    # 2025, before the first hostlink; a computer without a clock battery boots with an earlier time.
    1_735_689_600_000_000_000
)
STEP_S = 0.5  # NTP slews smaller offsets (128 ms) and steps larger ones
REMEMBERED_S = 30.0  # at least as long as any evidence

RECENT_S = 30.0  # twelve time requests of a device: older trouble is over


class HostClock:
    """Detector of steps of the host's wall clock, by comparison with the monotonic clock."""

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._step_s = 0.0
        self._stepped_at_s = float("-inf")

    def check(self, now_s: float, wall_ns: int) -> str:
        """Return what is wrong with the clock; empty if it is right."""
        offset_s = wall_ns / NS_PER_S - now_s
        if self._offset_s is not None and abs(offset_s - self._offset_s) > STEP_S:
            self._step_s, self._stepped_at_s = offset_s - self._offset_s, now_s
        self._offset_s = offset_s
        if wall_ns < MIN_WALL_NS:
            return "its clock is not set"
        if now_s - self._stepped_at_s < REMEMBERED_S:
            return f"its clock was set by {self._step_s:+.1f} s"
        return ""


# -- ports ------------------------------------------------------------------------------------------------------------

_CODES = {
    errno.EACCES: "serial_permission",
    errno.EPERM: "serial_permission",
    errno.ENOTUNIQ: "serial_ambiguous",
    errno.ENOENT: "serial_missing",
    errno.ENODEV: "serial_missing",
    errno.ENXIO: "serial_missing",
    errno.EBUSY: "serial_busy",
    errno.EAGAIN: "serial_busy",
}


def port_finding(error: OSError) -> Finding:
    """Build the finding of a port error: its number gives the code, its text the detail."""
    return finding(_CODES.get(error.errno or 0, "serial_unusable"), error.strerror or str(error))


class PortSharing(NamedTuple):
    """Signs of another program at the link's serial port."""

    names: tuple[str, ...] = ()  # programs that have the port open
    has_login: bool = False  # the port is the terminal of one of them, or the kernel's console
    lost_reads: int = 0  # lately another program read what had come for the host
    has_changed_settings: bool = False  # lately another program changed the port's settings


UNSHARED = PortSharing()


# -- evidence ---------------------------------------------------------------------------------------------------------


class EarlierLink(NamedTuple):
    """Ended link of the same address."""

    end: str
    seconds: float
    was_negotiated: bool


class Complaint(NamedTuple):
    """Last line of a device's log about one of its own faults."""

    text: str
    ago_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Evidence of one link.

    Times are in seconds before the moment of the evidence; None if something did not happen.
    """

    age_s: float
    silent_s: float
    total: Tally = NO_COUNTS
    recent: Tally = NO_COUNTS
    own: tuple[int, ...] = ()  # counts of the protocol alone, of the last RECENT_S
    baud: int | None = None  # of a serial port; None for TCP
    requests: int = 0  # number of topic requests
    negotiated_s: float | None = None  # since the first negotiation
    time_requested_s: float | None = None  # since the last time request that the host did not provoke
    never_requests_time: bool = False  # not even with its topics
    time_intervals_s: tuple[float, ...] = ()  # between unprovoked time requests
    stamps_behind_s: float | None = None  # arrival time minus the device's header stamps
    sharing: PortSharing = UNSHARED  # of a serial port
    early_noise: bytes = b""  # last bytes skipped before the first negotiation
    skipped: bytes = b""  # recently skipped bytes
    is_outdated: bool = False  # it speaks an older version of its protocol
    explain: Explain = explain_unreadable  # the rules of the device's protocol
    refused: tuple[str, ...] = ()  # reasons of refused topics, one text each
    too_small: tuple[str, ...] = ()  # messages that exceed a buffer, one text each
    complaints: Mapping[str, Complaint] = field(default_factory=dict)  # by the code of their finding
    signal_dbm: int | None = None  # of the WiFi, if the passthrough reports it
    revivals: int = 0  # recent times that the device fell silent and announced its topics on request
    earlier: tuple[EarlierLink, ...] = ()
    end: str | None = None  # reason of the link's end
    host_clock: str = ""  # what is wrong with this computer's clock
    motion: MotionEvidence = NO_MOTION  # of the messages that tell how the robot moves
    noted: Mapping[str, str] = field(default_factory=dict)  # what only the hub knows: details by code of their finding

    def of_link(self, *, is_shared: bool) -> LinkEvidence:
        """Return what the protocol's rules judge. `is_shared`: another program is at the serial port."""
        return LinkEvidence(
            age_s=self.age_s,
            silent_s=self.silent_s,
            total=self.total,
            recent=self.recent,
            own=self.own,
            baud=self.baud,
            requests=self.requests,
            negotiated_s=self.negotiated_s,
            time_requested_s=self.time_requested_s,
            never_requests_time=self.never_requests_time,
            time_intervals_s=self.time_intervals_s,
            sample=self.skipped,
            early=self.early_noise,
            is_outdated=self.is_outdated,
            is_shared=is_shared,
            refused=self.refused,
            too_small=self.too_small,
        )
