"""Queue: the cost of a slow client is bounded, counted, and does not affect others."""

import asyncio
import time
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.hub.byte_budget import Share
from hostlink.core.hub.queue import MAX_BYTES, MAX_MESSAGES, MAX_RESULT_BYTES, MAX_RESULTS, Queue


def made() -> Queue[bytes]:
    return Queue(len, time.monotonic)


def drain(queue: Queue[bytes]) -> list[bytes]:
    popped = []
    while (waiting := queue.pop()) is not None:
        popped.append(waiting.item)
    return popped


def test_a_full_queue_drops_the_oldest_of_the_topic_that_fills_it() -> None:
    queue = made()
    queue.put_message("/rare", b"kept")
    for number in range(MAX_MESSAGES + 10):
        queue.put_message("/often", b"%d" % number)
    popped = drain(queue)
    assert popped[0] == b"kept"
    assert popped[-1] == b"%d" % (MAX_MESSAGES + 9)
    assert len(popped) == MAX_MESSAGES
    assert queue.dropped == 11


def test_released_queue_ignores_later_items() -> None:
    """An answer may be ready only when its client has left."""
    share = Share(1024)
    queue = Queue[bytes](len, time.monotonic, share)
    queue.put_result(b"answer")
    queue.release()
    queue.put_result(b"late answer")
    queue.put_message("/often", b"late message")
    assert (share.held_bytes, drain(queue), list(share.queues)) == (0, [], [])


def test_a_new_topic_makes_room_in_the_longest() -> None:
    queue = made()
    for number in range(MAX_MESSAGES):
        queue.put_message("/often", b"%d" % number)
    queue.put_message("/rare", b"new")
    popped = drain(queue)
    assert popped[0] == b"1"
    assert popped[-1] == b"new"


def test_a_rare_topic_beside_one_that_floods_reaches_a_slow_reader_soon_and_whole() -> None:
    """1,500 messages a second and 5 a second, to a client that reads 50."""
    now_s, late_s, queue = 0.0, list[float](), Queue[bytes](len, lambda: now_s)
    dropped = Counter[str]()
    queue.on_dropped = lambda topic: dropped.update((topic,))
    for number in range(1500 * 20):
        now_s = number / 1500
        queue.put_message("/flood", b"f")
        if number % 300 == 0:
            queue.put_message("/state", b"s")
        if number % 30 == 0 and (waiting := queue.pop()) is not None and waiting.item == b"s":
            late_s.append(now_s - waiting.since_s)
    assert dropped.keys() == {"/flood"}
    assert dropped.total() == queue.dropped
    assert len(late_s) >= 100 - 5
    assert max(late_s) < 1.0


def test_a_large_message_takes_the_place_of_what_has_most_bytes() -> None:
    queue = made()
    small, large = MAX_BYTES // 16, MAX_BYTES // 3
    queue.put_message("/state", b"state")
    for _ in range(3):
        queue.put_message("/small", bytes(small))
        queue.put_message("/image", bytes(large))
    assert [len(data) for data in drain(queue)] == [5, small, small, large, small, large]
    queue.put_message("/image", bytes(2 * large))
    for _ in range(8):
        queue.put_message("/small", bytes(small))
    assert [len(data) for data in drain(queue)] == [2 * large, *[small] * 5]  # not the only image


def test_bytes_are_bounded_too() -> None:
    queue = made()
    for _ in range(10):
        queue.put_message("/image", bytes(MAX_BYTES // 4))
    assert len(drain(queue)) == 4
    assert queue.dropped == 6


def test_a_client_that_lets_results_pile_up_is_too_slow() -> None:
    queue = made()
    for _ in range(MAX_RESULTS):
        queue.put_result(b"r")
    assert not queue.is_too_slow
    queue.put_result(b"r")
    assert queue.is_too_slow


def test_results_are_bounded_by_bytes_too_but_one_may_be_of_any_size() -> None:
    queue = made()
    queue.put_result(bytes(MAX_RESULT_BYTES + 1))
    assert not queue.is_too_slow
    queue.put_result(b"r")
    assert queue.is_too_slow


async def test_there_is_room_until_results_fill_half() -> None:
    queue = made()
    for _ in range(MAX_RESULTS // 2):
        queue.put_result(b"r")
    await queue.room()
    queue.put_result(b"r")
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.001):
            await queue.room()
    queue.pop()
    await queue.room()


def test_a_forgotten_topic_leaves_nothing_behind() -> None:
    queue = made()
    queue.put_message("/a", b"1")
    queue.put_message("/b", b"2")
    queue.forget("/a")
    queue.forget("/never")
    assert drain(queue) == [b"2"]


def test_owner_is_told_what_is_put_and_that_the_queue_is_closed() -> None:
    queue, news = made(), list[int]()
    queue.on_news = lambda: news.append(queue.waiting_messages)
    queue.put_message("/a", b"1")
    queue.put_result(b"2")
    queue.wake()
    queue.close()
    assert news == [1, 2, 2, 2]


@given(st.lists(st.tuples(st.sampled_from(["/a", "/b", "/c", ""]), st.integers(1, MAX_BYTES // 3)), max_size=60))
def test_bounds_are_kept_and_what_leaves_is_in_order(puts: list[tuple[str, int]]) -> None:
    queue = made()
    for number, (topic, size) in enumerate(puts):
        data = b"%06d" % number + bytes(size)
        if topic:
            queue.put_message(topic, data)
        else:
            queue.put_result(data[:6])
    popped = drain(queue)
    assert [data[:6] for data in popped] == sorted(data[:6] for data in popped)
    assert sum(len(data) for data in popped if len(data) > 6) <= MAX_BYTES
    assert len(popped) + queue.dropped == len(puts)
