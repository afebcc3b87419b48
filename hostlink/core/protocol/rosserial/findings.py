"""Rules of rosserial: what the counts of a link and the bytes outside frames show. Pure.

Each threshold names its source. Codes and texts are in hostlink/core/diagnosis/findings.toml.
"""

from collections.abc import Callable, Mapping
from statistics import median

from hostlink.core.protocol import line_speed
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.line_speed import LineSpeed
from hostlink.core.protocol.link_evidence import WENT_SILENT_S, LinkEvidence, explain_skipped
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode

TIME_REQUEST_S = 2.5  # docs/protocol.md#time: time request interval of a configured device
TIME_STOPPED_S = 3 * TIME_REQUEST_S + 0.5  # three missing time requests: a topic request may delay one
MIN_REQUESTS = 3  # at 0, 2 and 4 s: one answer may be lost, but not three
WRONG_SIZES = 3
UNKNOWN_IDS = 10  # more than arrive between two negotiations
UNKNOWN_AFTER_S = 5.0  # three topic requests were answered by then
CLOCK_ERROR = 0.04  # ceramic resonators are within 0.5 %, RC oscillators within 2 or 3 %
JITTER_S = 0.5  # a radio or a busy host may delay one request so much, and the next ones then seem early
FASTEST_RATE = 1.18  # of an oscillator that is not trimmed: 10 %, and some for its voltage and temperature
CRYSTAL_RATES = (4 / 3, 3 / 2, 2.0)  # a board of 16 or 12 MHz with a program for 12 or 8; 5/4 would be every 2 s
CRYSTAL_ERROR = 0.03  # of the interval, with a turn of the device's loop
CLOCK_INTERVALS = 3  # the median of three tolerates one outlier

_INFOS = (
    DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/odom", "nav_msgs/Odometry", "cd5e73d190d741a2f92e81eda573aca7", 512),
    DeviceEndpoint(
        EndpointKind.SUBSCRIBER, 100, "/cmd_vel", "geometry_msgs/Twist", "9f195f881246fdfa2798d1d3eebca84a", 512
    ),
    DeviceEndpoint(EndpointKind.PUBLISHER, 126, "/chatter", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", 512),
)
USUAL = b"".join(
    [
        *[encode(Id.TIME, bytes(8))] * 8,
        *(encode(info.kind, encode_topic_info(info)) for info in _INFOS),
        *(encode(125, bytes(4) + bytes([number * 37 & 0xFF, 0x3F]) * 10) for number in range(4)),
    ]
)


def explain(evidence: LinkEvidence) -> Mapping[str, str]:
    """Return what is wrong with a link of rosserial: details by the code of their finding."""
    details = {code: rule(evidence) for code, rule in _RULES.items()}
    found = {code: detail for code, detail in details.items() if detail is not None}
    if evidence.is_outdated:
        found["protocol_1"] = ""
    elif not evidence.is_shared:
        found |= explain_skipped(evidence, guess_speed)
    return found


def guess_speed(sample: bytes, baud: int | None) -> LineSpeed | None:
    """Guess the baud rate of a rosserial device from skipped bytes; None if they do not show it."""
    return line_speed.guess_speed(sample, baud, USUAL)


def _no_topics(evidence: LinkEvidence) -> str | None:
    frames = evidence.total.frames
    is_so = frames > 0 and evidence.negotiated_s is None and evidence.requests >= MIN_REQUESTS
    return f"{evidence.requests} topic requests, {frames} frames" if is_so else None


def _time_stopped(evidence: LinkEvidence) -> str | None:
    if evidence.negotiated_s is None or evidence.silent_s >= WENT_SILENT_S or evidence.never_requests_time:
        return None  # some libraries never request the time, as the one of MicroPython
    known = (evidence.negotiated_s, evidence.time_requested_s)
    waited_s = min(at_s for at_s in known if at_s is not None)
    return f"for {waited_s:.0f} s" if waited_s >= TIME_STOPPED_S else None


def _wrong_md5(evidence: LinkEvidence) -> str | None:
    return "; ".join(evidence.refused[:2]) if evidence.refused else None


def _wrong_size(evidence: LinkEvidence) -> str | None:
    count = evidence.recent.wrong_sizes
    return f"{count} frames" if count >= WRONG_SIZES else None


def _buffer_too_small(evidence: LinkEvidence) -> str | None:
    return "; ".join(evidence.too_small[:2]) if evidence.too_small else None


def _unknown_ids(evidence: LinkEvidence) -> str | None:
    count = evidence.recent.unknown_ids
    is_settled = evidence.negotiated_s is not None and evidence.negotiated_s >= UNKNOWN_AFTER_S
    return f"{count} frames" if is_settled and count >= UNKNOWN_IDS else None


def _fast_clock(evidence: LinkEvidence) -> str | None:
    if len(evidence.time_intervals_s) < CLOCK_INTERVALS:
        return None
    interval_s = median(evidence.time_intervals_s)
    early_s = TIME_REQUEST_S * len(evidence.time_intervals_s) - sum(evidence.time_intervals_s)
    is_fast = _is_fast(interval_s) and early_s >= JITTER_S  # a slow clock may be a slow loop
    return f"time requests every {interval_s:.2f} s instead of {TIME_REQUEST_S:g} s" if is_fast else None


def _is_fast(interval_s: float) -> bool:
    """Whether a clock that is fast explains the interval. Other libraries request the time in a rhythm of their own."""
    rate = TIME_REQUEST_S / interval_s
    is_inexact = 1 / (1 - CLOCK_ERROR) < rate <= FASTEST_RATE
    return is_inexact or any(abs(rate / crystal - 1) < CRYSTAL_ERROR for crystal in CRYSTAL_RATES)


_RULES: dict[str, Callable[[LinkEvidence], str | None]] = {
    "no_topics": _no_topics,
    "wrong_md5": _wrong_md5,
    "wrong_size": _wrong_size,
    "buffer_too_small": _buffer_too_small,
    "unknown_ids": _unknown_ids,
    "time_stopped": _time_stopped,
    "clock_trouble": _fast_clock,
}
