"""Arrivals: what reached the daemon in the last minute and is not a robot; findings of the daemon. Pure."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from hostlink.core.diagnosis.finding import Finding, finding

RECENT_S = 60.0
MAX_ARRIVALS = 16  # kept and shown; the oldest are dropped

NOT_ROSSERIAL, NOT_MICRO_ROS = "not_rosserial", "not_micro_ros"
REFUSALS = {  # causes of docs/service.md, for people
    "not_allowed": "refused: its address is not in the allowed networks (tcp.allow, udp.allow)",
    "too_many_of_address": "refused: this address has too many connections",
    "too_many": "refused: there are too many connections",
    "evicted": "disconnected to make room: it had announced no topics",
    "too_many_robots": "refused: too many robots are known",
    "no_key": "refused: it did not prove the key",
    "wrong_key": "refused: it has another key",
    "too_fast": "refused: too many new UDP sessions in a second",
    "unverified": "answered less than it needs: its UDP address is not verified",
    "no_descriptor": "refused: no file descriptor is free",
    "unreachable": "refused: the network reports an error",
    NOT_ROSSERIAL: "sent UDP datagrams that are not rosserial",
    NOT_MICRO_ROS: "sent UDP datagrams that begin no session of micro-ROS (a board in an older session: reset it)",
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


class RefusedLately:
    """Refused peers of the last minute: by way, address and cause, at most MAX_ARRIVALS."""

    def __init__(self) -> None:
        self._times_s: dict[tuple[str, str, str], tuple[int, float]] = {}  # count and time of the last; oldest first

    def note(self, way: str, peer: str, cause: str, now_s: float) -> None:
        """Note a refusal. `peer` is an address without a port."""
        key = (way, peer, cause)
        count, at_s = self._times_s.pop(key, (0, now_s))
        self._times_s[key] = (count + 1 if now_s - at_s < RECENT_S else 1, now_s)
        if len(self._times_s) > MAX_ARRIVALS:
            del self._times_s[next(iter(self._times_s))]

    def recent(self, now_s: float) -> list[Arrival]:
        """Return the refusals of the last minute."""
        return [
            Arrival(way, peer, cause, REFUSALS.get(cause, f"refused: {cause}"), now_s - at_s, count)
            for (way, peer, cause), (count, at_s) in self._times_s.items()
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
    devices = list(ports)
    if not devices and not is_connected:
        devices = [_no_device(refused, listening)]
    return [*devices, *own]


def _no_device(refused: Sequence[Arrival], listening: str) -> Finding:
    counts: Counter[str] = Counter()
    for each in refused:
        if each.cause not in {NOT_ROSSERIAL, NOT_MICRO_ROS}:  # of programs, not of devices that are refused
            counts[each.cause] += each.count
    if not counts:
        return finding("no_device", listening)
    return finding("not_let_in", ", ".join(f"{cause} {count}" for cause, count in counts.items()))
