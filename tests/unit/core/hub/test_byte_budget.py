"""ByteBudget: what is kept of strangers' bytes, all of them together."""

import pytest

from hostlink.core.hub.byte_budget import OWN_LATCHED_BYTES, OWN_QUEUE_BYTES, SHARES, ByteBudget, Share
from hostlink.core.hub.queue import Queue
from hostlink.core.hub.topic import Topic
from hostlink.errors import BadRequest

PIECE = bytes(1024 * 1024)


def test_a_share_refuses_what_it_has_no_room_for_and_counts_it() -> None:
    share = Share(10)
    assert share.take(10)
    assert not share.take(1)
    share.give(1)
    assert share.take(1)
    assert (share.held_bytes, share.refused) == (10, 1)


def test_a_block_holds_its_bytes_until_its_end() -> None:
    share = Share(10)
    with share.holding(8, "calls"):
        assert share.held_bytes == 8
        with pytest.raises(BadRequest, match="all clients together have 10 bytes in calls"), share.holding(8, "calls"):
            pass
    assert share.held_bytes == 0


def test_waiting_retry_is_called_when_there_may_be_room() -> None:
    share = Share(10)
    share.take(10)
    tried = list[int]()

    def retry() -> None:
        tried.append(share.held_bytes)
        if not share.take(8):
            share.wait(retry)

    share.wait(retry)
    share.give(1)
    share.give(9)
    share.give(0)
    assert tried == [9, 0]


def latched_topic(budget: ByteBudget, *sources: str) -> Topic:
    topic = Topic("/map", budget=budget)
    topic.latched.update(dict.fromkeys(sources))
    return topic


def test_a_participant_latches_its_own_bound_of_bytes_and_leaving_gives_them_back() -> None:
    budget = ByteBudget()
    topics = [latched_topic(budget, "ann") for _ in range(6)]
    for topic in topics:
        topic.publish(PIECE, source="ann")
    assert sum(topic.latched["ann"] is not None for topic in topics) == OWN_LATCHED_BYTES // len(PIECE)
    assert budget["latched"].refused == 2
    for topic in topics:
        topic.forget_publisher("ann")
    assert budget["latched"].held_bytes == 0
    assert not budget._latched


def test_all_participants_together_latch_no_more_than_the_share() -> None:
    budget = ByteBudget()
    names = [f"program {number}" for number in range(60)]
    topic = latched_topic(budget, *names)
    for name in names:
        topic.publish(PIECE, source=name)
    assert budget["latched"].held_bytes == SHARES["latched"]
    assert sum(payload is not None for payload in topic.latched.values()) == SHARES["latched"] // len(PIECE)


def test_a_latched_message_that_finds_no_room_takes_the_one_before_with_it() -> None:
    """Later subscribers would take the old one for the newest."""
    budget = ByteBudget()
    topic = latched_topic(budget, "ann")
    topic.publish(b"old", source="ann")
    topic.publish(bytes(OWN_LATCHED_BYTES + 1), source="ann")
    assert topic.latched == {"ann": None}
    assert budget["latched"].held_bytes == 0


def test_queues_over_their_share_cost_the_largest_its_oldest_and_the_others_nothing() -> None:
    share = Share(8 * len(PIECE))
    slow, small = Queue[bytes](len, lambda: 0.0, share), Queue[bytes](len, lambda: 0.0, share)
    others = [Queue[bytes](len, lambda: 0.0, share) for _ in range(8)]
    small.put_message("/pose", b"pose")
    for _ in range(7):
        slow.put_message("/image", PIECE)
    for other in others:
        other.put_message("/image", PIECE[: OWN_QUEUE_BYTES * 2])
    assert [other.dropped for other in others] == [0] * len(others)
    assert (slow.dropped, slow.waiting_bytes, small.waiting_bytes) == (2, 5 * len(PIECE), len(b"pose"))
    assert share.held_bytes <= share.max_bytes
    for queue in (slow, small, *others):
        queue.clear()
    assert share.held_bytes == 0


def test_a_client_whose_answers_pile_up_over_the_share_is_too_slow_earlier() -> None:
    share = Share(OWN_QUEUE_BYTES)
    queue, other = Queue[bytes](len, lambda: 0.0, share), Queue[bytes](len, lambda: 0.0, share)
    queue.put_result(PIECE)  # one alone may be large
    assert not queue.is_too_slow
    other.put_result(b"small")
    assert not other.is_too_slow
    queue.put_result(PIECE)
    assert queue.is_too_slow
