"""Arrivals: what reached the daemon in the last minute and is not a robot; findings of the daemon. Pure."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from hostlink.core.diagnosis.finding import Finding, finding
from hostlink.core.protocol.link_evidence import explain_unknown

RECENT_S = 60.0
MAX_ARRIVALS = 16  # kept and shown; the oldest are dropped

NOT_ROSSERIAL, NOT_MICRO_ROS = "not_rosserial", "not_micro_ros"
OTHER_SESSION, UNVERIFIED = "other_session", "unverified"
_OF_NO_REFUSED_DEVICE = {NOT_ROSSERIAL, NOT_MICRO_ROS, OTHER_SESSION}  # of programs, or a finding of their own
_MAX_NAMES = 3  # addresses in one text
_MIN_UNSENT = 3  # a device that sends little while it introduces itself sends more later
REFUSALS = {  # causes of docs/service.md, for people
    "not_allowed": "refused: its address is not in the allowed networks (tcp.allow, udp.allow)",
    "too_many_of_address": "refused: this address has too many connections",
    "too_many": "refused: there are too many connections",
    "evicted": "disconnected to make room: it had announced no topics",
    "too_many_robots": "refused: too many robots are known",
    "no_key": "refused: it did not prove the key",
    "wrong_key": "refused: it has another key",
    "too_fast": "refused: too many new UDP sessions in a second",
    UNVERIFIED: "answered less than it needs: its UDP address is not verified",
    "no_descriptor": "refused: no file descriptor is free",
    "unreachable": "refused: the network reports an error",
    NOT_ROSSERIAL: "sent UDP datagrams that are not rosserial",
    NOT_MICRO_ROS: "sent UDP datagrams that are not micro-ROS",
    OTHER_SESSION: "sent messages of a session with another host, such as the micro-ROS agent: reset the board",
}


@dataclass(frozen=True, slots=True)
class Arrival:
    """Arrivals of one address with one cause, `count` times. `way`: tcp, udp or serial."""

    way: str
    peer: str
    cause: str
    text: str
    ago_s: float
    count: int = 1
    findings: tuple[Finding, ...] = ()
    seconds: float = 0.0  # from the first to the last


class RefusedLately:
    """Refused peers of the last minute: by way, address and cause, at most MAX_ARRIVALS."""

    def __init__(self) -> None:
        # Count, and times of the first and of the last; oldest first.
        self._times_s: dict[tuple[str, str, str], tuple[int, float, float]] = {}

    def note(self, way: str, peer: str, cause: str, now_s: float) -> None:
        """Note a refusal. `peer` is an address without a port."""
        key = (way, peer, cause)
        count, first_s, last_s = self._times_s.pop(key, (0, now_s, now_s))
        is_recent = now_s - last_s < RECENT_S
        self._times_s[key] = (count + 1, first_s, now_s) if is_recent else (1, now_s, now_s)
        if len(self._times_s) > MAX_ARRIVALS:
            del self._times_s[next(iter(self._times_s))]

    def note_session(self, way: str, peer: str, now_s: float) -> None:
        """Note a message of a device that is in a session with another host."""
        self.note(way, peer, OTHER_SESSION, now_s)

    def forget_session(self, way: str, peer: str) -> None:
        """Forget that a device of this address was in another session: it begins one here."""
        self._times_s.pop((way, peer, OTHER_SESSION), None)

    def recent(self, now_s: float) -> list[Arrival]:
        """Return the refusals of the last minute."""
        return [
            Arrival(
                way, peer, cause, REFUSALS.get(cause, f"refused: {cause}"), now_s - at_s, count, seconds=at_s - first_s
            )
            for (way, peer, cause), (count, first_s, at_s) in self._times_s.items()
            if now_s - at_s < RECENT_S
        ]


def connection_text(received_bytes: int, frames: int, topics: int, end: str | None) -> str:
    """Describe a connection that is not a robot. `end` is None while it is open."""
    if topics:
        what = f"announces {topics} topics, but no velocity and no odometry of a robot"
    elif frames:
        what = f"sent {frames} frames and announced no topics"
    elif received_bytes:
        what = f"sent {received_bytes} bytes without a frame"
    else:
        what = "sent nothing"
    return f"connected, {what}" if end is None else f"{what}; the connection ended: {end.replace('_', ' ')}"


def newest(arrivals: Iterable[Arrival]) -> list[Arrival]:
    """Return the newest MAX_ARRIVALS. Connections of one address with the same end and findings are one."""
    grouped: dict[tuple[object, ...], Arrival] = {}
    for arrival in sorted(arrivals, key=lambda each: each.ago_s):
        key = (arrival.way, arrival.peer, arrival.cause, tuple(each.code for each in arrival.findings))
        known = grouped.get(key)
        grouped[key] = arrival if known is None else replace(known, count=known.count + arrival.count)
    return list(grouped.values())[:MAX_ARRIVALS]


def daemon_findings(
    ports: Iterable[Finding],
    refused: Sequence[Arrival],
    own: Iterable[Finding] = (),
    *,
    is_connected: bool,
    listening: str,
) -> list[Finding]:
    """Return the findings that belong to no link.

    `ports`: of serial ports that cannot be opened. `refused`: of the last minute. `own`: of the daemon's own parts.
    `is_connected`: whether a device is connected or was in the last minute. `listening`: where the daemon listens.
    """
    devices = [*ports, *_other_sessions(refused), *_unverified(refused)]
    if not devices and not is_connected:
        devices = [_no_device(refused, listening)]
    return [*devices, *own]


def _other_sessions(refused: Sequence[Arrival]) -> list[Finding]:
    """Return the finding of devices in a session that was not begun here, as the rule of a link has it."""
    sessions = [each for each in refused if each.cause == OTHER_SESSION]
    return _named(
        "session_unknown",
        [f"{each.peer}: {text}" for each in sessions if (text := explain_unknown(each.count, each.seconds))],
    )


def _unverified(refused: Sequence[Arrival]) -> list[Finding]:
    """Return the finding of devices that are sent less than they need, because they send little themselves."""
    limited = [each for each in refused if each.cause == UNVERIFIED and each.count >= _MIN_UNSENT]
    return _named("address_unverified", [f"{each.peer}: {each.count} times" for each in limited])


def _named(code: str, details: list[str]) -> list[Finding]:
    """Return a finding that names the first few addresses; nothing if there are none."""
    more = len(details) - _MAX_NAMES
    text = "; ".join([*details[:_MAX_NAMES], *([f"and {more} more"] if more > 0 else [])])
    return [finding(code, text)] if text else []


def _no_device(refused: Sequence[Arrival], listening: str) -> Finding:
    counts: Counter[str] = Counter()
    for each in refused:
        if each.cause not in _OF_NO_REFUSED_DEVICE:
            counts[each.cause] += each.count
    if not counts:
        return finding("no_device", listening)
    return finding("not_let_in", ", ".join(f"{cause} {count}" for cause, count in counts.items()))
