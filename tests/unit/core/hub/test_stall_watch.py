"""StallWatch: how late the loop is, by beats that come late."""

import time

import pytest

from hostlink.core.hub.stall_watch import BEAT_S, GRACE_S, MAX_READINGS, STALL_S, StallWatch, slept_s


def test_a_loop_in_time_is_not_late() -> None:
    stalls = StallWatch(lambda: 0.0)
    for beats in range(5):
        stalls.beat(beats * BEAT_S)
        assert stalls.late_s((beats + 0.9) * BEAT_S) == pytest.approx(0.0, abs=1e-3)


def test_a_long_turn_is_known_before_the_beat_that_it_delays_and_until_the_next_one() -> None:
    stalls = StallWatch(lambda: 0.0)
    stalls.beat(10.0)
    stalls.expect(10.05)
    assert stalls.late_s(10.35) == pytest.approx(0.3, abs=1e-3)
    stalls.beat(10.35)
    assert stalls.late_s(10.36) == pytest.approx(0.3, abs=1e-3)
    stalls.beat(10.45)
    assert stalls.late_s(10.46) == pytest.approx(0.0, abs=1e-3)


def test_many_commands_of_one_late_turn_are_all_late() -> None:
    stalls = StallWatch(lambda: 0.0)
    stalls.beat(10.0)
    stalls.expect(10.05)
    for _ in range(3):
        assert stalls.late_s(10.45) == pytest.approx(0.4, abs=1e-3)
        stalls.pop_pause(10.45)
        stalls.pauses(10.45)
    stalls.beat(10.45)
    assert stalls.late_s(10.45) == pytest.approx(0.4, abs=1e-3)


def test_before_the_first_beat_nothing_is_late() -> None:
    assert StallWatch(lambda: 0.0).late_s(5.0) == 0.0


def test_bytes_read_after_a_sleep_of_the_computer_have_waited_as_long() -> None:
    slept_s = 0.0
    stalls = StallWatch(lambda: slept_s)
    stalls.beat(1.0)
    slept_s = 30.0
    stalls.beat(1.1)
    assert stalls.late_s(1.1) == pytest.approx(30.1)  # since the beat before


def test_pause_is_popped_once_with_the_time_at_which_it_began() -> None:
    stalls = StallWatch(lambda: 0.0)
    stalls.beat(1.0)
    assert stalls.pop_pause(1.4) is None
    assert stalls.pop_pause(1.1 + STALL_S) == 1.0
    assert stalls.pop_pause(1.1 + STALL_S) is None


def test_bytes_read_within_grace_after_a_pause_have_waited_as_long() -> None:
    stalls = StallWatch(lambda: 0.0)
    stalls.beat(1.0)
    now_s = 1.1 + STALL_S
    stalls.beat(now_s)
    assert stalls.late_s(now_s + GRACE_S - 0.01) == pytest.approx(STALL_S + 0.1)
    stalls.beat(now_s + BEAT_S)
    assert stalls.late_s(now_s + GRACE_S - 0.01) > STALL_S
    assert stalls.late_s(now_s + GRACE_S) < GRACE_S


def test_commands_of_a_long_turn_leave_what_is_read_after_them_as_late() -> None:
    stalls = StallWatch(lambda: 0.0)
    stalls.beat(10.0)
    stalls.expect(10.05)
    for _ in range(2):
        assert stalls.pop_pause(10.45) is None
    assert stalls.late_s(10.45) == pytest.approx(0.4)


@pytest.mark.skipif(not hasattr(time, "CLOCK_BOOTTIME"), reason="no clock of the time since the start")
def test_time_without_the_processor_between_two_clocks_is_not_counted_as_sleep() -> None:
    now_s, preemptions_s = 100.0, [0.8, 0.3]

    def boot_s() -> float:
        nonlocal now_s
        now_s += preemptions_s.pop() if preemptions_s else 0.0
        return now_s + 7.0

    assert slept_s(boot_s, lambda: now_s) == pytest.approx(7.0)


@pytest.mark.skipif(not hasattr(time, "CLOCK_BOOTTIME"), reason="no clock of the time since the start")
def test_clocks_that_are_never_read_together_are_read_a_few_times() -> None:
    now_s, readings = 100.0, 0

    def boot_s() -> float:
        nonlocal now_s, readings
        now_s, readings = now_s + 1.0, readings + 1
        return now_s

    assert slept_s(boot_s, lambda: now_s) == pytest.approx(1.0)
    assert readings == MAX_READINGS
