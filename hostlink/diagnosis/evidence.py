"""HostClock: whether this computer's own clock can be trusted for stamps. Pure: both times come in."""

import errno
from dataclasses import dataclass
from typing import NamedTuple

from hostlink.diagnosis.finding import Finding, finding

# -- host clock -------------------------------------------------------------------------------------------------------

MIN_WALL_NS = (
    1_735_689_600_000_000_000  # 2025: hostlink did not exist before; a computer without a battery is there at boot
)
STEP_S = 0.5  # NTP slews what is less (128 ms) and steps what is more
REMEMBERED_S = 30.0  # as long as any evidence
_NS_PER_S = 1_000_000_000


class HostClock:
    """Compares the wall clock with the monotonic one at each check."""

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._step_s = 0.0
        self._stepped_at_s = float("-inf")

    def check(self, now_s: float, wall_ns: int) -> str:
        """What is wrong with the clock; empty where nothing is."""
        offset_s = wall_ns / _NS_PER_S - now_s
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
    errno.ENOENT: "serial_missing",
    errno.ENODEV: "serial_missing",
    errno.ENXIO: "serial_missing",
    errno.EBUSY: "serial_busy",
    errno.EAGAIN: "serial_busy",
}


def port_finding(error: OSError) -> Finding:
    """The error's number gives the code, its text the detail."""
    return finding(_CODES.get(error.errno or 0, "serial_unusable"), error.strerror or str(error))


# -- evidence ---------------------------------------------------------------------------------------------------------

RECENT_S = 30.0  # twelve of a device's time requests: trouble that is older is over


class EarlierLink(NamedTuple):
    """A link of the same address that has ended."""

    end: str
    seconds: float
    was_negotiated: bool


class Complaint(NamedTuple):
    """The last line of a device's log about a fault of its own."""

    text: str
    ago_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Tally:
    """Counts over some time; `Evidence` has one since the link opened, and one of the last RECENT_S."""

    bytes_from_device: int = 0
    frames: int = 0
    skipped_bytes: int = 0
    unknown_ids: int = 0  # since the last negotiation, which explained those before
    bad_checksums: int = 0
    wrong_sizes: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """Times are in seconds before the moment of the evidence; None where a thing has not happened."""

    age_s: float
    silent_s: float
    total: Tally = Tally()
    recent: Tally = Tally()
    baud: int | None = None  # of a serial port; None behind TCP
    requests: int = 0  # requests for topics
    negotiated_s: float | None = None  # since the first negotiation
    time_requested_s: float | None = None  # since the last request for the time that the host did not provoke
    time_intervals_s: tuple[float, ...] = ()  # between requests for the time, none of them provoked
    stamps_behind_s: float | None = None  # what the device's header stamps lack to the time of their arrival
    early_non_rosserial: bytes = b""  # what was skipped before the first negotiation, the last of it
    non_rosserial: bytes = b""  # what was skipped recently
    is_protocol_1: bool = False
    refused: tuple[str, ...] = ()  # why topics were refused, a text each
    too_small: tuple[str, ...] = ()  # what does not fit a buffer, a text each
    wheel_stalled: Complaint | None = None
    wheel_runaway: Complaint | None = None
    battery_low: Complaint | None = None
    watchdog_restart: Complaint | None = None
    signal_dbm: int | None = None  # of the WiFi, where the passthrough reports it
    revivals: int = 0  # recently: it fell silent, and announced its topics when they were requested
    earlier: tuple[EarlierLink, ...] = ()
    end: str | None = None  # why the link is no more
    host_clock: str = ""  # what is wrong with this computer's clock
    numbered: str = ""  # the robot's name has a number, because another device has the same
