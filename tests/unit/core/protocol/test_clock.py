"""DeviceClock with jitter, drift, steps, the wrap after 49.7 days, and damaged stamps."""

import random
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.clock import STEP_AFTER_S, WRAP_NS, ClockReading, DeviceClock

WALL_NS = 1_800_000_000_000_000_000
S = 1_000_000_000


def host_ns(now_s: float) -> int:
    return WALL_NS + round(now_s * S)


class Run:
    """Simulated device that stamps ten messages a second, and the host's clock."""

    def __init__(self, device_ns: Callable[[float], int], latency_s: Callable[[], float] = lambda: 0.002) -> None:
        self.clock = DeviceClock()
        self.now_s = 0.0
        self.stamps: list[int] = []  # in the host's time
        self._device_ns, self._latency_s = device_ns, latency_s

    def until(self, end_s: float) -> "Run":
        while self.now_s < end_s:
            self.now_s += 0.1
            stamp_ns = self._device_ns(self.now_s)
            arrival_s = self.now_s + self._latency_s()
            self.clock.update(stamp_ns, at_ns=host_ns(arrival_s), now_s=arrival_s)
            self.stamps.append(self.clock.to_host_ns(stamp_ns, host_ns(arrival_s)))
        return self

    @property
    def offset_s(self) -> float:
        assert self.clock.offset_ns is not None
        return self.clock.offset_ns / S


def test_new_clock_has_no_reading() -> None:
    clock = DeviceClock()
    assert clock.reading(None) is None
    assert clock.to_host_ns(5, 7) == 7
    clock.update(0, at_ns=WALL_NS, now_s=0.0)  # no stamp
    assert clock.reading(None) is None


