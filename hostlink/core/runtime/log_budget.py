"""Limits of log lines, so that no peer fills a disk. Pure. LogBudget: lines of each peer; Budget: one repeated line.

Measured need: tests/system/test_log_budget.py, where one device causes a line with each of its frames. Neither
structlog nor the standard library limits lines by peer.
"""

from collections import Counter

from hostlink.core.runtime.rate_limit import RateLimit

LOG_INTERVAL_S = 10.0  # between two lines of one kind: a refused peer tries again at once
MAX_KINDS = 64  # with counts each; all further ones are the kind "others"
OTHERS = "others"

BURST_LINES = 500  # fifty robots connect from one address
RATE_HZ = 10.0
MAX_NAMED = 1024  # peers whose refused lines are counted apart


class Budget:
    """Rate limit of repeated lines: the first of a kind is due at once, then one in LOG_INTERVAL_S with the counts."""

    def __init__(self) -> None:
        self._since: dict[str, Counter[str]] = {}
        self._due_s: dict[str, float] = {}

    def due(self, kind: str, now_s: float, cause: str = "count") -> Counter[str]:
        """Count an event by its cause. Return the counts since the last line of its kind; empty: no line is due."""
        if kind not in self._due_s and len(self._due_s) >= MAX_KINDS:
            kind = OTHERS
        since = self._since.setdefault(kind, Counter())
        since[cause] += 1
        if now_s < self._due_s.get(kind, float("-inf")):
            return Counter()
        self._due_s[kind] = now_s + LOG_INTERVAL_S
        return self._since.pop(kind)


class LogBudget:
    """Rate limit of the lines of each peer. Lines above it are counted."""

    def __init__(self) -> None:
        self._limit = RateLimit(RATE_HZ, burst=BURST_LINES)
        self._left_out: Counter[str] = Counter()  # by peer, since the last `pop_left_out`

    @property
    def left_out(self) -> int:
        """Number of refused lines of all peers since the start."""
        return self._limit.refused

    def allows(self, peer: str, now_s: float) -> bool:
        """Whether one more line of this peer may be written. A refused line is counted."""
        is_allowed = self._limit.allows(peer, now_s)
        if not is_allowed:
            is_named = peer in self._left_out or len(self._left_out) < MAX_NAMED
            self._left_out[peer if is_named else ""] += 1
        return is_allowed

    def pop_left_out(self) -> Counter[str]:
        """Return the lines refused since the last call, by peer; "" is the sum of peers above MAX_NAMED."""
        found, self._left_out = self._left_out, Counter()
        return found
