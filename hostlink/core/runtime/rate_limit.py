"""RateLimit: events of each key a second, as token buckets. Pure."""

from collections import OrderedDict
from collections.abc import Hashable
from typing import NamedTuple

REFUSED_VELOCITIES_S = 1.0  # statuses a second about refused velocities of one topic and kind, which may be ten
MAX_KEYS = 1024  # the least recently used is dropped: its bucket is full again by then


class _Bucket(NamedTuple):
    left: float
    at_s: float


class RateLimit:
    """At most `per_s` events of a key a second on average, with bursts of `burst` (one second's worth)."""

    def __init__(self, per_s: float, burst: float | None = None) -> None:
        self.refused = 0
        self._per_s = per_s
        self._burst = per_s if burst is None else burst
        self._buckets: OrderedDict[Hashable, _Bucket] = OrderedDict()

    def allows(self, key: Hashable, now_s: float) -> bool:
        """Whether `key` may have one more event. A refused one does not count against it."""
        bucket = self._buckets.pop(key, _Bucket(self._burst, now_s))
        left = min(self._burst, bucket.left + (now_s - bucket.at_s) * self._per_s)
        is_right = left >= 1
        self._buckets[key] = _Bucket(left - is_right, now_s)
        if len(self._buckets) > MAX_KEYS:
            self._buckets.popitem(last=False)
        self.refused += not is_right
        return is_right