def test_offset_is_that_of_the_fastest_message() -> None:
    chance = random.Random(1)
    run = Run(lambda s: host_ns(s) + S // 4, lambda: 0.002 + chance.expovariate(50)).until(60)
    assert run.offset_s == pytest.approx(-0.25 + 0.002, abs=0.002)


def test_jitter_is_removed_from_the_stamps() -> None:
    chance = random.Random(2)
    run = Run(lambda s: host_ns(s) - 3 * S, lambda: 0.002 + chance.expovariate(50)).until(60)
    steps_s = [(after - before) / S for before, after in zip(run.stamps[200:], run.stamps[201:], strict=False)]
    assert steps_s == pytest.approx([0.1] * len(steps_s), abs=0.003)


@pytest.mark.parametrize("ppm", [-200.0, -30.0, 0.0, 30.0, 200.0])
def test_drift_of_an_unset_clock_is_measured(ppm: float) -> None:
    chance = random.Random(3)
    run = Run(lambda s: round(s * S * (1 + ppm / 1e6)), lambda: 0.002 + chance.expovariate(100)).until(600)
    assert run.clock.drift_ppm == pytest.approx(ppm, abs=5)


def test_drift_over_a_short_time_is_none() -> None:
    assert Run(host_ns).until(30).clock.drift_ppm is None


def rosserial_ns(boot_ms: int, round_trip_s: float) -> Callable[[float], int]:
    """nh.now(): the last time answer plus the whole round trip, on a 32-bit millisecond counter."""
    offset_ns, synced_at_s = 0, float("-inf")

    def now_ns(now_s: float) -> int:
        nonlocal offset_ns, synced_at_s
        ms = (boot_ms + int(now_s * 1000)) % 2**32
        if now_s >= synced_at_s + 2.5:
            offset_ns, synced_at_s = host_ns(now_s) + round(round_trip_s * S) - ms * 1_000_000, now_s
        return offset_ns + ms * 1_000_000

    return now_ns


def test_wrap_after_49_days_causes_no_jump() -> None:
    wrap_in_ms = 61_000  # halfway between two time requests
    run = Run(rosserial_ns(2**32 - wrap_in_ms, 0.02)).until(120)
    assert run.stamps == sorted(run.stamps)
    assert all(abs(stamp - host_ns(0.1 * (number + 1))) < S // 20 for number, stamp in enumerate(run.stamps))
    assert run.offset_s == pytest.approx(-0.02 + 0.002, abs=0.005)


def test_unset_device_clock_wraps_without_a_jump() -> None:
    run = Run(lambda s: (round((s + 50) * S) - 60 * S) % WRAP_NS).until(60)
    assert run.stamps == sorted(run.stamps)
    assert run.stamps[-1] == pytest.approx(host_ns(60.0), abs=S // 100)


@pytest.mark.parametrize("step_s", [-3600, -2, 2, 3600])
def test_changed_offset_is_accepted_after_five_seconds(step_s: int) -> None:
    run = Run(lambda s: host_ns(s) + (step_s * S if s > 30 else 0)).until(30 + STEP_AFTER_S + 1)
    assert run.offset_s == pytest.approx(0.002 - step_s, abs=0.001)


@pytest.mark.parametrize("damage_ns", [-(10**18), -10 * S, 10 * S, 10**18])
def test_damaged_stamp_is_replaced_by_the_arrival_time(damage_ns: int) -> None:
    run = Run(lambda s: host_ns(s) + (damage_ns if 29.95 < s < 30.05 else 0)).until(60)
    assert run.offset_s == pytest.approx(0.002, abs=1e-6)
    assert run.stamps == sorted(run.stamps)
    assert run.stamps[299] == pytest.approx(host_ns(30.0), abs=S // 100)


def test_messages_of_a_stalled_network_keep_their_times() -> None:
    clock = DeviceClock()
    for tenth in range(100):
        clock.update(host_ns(tenth / 10), at_ns=host_ns(tenth / 10 + 0.002), now_s=tenth / 10)
    stamps = [clock.to_host_ns(host_ns(10 + tenth / 10), host_ns(12.0)) for tenth in range(20)]
    assert stamps == pytest.approx([host_ns(10 + tenth / 10 + 0.002) for tenth in range(20)], abs=1000)


def test_answer_of_a_device_is_timed_once_a_request() -> None:
    clock = DeviceClock()
    clock.topics_answered(1.0)
    assert clock.answer_s is None
    clock.topics_requested(2.0)
    clock.topics_answered(2.06)
    clock.topics_answered(2.1)
    assert clock.answer_s == pytest.approx(0.06)
    assert clock.reading(0.004) == ClockReading(None, None, round_trip_s=0.004, answer_s=clock.answer_s)


@given(
    st.integers(-(10**6), 10**6),
    st.floats(-500, 500),
    st.lists(st.tuples(st.floats(0.01, 3.0), st.floats(0, 0.9)), min_size=1, max_size=60),
)
def test_steady_device_is_never_stamped_backwards_nor_into_the_future(
    offset_s: int, ppm: float, messages: list[tuple[float, float]]
) -> None:
    """TCP keeps the order: each message arrives after the one before it."""
    clock, now_s, arrival_s, shown_ns = DeviceClock(), 0.0, 0.0, 0
    for pause_s, latency_s in messages:
        now_s += pause_s
        arrival_s = max(arrival_s, now_s + latency_s)
        stamp_ns = host_ns(now_s * (1 + ppm / 1e6)) + offset_s * S
        clock.update(stamp_ns, at_ns=host_ns(arrival_s), now_s=arrival_s)
        given_ns = clock.to_host_ns(stamp_ns, host_ns(arrival_s))
        assert given_ns <= host_ns(arrival_s)
        shown_ns = max(shown_ns, given_ns)  # as in the odometry, whose time never decreases
        assert shown_ns <= host_ns(arrival_s)


@given(st.lists(st.tuples(st.integers(0, 2**63), st.floats(0, 100)), max_size=60))
def test_any_stamps_raise_nothing(messages: list[tuple[int, float]]) -> None:
    clock, now_s = DeviceClock(), 0.0
    for stamp_ns, pause_s in messages:
        now_s += pause_s
        clock.update(stamp_ns, at_ns=host_ns(now_s), now_s=now_s)
        given_ns = clock.to_host_ns(stamp_ns, host_ns(now_s))
        assert host_ns(now_s) - 5 * S <= given_ns <= host_ns(now_s)
        assert clock.reading(None) is None or clock.offset_ns is not None
