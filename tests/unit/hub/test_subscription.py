"""throttle_rate and queue_length as rosbridge's clients expect them (docs/api.md)."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from hostlink.hub.message import Message
from hostlink.hub.subscription import Throttle


def message(number: int) -> Message:
    return Message("/t", "", None, b"%d" % number, source=None, stamp_ns=number, at_s=0.0)


def test_without_a_rate_everything_passes_at_once() -> None:
    throttle = Throttle(interval_s=0.0, queue_length=0)
    messages = [message(number) for number in range(3)]
    assert [throttle.offer(each, 0.0) for each in messages] == messages
    assert throttle.due_s() is None


def test_without_a_queue_what_comes_in_between_is_dropped() -> None:
    throttle = Throttle(interval_s=1.0, queue_length=0)
    first, second, third = (message(number) for number in range(3))
    assert throttle.offer(first, 0.0) is first
    assert throttle.offer(second, 0.5) is None
    assert throttle.pop(1.0) is None
    assert throttle.offer(third, 1.0) is third


def test_a_queue_keeps_the_newest_and_sends_the_oldest_of_them_first() -> None:
    throttle = Throttle(interval_s=1.0, queue_length=2)
    messages = [message(number) for number in range(4)]
    assert throttle.offer(messages[0], 0.0) is messages[0]
    for each in messages[1:]:
        assert throttle.offer(each, 0.1) is None
    assert throttle.due_s() == 1.0
    assert throttle.pop(0.9) is None
    assert throttle.pop(1.0) is messages[2]
    assert throttle.pop(1.5) is None
    assert throttle.pop(2.0) is messages[3]
    assert throttle.due_s() is None


def test_another_pace_keeps_what_waits_and_when_the_last_one_went() -> None:
    throttle = Throttle(interval_s=1.0, queue_length=2)
    messages = [message(number) for number in range(3)]
    for each in messages:
        throttle.offer(each, 0.0)
    throttle.change(interval_s=1.0, queue_length=2)
    assert throttle.due_s() == 1.0
    throttle.change(interval_s=0.25, queue_length=1)
    assert throttle.due_s() == 0.25
    assert throttle.pop(0.25) is messages[2]


@given(st.integers(0, 5), st.lists(st.floats(0.0, 0.5), max_size=60))
def test_never_two_within_the_interval_and_never_out_of_order(queue_length: int, pauses_s: list[float]) -> None:
    throttle = Throttle(interval_s=1.0, queue_length=queue_length)
    now_s, sent = 0.0, []
    for number, pause_s in enumerate(pauses_s):
        now_s += pause_s
        offered = (throttle.pop(now_s), throttle.offer(message(number), now_s))
        sent += [(now_s, ready.stamp_ns) for ready in offered if ready is not None]
    times = [at_s for at_s, _ in sent]
    assert all(later >= earlier + 1.0 for earlier, later in pairwise(times))  # their difference may be rounded
    assert [number for _, number in sent] == sorted(number for _, number in sent)
