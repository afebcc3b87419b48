"""Estimate the offset, drift and answer time of a device's clock from the header stamps of its messages.

A device of rosserial sets its clock from the answers to its time requests, about every 2.5 s, and adds the whole round
trip. It never echoes the host's time. Stamps therefore show only the sum of clock offset and travel time.
The minimum over many messages is the offset over the shortest travel time; the rest is jitter.
"""

from dataclasses import dataclass

from hostlink.core.runtime.units import NS_PER_S

WRAP_NS = 2**32 * 1_000_000  # a device counts milliseconds in 32 bits: 49.7 days
STEP_NS = 1_000_000_000  # a stamp further away is damaged, or a clock was set
STEP_AFTER_S = 5.0  # accept a changed offset that lasts longer: two time requests of the device
LATEST_NS = 5_000_000_000  # an older message has a wrong stamp
BUCKET_S = 10.0  # one bucket keeps the smallest offset of about four time requests
BUCKETS = 60  # ten minutes, for the drift
RECENT_BUCKETS = 3  # 30 s, for the offset
DRIFT_SPAN_S = 60.0  # over less, jitter of milliseconds would appear as drift


@dataclass(slots=True)
class _OffsetBucket:
    number: int
    at_s: float
    least_ns: int


@dataclass(frozen=True, slots=True)
class ClockReading:
    """Measured clock values of one device. A field is None until it is measured."""

    offset_s: float | None
    drift_ppm: float | None
    round_trip_s: float | None
    answer_s: float | None


class DeviceClock:
    """Clock of one device, seen from the host. Wall times are in nanoseconds; `now_s` is monotonic."""

    __slots__ = ("_away_since_s", "_buckets", "_requested_at_s", "answer_s")

    def __init__(self) -> None:
        self.answer_s: float | None = None  # from a topic request to the first TopicInfo: network, UART and device loop
        self._requested_at_s: float | None = None
        self._buckets: list[_OffsetBucket] = []
        self._away_since_s: float | None = None

    def topics_requested(self, now_s: float) -> None:
        """Note that a topic request was sent."""
        self._requested_at_s = now_s

    def topics_answered(self, now_s: float) -> float | None:
        """Note that a TopicInfo was received. If it is the first after a topic request, return when that was sent."""
        asked_at_s, self._requested_at_s = self._requested_at_s, None
        if asked_at_s is not None:
            self.answer_s = now_s - asked_at_s
        return asked_at_s

    def update(self, stamp_ns: int, *, at_ns: int, now_s: float) -> None:
        """Use the header stamp of a message that arrived at `at_ns`. Ignore a stamp of zero."""
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
            self._buckets.append(_OffsetBucket(number, now_s, behind_ns))
            del self._buckets[:-BUCKETS]
        elif behind_ns < self._buckets[-1].least_ns:
            self._buckets[-1] = _OffsetBucket(number, now_s, behind_ns)

    def to_host_ns(self, stamp_ns: int, at_ns: int) -> int:
        """Return the host time at which a message was stamped, or `at_ns` when the stamp is implausible."""
        offset_ns = self.offset_ns
        if stamp_ns == 0 or offset_ns is None:
            return at_ns
        late_ns = self._behind_ns(stamp_ns, at_ns) - offset_ns
        return at_ns - late_ns if 0 <= late_ns <= LATEST_NS else at_ns

    @property
    def offset_ns(self) -> int | None:
        """Offset of the device's stamps behind the host's arrival time: the minimum of the last 30 s."""
        if not self._buckets:
            return None
        newest = self._buckets[-1].number
        return min(bucket.least_ns for bucket in self._buckets if bucket.number > newest - RECENT_BUCKETS)

    @property
    def drift_ppm(self) -> float | None:
        """Rate of the device's clock relative to the host's, as the slope of a straight line through the offsets."""
        if not self._buckets or self._buckets[-1].at_s - self._buckets[0].at_s < DRIFT_SPAN_S:
            return None
        first = self._buckets[0]
        times_s = [bucket.at_s - first.at_s for bucket in self._buckets]
        behinds_s = [(bucket.least_ns - first.least_ns) / NS_PER_S for bucket in self._buckets]
        mean_time_s, mean_s = sum(times_s) / len(times_s), sum(behinds_s) / len(behinds_s)
        variance = sum((time_s - mean_time_s) ** 2 for time_s in times_s)
        pairs = zip(times_s, behinds_s, strict=True)
        return -1e6 * sum((time_s - mean_time_s) * (behind_s - mean_s) for time_s, behind_s in pairs) / variance

    def reading(self, round_trip_s: float | None) -> ClockReading | None:
        """Return all measured values, or None when there are none. `round_trip_s` is measured by the transport."""
        offset_ns = self.offset_ns
        if (offset_ns, round_trip_s, self.answer_s) == (None, None, None):
            return None
        offset_s = None if offset_ns is None else offset_ns / NS_PER_S
        return ClockReading(offset_s, self.drift_ppm, round_trip_s, self.answer_s)

    def _behind_ns(self, stamp_ns: int, at_ns: int) -> int:
        """Return the offset of one stamp, corrected for wraps of the device's 32-bit counter."""
        behind_ns, offset_ns = at_ns - stamp_ns, self.offset_ns
        if offset_ns is None:
            return behind_ns
        turns = round((behind_ns - offset_ns) / WRAP_NS)
        unwrapped_ns = behind_ns - turns * WRAP_NS
        return unwrapped_ns if abs(unwrapped_ns - offset_ns) < STEP_NS else behind_ns
