"""Subscription: throttle_rate and queue_length as rosbridge's clients expect them (docs/api.md)."""

import weakref
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.hub.byte_budget import Share
from hostlink.core.hub.message import Message
from hostlink.core.hub.node import Node
from hostlink.core.hub.subscription import Subscription


class Receiver:
    """A subscription, the numbers of the messages that it delivered, and how often it said that others wait."""

    def __init__(self, *, interval_s: float = 0.0, queue_length: int = 0, group: str = "", max_bytes: int = 1000):
        self.numbers: list[int] = []
        self.throttled = 0
        self.share = Share(max_bytes)
        self.subscription = Subscription(
            lambda message: self.numbers.append(message.stamp_ns),
            self._note,
            interval_s=interval_s,
            queue_length=queue_length,
            group=group,
            share=self.share,
        )

    def _note(self) -> None:
        self.throttled += 1

    def receive(self, *numbers: int, at_s: float = 0.0, source: object = None) -> None:
        for number in numbers:
            self.subscription.receive(
                Message("/t", "", None, b"%010d" % number, source=source, stamp_ns=number, at_s=at_s)
            )


def test_subscription_without_interval_delivers_every_message_at_once() -> None:
    receiver = Receiver()
    receiver.receive(0, 1, 2)
    assert receiver.numbers == [0, 1, 2]
    assert receiver.subscription.flush(1.0) is None
    assert receiver.throttled == 0


def test_subscription_without_queue_drops_messages_within_the_interval() -> None:
    receiver = Receiver(interval_s=1.0)
    receiver.receive(0)
    receiver.receive(1, at_s=0.5)
    assert receiver.subscription.flush(1.0) is None
    receiver.receive(2, at_s=1.0)
    assert receiver.numbers == [0, 2]
    assert receiver.throttled == 0


def test_queue_keeps_the_newest_messages_and_delivers_the_oldest_of_them_first() -> None:
    receiver = Receiver(interval_s=1.0, queue_length=2)
    receiver.receive(0)
    receiver.receive(1, 2, 3, at_s=0.1)
    assert (receiver.numbers, receiver.throttled) == ([0], 3)
    assert receiver.subscription.flush(0.9) == 1.0
    assert receiver.subscription.flush(1.0) == 2.0
    assert receiver.subscription.flush(1.5) == 2.0
    assert receiver.numbers == [0, 2]
    assert receiver.subscription.flush(2.0) is None
    assert receiver.numbers == [0, 2, 3]
    receiver.receive(4, at_s=2.9)
    assert receiver.subscription.flush(2.9) == 3.0


def test_message_after_the_interval_waits_behind_older_ones() -> None:
    receiver = Receiver(interval_s=1.0, queue_length=2)
    receiver.receive(0, 1)
    receiver.receive(2, at_s=1.0)
    assert receiver.numbers == [0, 1]
    assert [message.stamp_ns for message in receiver.subscription.waiting] == [2]
    assert receiver.throttled == 1


def test_change_of_interval_keeps_waiting_messages_and_the_time_of_the_last_one() -> None:
    receiver = Receiver(interval_s=1.0, queue_length=2)
    receiver.receive(0, 1, 2)
    receiver.subscription.change(interval_s=1.0, queue_length=2)
    assert receiver.subscription.flush(0.9) == 1.0
    receiver.subscription.change(interval_s=0.25, queue_length=1)
    assert receiver.subscription.flush(0.2) == 0.25
    assert receiver.subscription.flush(0.25) is None
    assert receiver.numbers == [0, 2]


def test_waiting_messages_are_counted_in_the_share_until_they_are_delivered_or_dropped() -> None:
    receiver = Receiver(interval_s=1.0, queue_length=8)
    receiver.receive(0, 1, 2)
    assert receiver.share.held_bytes == 20
    receiver.subscription.flush(1.0)
    assert receiver.share.held_bytes == 10
    receiver.subscription.close()
    assert receiver.share.held_bytes == 0
    receiver.receive(3, at_s=5.0)
    assert receiver.numbers == [0, 1]


def test_oldest_messages_are_dropped_when_the_share_is_over() -> None:
    receiver = Receiver(interval_s=60.0, queue_length=256, max_bytes=30)
    receiver.receive(*range(10))
    assert receiver.share.held_bytes == 30
    assert receiver.share.refused == 6
    receiver.subscription.flush(60.0)
    assert receiver.numbers == [0, 7]
    receiver.subscription.close()
    assert receiver.share.held_bytes == 0


def test_subscription_does_not_receive_what_its_own_group_publishes() -> None:
    receiver = Receiver(group="ros2")
    receiver.receive(0, source=Node("bridge", group="ros2"))
    receiver.receive(1, source=Node("program"))
    receiver.receive(2, source=Node("other", group="ros1"))
    assert receiver.numbers == [1, 2]


@given(st.integers(0, 5), st.lists(st.floats(0.0, 0.5), max_size=60))
def test_two_messages_are_never_closer_than_the_interval_nor_out_of_order(
    queue_length: int, pauses_s: list[float]
) -> None:
    receiver = Receiver(interval_s=1.0, queue_length=queue_length)
    now_s, times = 0.0, []
    for number, pause_s in enumerate(pauses_s):
        now_s += pause_s
        before = len(receiver.numbers)
        receiver.subscription.flush(now_s)
        receiver.receive(number, at_s=now_s)
        times += [now_s] * (len(receiver.numbers) - before)
    assert all(later >= earlier + 1.0 for earlier, later in pairwise(times))  # their difference may be rounded
    assert receiver.numbers == sorted(receiver.numbers)


def test_closed_subscription_keeps_nothing_of_its_owner() -> None:
    """Otherwise a client that subscribes and unsubscribes makes a cycle each time, until garbage is collected."""
    receiver = Receiver()
    subscription, kept = receiver.subscription, weakref.ref(receiver)
    subscription.close()
    del receiver
    assert kept() is None
    subscription.receive(Message("/t", "", None, b"late", source=None, stamp_ns=0, at_s=0.0))
