"""Evidence of a link, of its serial port and of the host's own clock. Pure; both times are arguments."""

import errno
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from hostlink.core.diagnosis.finding import Finding, finding
from hostlink.core.diagnosis.motion_monitor import NO_MOTION, MotionEvidence
from hostlink.core.protocol.noise import Noise, explain_unreadable
from hostlink.core.runtime.units import NS_PER_S

# -- host clock -------------------------------------------------------------------------------------------------------

MIN_WALL_NS = (
    # 2025, before the first hostlink; a computer without a clock battery boots with an earlier time.
    1_735_689_600_000_000_000
)
STEP_S = 0.5  # NTP slews smaller offsets (128 ms) and steps larger ones
REMEMBERED_S = 30.0  # at least as long as any evidence


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

RECENT_S = 30.0  # twelve time requests of a device: older trouble is over


class EarlierLink(NamedTuple):
    """Ended link of the same address."""

    end: str
    seconds: float
    was_negotiated: bool


class Complaint(NamedTuple):
    """Last line of a device's log about one of its own faults."""

    text: str
    ago_s: float


class Tally(NamedTuple):
    """Counts over some time. `Evidence` has one since the link opened and one of the last RECENT_S."""

    bytes_from_device: int = 0
    frames: int = 0
    skipped_bytes: int = 0
    unknown_ids: int = 0  # since the last negotiation, which explained the earlier ones
    bad_checksums: int = 0
    wrong_sizes: int = 0


NO_COUNTS = Tally()


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Evidence of one link.

    Times are in seconds before the moment of the evidence; None if something did not happen.
    """

    age_s: float
    silent_s: float
    total: Tally = NO_COUNTS
    recent: Tally = NO_COUNTS
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
    explain_noise: Callable[[Noise], tuple[str, str] | None] = explain_unreadable  # of the device's protocol
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

    @property
    def noise(self) -> Noise:
        """The bytes that are not of the device's protocol."""
        return Noise(
            age_s=self.age_s,
            is_negotiated=self.negotiated_s is not None,
            received_bytes=self.recent.bytes_from_device,
            skipped_bytes=self.recent.skipped_bytes,
            frames=self.recent.frames,
            bad_checksums=self.recent.bad_checksums,
            all_skipped_bytes=self.total.skipped_bytes,
            sample=self.skipped,
            early=self.early_noise,
            baud=self.baud,
            is_outdated=self.is_outdated,
        )
