"""Evidence: what is known of one link at one moment. Rules read it, a LinkMonitor gathers it."""

from dataclasses import dataclass
from typing import NamedTuple

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
