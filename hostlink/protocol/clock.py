"""DeviceClock: how far a device's clock is off, by the header stamps of its messages, and how fast it answers. Pure.

A rosserial device sets its clock by the answers to its time requests, about every 2.5 s, and adds the whole round trip.
It echoes nothing. So from stamps only a sum can be known: how far its clock is off and how long its messages travel.
The least of it, over many messages, is the offset with the shortest way; the rest is jitter.
"""

from collections import deque
from dataclasses import dataclass

WRAP_NS = 2**32 * 1_000_000  # a device counts milliseconds in 32 bits: 49.7 days
STEP_NS = 1_000_000_000  # further away a stamp is damaged, or its clock or the host's was set
STEP_AFTER_S = 5.0  # stamps are away for longer: believed, after two time requests of the device
LATEST_NS = 5_000_000_000  # a message that is older on its arrival has a wrong stamp
BUCKET_S = 10.0  # the least of some four time requests
BUCKETS = 60  # ten minutes, for the drift
RECENT_BUCKETS = 3  # for the offset
DRIFT_SPAN_S = 60.0  # over less, jitter of milliseconds would appear as drift
_NS_PER_S = 1e9


@dataclass(slots=True)
class _Bucket:
    number: int
    at_s: float
    least_ns: int


@dataclass(frozen=True, slots=True)
class ClockReading:
    """What is known of a device's clock and of the way to it; None where it is not measured."""

    offset_s: float | None
    drift_ppm: float | None
    round_trip_s: float | None
    answer_s: float | None


class DeviceClock:
    """Wall times are in nanoseconds, `now_s` is monotonic."""

    def __init__(self) -> None:
        self.answer_s: float | None = None  # from a request for topics to the first of them: network, UART and loop
        self._requested_at_s: float | None = None
        self._buckets: deque[_Bucket] = deque(maxlen=BUCKETS)
        self._away_since_s: float | None = None

    def topics_requested(self, now_s: float) -> None:
        """A request for topics leaves."""
        self._requested_at_s = now_s

    def topics_answered(self, now_s: float) -> None:
        """A topic came."""
        if self._requested_at_s is not None:
            self.answer_s, self._requested_at_s = now_s - self._requested_at_s, None

    def update(self, stamp_ns: int, *, at_ns: int, now_s: float) -> None:
        """A message with this header stamp arrived at `at_ns`; zero is no stamp."""
        if stamp_ns == 0:
            return
        behind_ns = self._behind_ns(stamp_ns, at_ns)
        offset_ns = self.offset_ns
        if offset_ns is not None and abs(behind_ns - offset_ns) > STEP_NS:
            if self._away_since_s is None:
                self._away_since_s = now_s
            if now_s < self._away_since_s + STEP_AFTER_S:
                return
            self._buckets.clear()
        self._away_since_s = None
        number = int(now_s // BUCKET_S)
        if not self._buckets or self._buckets[-1].number != number:
            self._buckets.append(_Bucket(number, now_s, behind_ns))
        elif behind_ns < self._buckets[-1].least_ns:
            self._buckets[-1] = _Bucket(number, now_s, behind_ns)

    def to_host_ns(self, stamp_ns: int, at_ns: int) -> int:
        """When a message was stamped, in the host's time; its arrival when the stamp cannot be believed."""
        offset_ns = self.offset_ns
        if stamp_ns == 0 or offset_ns is None:
            return at_ns
        late_ns = self._behind_ns(stamp_ns, at_ns) - offset_ns
        return at_ns - late_ns if 0 <= late_ns <= LATEST_NS else at_ns

    @property
    def offset_ns(self) -> int | None:
        """How far the device's stamps are behind the host's time of arrival, on the fastest way of the last 30 s."""
        if not self._buckets:
            return None
        newest = self._buckets[-1].number
        return min(bucket.least_ns for bucket in self._buckets if bucket.number > newest - RECENT_BUCKETS)

    @property
    def drift_ppm(self) -> float | None:
        """How much faster the device's clock runs than the host's: the slope of a straight line through the offsets."""
        if not self._buckets or self._buckets[-1].at_s - self._buckets[0].at_s < DRIFT_SPAN_S:
            return None
        first = self._buckets[0]
        times_s = [bucket.at_s - first.at_s for bucket in self._buckets]
        behinds_s = [(bucket.least_ns - first.least_ns) / _NS_PER_S for bucket in self._buckets]
        mean_time_s, mean_s = sum(times_s) / len(times_s), sum(behinds_s) / len(behinds_s)
        variance = sum((time_s - mean_time_s) ** 2 for time_s in times_s)
        pairs = zip(times_s, behinds_s, strict=True)
        return -1e6 * sum((time_s - mean_time_s) * (behind_s - mean_s) for time_s, behind_s in pairs) / variance

    def reading(self, round_trip_s: float | None) -> ClockReading | None:
        """All that is known; None when nothing is. `round_trip_s` is what the network's own measurement says."""
        offset_ns = self.offset_ns
        if (offset_ns, round_trip_s, self.answer_s) == (None, None, None):
            return None
        offset_s = None if offset_ns is None else offset_ns / _NS_PER_S
        return ClockReading(offset_s, self.drift_ppm, round_trip_s, self.answer_s)

    def _behind_ns(self, stamp_ns: int, at_ns: int) -> int:
        """How far a stamp is behind, as if the device's counter had not wrapped."""
        behind_ns, offset_ns = at_ns - stamp_ns, self.offset_ns
        if offset_ns is None:
            return behind_ns
        turns = round((behind_ns - offset_ns) / WRAP_NS)
        unwrapped_ns = behind_ns - turns * WRAP_NS
        return unwrapped_ns if abs(unwrapped_ns - offset_ns) < STEP_NS else behind_ns
