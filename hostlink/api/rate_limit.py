"""RateLimit: requests of each client a second, as token buckets."""

from collections import OrderedDict
from collections.abc import Hashable
from typing import NamedTuple

REFUSED_VELOCITIES_S = 1.0  # statuses a second about refused velocities of one topic, which may have ten a second
MAX_KEYS = 1024  # the least recently used is dropped: its bucket is full again by then


class _Bucket(NamedTuple):
    left: float
    at_s: float


class RateLimit:
    """At most `per_s` requests a second on average, with bursts of one second's worth."""

    def __init__(self, per_s: float) -> None:
        self.refused = 0
        self._per_s = per_s
        self._buckets: OrderedDict[Hashable, _Bucket] = OrderedDict()

    def allows(self, key: Hashable, now_s: float) -> bool:
        """Whether `key` may send one more request. A refused request does not count against it."""
        left = self._left(key, now_s)
        is_right = left >= 1
        self._keep(key, _Bucket(left - is_right, now_s))
        self.refused += not is_right
        return is_right

    def _left(self, key: Hashable, now_s: float) -> float:
        bucket = self._buckets.pop(key, _Bucket(self._per_s, now_s))
        return min(self._per_s, bucket.left + (now_s - bucket.at_s) * self._per_s)

    def _keep(self, key: Hashable, bucket: _Bucket) -> None:
        self._buckets[key] = bucket
        if len(self._buckets) > MAX_KEYS:
            self._buckets.popitem(last=False)
