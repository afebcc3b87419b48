"""Latency: histogram of durations, cheap enough for each velocity command."""

from bisect import bisect_left
from itertools import accumulate

BOUNDS_S = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 5.0)  # the last bucket has no bound
_NO_COUNTS = [0] * (len(BOUNDS_S) + 1)


class Latency:
    """Histogram of durations. `counts` has one more element than BOUNDS_S."""

    __slots__ = ("counts", "sum_s")

    def __init__(self) -> None:
        self.counts = _NO_COUNTS  # its own from the first duration on: most links have none
        self.sum_s = 0.0

    def add(self, seconds: float) -> None:
        """Add one duration."""
        if self.counts is _NO_COUNTS:
            self.counts = [0] * len(_NO_COUNTS)
        self.counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.sum_s += seconds

    def buckets(self) -> list[tuple[str, int]]:
        """Return (bound, count) of durations within each bound, as Prometheus expects; the last entry counts all."""
        bounds = [*map(str, BOUNDS_S), "+Inf"]
        return list(zip(bounds, accumulate(self.counts), strict=True))
