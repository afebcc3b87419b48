"""Limits of log lines, so that no peer fills a disk. Pure. LogBudget: lines of each peer; Budget: one repeated line.

Measured need: tests/system/test_log_budget.py, where one device causes a line with each of its frames. Neither
structlog nor the standard library limits lines by peer.
"""

from collections import Counter, OrderedDict

LOG_INTERVAL_S = 10.0  # between two lines of one kind: a refused peer tries again at once
MAX_KINDS = 64  # with counts each; all further ones are the kind "others"
OTHERS = "others"


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


BURST_LINES = 500  # fifty robots connect from one address
RATE_HZ = 10.0
MAX_PEERS = 1024  # with a bucket each; a new peer replaces the one that was silent for longest


class _PeerBucket:
    __slots__ = ("at_s", "left", "left_out")

    def __init__(self, left: float, at_s: float) -> None:
        self.left, self.at_s, self.left_out = left, at_s, 0


class LogBudget:
    """Token bucket for each peer. Lines above the limit are counted."""

    def __init__(self) -> None:
        self.left_out = 0  # lines of all peers since the start
        self._buckets: OrderedDict[str, _PeerBucket] = OrderedDict()
        self._left_out_of_forgotten = 0

    def allows(self, peer: str, now_s: float) -> bool:
        """Whether one more line of this peer may be written. A refused line is counted."""
        bucket = self._buckets.get(peer) or self._open(peer, now_s)
        self._buckets.move_to_end(peer)
        bucket.left = min(bucket.left + (now_s - bucket.at_s) * RATE_HZ, BURST_LINES)
        bucket.at_s = now_s
        if bucket.left >= 1:
            bucket.left -= 1
            return True
        bucket.left_out += 1
        self.left_out += 1
        return False

    def pop_left_out(self) -> dict[str, int]:
        """Return the lines refused since the last call, by peer; "" is the sum of removed peers."""
        found = {peer: bucket.left_out for peer, bucket in self._buckets.items() if bucket.left_out}
        if self._left_out_of_forgotten:
            found[""] = self._left_out_of_forgotten
        for peer in found.keys() & self._buckets.keys():
            self._buckets[peer].left_out = 0
        self._left_out_of_forgotten = 0
        return found

    def _open(self, peer: str, now_s: float) -> _PeerBucket:
        if len(self._buckets) >= MAX_PEERS:
            _, forgotten = self._buckets.popitem(last=False)
            self._left_out_of_forgotten += forgotten.left_out
        bucket = self._buckets[peer] = _PeerBucket(BURST_LINES, now_s)
        return bucket
