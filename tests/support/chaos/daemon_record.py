"""DaemonRecord: samples of the daemon from outside; finds the budgets that it has broken. Pure."""

import re
from dataclasses import dataclass

from tests.support.chaos.limits import Limits
from tests.support.chaos.noise import Noise
from tests.support.chaos.violation import Violation

MIB = 1024 * 1024
RESTARTED_S = 0.2  # a request that began just after a restart may have met the daemon's end
WORDS_OF_A_CRASH = (b"Traceback (most recent call last)", b"link.crashed", b"was never retrieved")


@dataclass(frozen=True)
class Sample:
    """One sample of the daemon."""

    at_s: float
    memory_bytes: int
    log_bytes: int
    descriptors: int
    descriptors_most: int
    ran_s: float = 0.0
    waited_s: float = 0.0


@dataclass(frozen=True)
class Health:
    """One question to /healthz; `status` 0: no answer."""

    requested_s: float
    lasted_s: float
    status: int


_KINDS = rb"[A-Za-z_][\w.]*(?:Error|Exception|Interrupt|Exit|Gone|Busy|Type)\b"  # of exceptions, as the log names them
CAUSE = re.compile(rb"(?:^|\\n|\n)[ |+]*(" + _KINDS + rb"[^\n\\]{0,120})")


class DaemonRecord:
    """A budget that is broken is one violation until it is kept again."""

    def __init__(self, limits: Limits, noise: Noise) -> None:
        self.most_memory_bytes = self.most_log_bytes = self.most_robots = 0
        self.slowest_s = 0.0
        self.last_memory_bytes = 0
        self._limits, self._noise = limits, noise
        self._first: Sample | None = None
        self._last: Sample | None = None
        self._broken: set[str] = set()
        self._causes: set[str] = set()  # kinds of exceptions in the log; each is one violation
        self._found: list[Violation] = []

    @property
    def growth_mib(self) -> float:
        """Resident memory above that of the first sample."""
        return 0.0 if self._first is None else (self.last_memory_bytes - self._first.memory_bytes) / MIB

    def add_sample(self, sample: Sample) -> None:
        """Add a sample; growth counts from the first."""
        self._first = first = self._first or sample
        self._last = sample
        self._noise.add_turn(sample.at_s, sample.ran_s, sample.waited_s)
        self.last_memory_bytes = sample.memory_bytes
        self.most_memory_bytes = max(self.most_memory_bytes, sample.memory_bytes)
        self.most_log_bytes = max(self.most_log_bytes, sample.log_bytes)
        limits = self._limits
        log_limit = limits.log_bytes + limits.log_bytes_s * (sample.at_s - first.at_s)
        self._judge("memory, MiB", sample.memory_bytes / MIB, limits.memory_mib, sample.at_s)
        self._judge("growth of memory, MiB", self.growth_mib, limits.growth_mib, sample.at_s)
        self._judge("log, bytes", sample.log_bytes, log_limit, sample.at_s)
        most = sample.descriptors_most - limits.descriptors_free
        self._judge("descriptors", sample.descriptors, most, sample.at_s)

    def add_health(self, health: Health) -> None:
        """Add an answer, or that none came."""
        end_s = health.requested_s + health.lasted_s
        if self._noise.absent_s(health.requested_s - RESTARTED_S, end_s):
            return
        limit_s = self._limits.healthz_s * self._noise.stretch(health.requested_s, end_s)
        limit_s += self._noise.paused_s(health.requested_s, end_s)
        self.slowest_s = max(self.slowest_s, health.lasted_s)
        self._judge("/healthz answers, s", health.lasted_s, limit_s, health.requested_s)
        if health.status not in (0, 200) or (health.status == 0 and health.lasted_s <= limit_s):
            self._fail("/healthz answers 200", health.status, 200, health.requested_s)

    def add_robots(self, are_connected: list[bool], at_s: float) -> None:
        """The robots of /api/robots."""
        self.most_robots = max(self.most_robots, len(are_connected))
        self._judge("robots known", len(are_connected), self._limits.robots, at_s)
        self._judge("robots known that are gone", are_connected.count(False), self._limits.robots_gone, at_s)

    def add_log(self, text: bytes, at_s: float) -> None:
        """Check whole lines that were added to the log."""
        if not any(word in text for word in WORDS_OF_A_CRASH):
            return
        causes = {cause[1].decode(errors="replace") for cause in CAUSE.finditer(text)} or {"unknown"}
        for cause in sorted(causes):
            if (kind := cause.partition(":")[0]) not in self._causes:
                self._causes.add(kind)
                self._found.append(Violation("no traceback in the log", 0, 0, cause, at_s=at_s))

    def settle(self) -> list[Violation]:
        """Check the invariants after all hostile peers have left; before the last call they are not counted."""
        if self._first is None or self._last is None:
            return [Violation("the daemon is sampled", 0, 1)]
        growth_mib = self.growth_mib
        kept = self._last.descriptors - self._first.descriptors
        found = []
        if growth_mib > self._limits.settled_mib:
            found.append(
                Violation("memory settles, MiB of growth", growth_mib, self._limits.settled_mib, at_s=self._last.at_s)
            )
        if kept > self._limits.descriptors_kept:
            found.append(Violation("descriptors settle", kept, self._limits.descriptors_kept, at_s=self._last.at_s))
        return found

    def check(self) -> list[Violation]:
        """The violations since the last call."""
        found, self._found = self._found, []
        return found

    def _judge(self, promise: str, figure: float, limit: float, at_s: float) -> None:
        if figure <= limit:
            self._broken.discard(promise)
        else:
            self._fail(promise, figure, limit, at_s)

    def _fail(self, promise: str, figure: float, limit: float, at_s: float) -> None:
        if promise not in self._broken:
            self._broken.add(promise)
            self._found.append(Violation(promise, figure, limit, at_s=at_s))
