"""Send queue of a slow subscriber."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.graphs.ros1.connections import BATCH_BYTES, MAX_BYTES, MAX_MESSAGES, SendQueue


def filled(*messages: bytes) -> SendQueue:
    made = SendQueue()
    for each in messages:
        made.put(each)
    return made


@given(st.lists(st.binary(min_size=1, max_size=9), max_size=MAX_MESSAGES))
def test_messages_within_the_bounds_leave_in_their_order(messages: list[bytes]) -> None:
    made = filled(*messages)
    assert bool(made) is bool(messages)
    assert made.pop_batch() == b"".join(messages)
    assert not made
    assert made.dropped == 0


def test_full_queue_drops_the_oldest() -> None:
    made = filled(*(bytes([number % 256]) for number in range(MAX_MESSAGES + 3)))
    assert made.dropped == 3
    assert made.pop_batch()[:2] == b"\x03\x04"


def test_of_too_many_bytes_the_oldest_go_but_never_the_newest() -> None:
    half = bytes(MAX_BYTES // 2)
    made = filled(half, half, b"new")
    assert made.dropped == 1
    made.put(bytes(MAX_BYTES + 1))
    assert made.dropped == 3
    assert len(made.pop_batch()) == MAX_BYTES + 1


def test_a_batch_has_an_end() -> None:
    made = filled(*([bytes(1000)] * 100))
    first = made.pop_batch()
    assert BATCH_BYTES <= len(first) < BATCH_BYTES + 1000
    assert len(first) + len(made.pop_batch()) == 100_000
