"""HostPauses: times when the host did not run."""

from hostlink.core.hub.stall_watch import BEAT_S, StallWatch
from hostlink.core.runtime.host_pauses import MAX_UNSETTLED_S, RECOVERY_S, HostPauses


def paused(*spans: tuple[float, float]) -> HostPauses:
    pauses = HostPauses()
    for began_s, ended_s in spans:
        pauses.add(began_s, ended_s, settled_at_s=ended_s + 0.25)
    return pauses


def test_awake_time_without_a_pause_is_all_of_it() -> None:
    assert paused().awake_s(3.0, 10.0) == 7.0
    assert paused().has_recovered(10.0)
    assert paused().is_settled(10.0)


def test_awake_time_excludes_pauses_and_parts_of_them() -> None:
    pauses = paused((1.0, 2.0), (4.0, 8.0))
    assert pauses.awake_s(0.0, 10.0) == 5.0
    assert pauses.awake_s(2.0, 10.0) == 4.0
    assert pauses.awake_s(5.0, 10.0) == 2.0
    assert pauses.awake_s(9.0, 10.0) == 1.0


def test_due_work_waits_until_waiting_bytes_are_read() -> None:
    pauses = paused((1.0, 9.0))
    assert not pauses.is_settled(9.0)
    assert pauses.is_settled(9.25)
    assert not pauses.has_recovered(9.25)
    assert pauses.has_recovered(9.0 + RECOVERY_S)


def test_due_work_is_not_postponed_by_endless_pauses() -> None:
    pauses, now_s = paused((1.0, 9.0)), 9.0
    while now_s < 9.0 + MAX_UNSETTLED_S:
        assert not pauses.is_settled(now_s)
        pauses.add(now_s, now_s + 0.6, settled_at_s=now_s + 0.85)
        now_s += 0.6
    assert pauses.is_settled(now_s)


def test_stall_watch_remembers_a_pause_that_another_than_its_beat_sees_first() -> None:
    watch = StallWatch(lambda: 0.0)
    watch.beat(1.0)
    pauses = watch.pauses(9.0)
    assert pauses.awake_s(0.0, 9.0) == 1.0
    assert not pauses.is_settled(9.0)
    assert watch.pop_pause(9.1) == 1.0


def test_stall_watch_notices_that_the_computer_slept() -> None:
    """The event loop's clock stops meanwhile."""
    slept_s = 5.0
    watch = StallWatch(lambda: slept_s)
    for beat in range(3):
        watch.beat(1.0 + beat * BEAT_S)
    assert watch.pop_pause(1.3) is None
    slept_s = 3605.0
    assert watch.pop_pause(1.4) == 1.2
    assert not watch.pauses(1.4).has_recovered(1.4)
