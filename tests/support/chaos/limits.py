"""Limits: largest cost and delay of the daemon, for any actions against it. Each is a parameter."""

import argparse
import dataclasses
from dataclasses import dataclass, field


def _limit(default: float, text: str) -> float:
    made: float = field(default=default, metadata={"help": text})
    return made


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The times are for a daemon that has a core to itself; `stretch_most` bounds what a busy machine is forgiven."""

    p99_s: float = _limit(0.100, "99th percentile of a step: the honest program's send to the honest robot's read")
    zero_s: float = _limit(0.6, "from the end of the honest driver to the robot's last non-zero velocity")
    age_s: float = _limit(0.6, "of a velocity that the honest robot obeys: its lease, 0.5 s, and its way to the robot")
    hang_s: float = _limit(1.4, "from the daemon's SIGSTOP to the zero that its guardian sends a driven robot")
    answer_s: float = _limit(1.0, "the honest robot's request for the time or a parameter; it spins until then")
    requested_s: float = _limit(7.0, "a device's service call to its answer or its link's end: 5 s and a margin")
    healthz_s: float = _limit(2.0, "GET /healthz over a new connection")
    reconnect_s: float = _limit(8.0, "the honest robot's new connection to its first zero")
    memory_mib: float = _limit(250.0, "resident memory")
    growth_mib: float = _limit(120.0, "resident memory above that before the first step: all shares of ByteBudget")
    settled_mib: float = _limit(40.0, "the same once everybody hostile has left; threads keep heaps of their own")
    log_bytes: float = _limit(1024 * 1024, "of log that are allowed from the start")
    log_bytes_s: float = _limit(64 * 1024, "of log a second")
    robots: float = _limit(256, "robots in /api/robots")
    robots_gone: float = _limit(128, "robots in /api/robots that are not connected")
    descriptors_free: float = _limit(8, "descriptors that the daemon must have in reserve")
    descriptors_kept: float = _limit(24, "descriptors more than before the first step once everybody hostile has left")
    end_s: float = _limit(2.0, "SIGTERM to the process's end")
    stretch_most: float = _limit(3.0, "by how much a daemon that waits for a core may be slower")


def add_flags(parser: argparse.ArgumentParser) -> None:
    """A flag a limit."""
    group = parser.add_argument_group("limits")
    for each in dataclasses.fields(Limits):
        name = "--limit-" + each.name.replace("_", "-")
        group.add_argument(
            name, dest=each.name, type=float, default=each.default, metavar="NUMBER",
            help=f"{each.metadata['help']} (%(default)s)",
        )  # fmt: skip


def from_flags(arguments: argparse.Namespace) -> Limits:
    """The limits that were given."""
    return Limits(**{each.name: getattr(arguments, each.name) for each in dataclasses.fields(Limits)})
