"""Daemon and guardian understand each other."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.guardian import records

NUMBERS = st.integers(0, 2**64 - 1)


@given(NUMBERS, st.lists(st.integers(1, 2**16 - 1), max_size=records.MAX_TOPICS), st.integers(0, 2**32 - 1))
def test_a_record_is_read_as_it_was_meant(number: int, ids: list[int], claim_bytes: int) -> None:
    topic_ids = tuple(ids)
    record = records.encode_watch(number, topic_ids, claim_bytes)
    assert records.decode(record) == (records.WATCH, number, topic_ids, claim_bytes)
    assert records.decode(records.encode_release(number)) == (records.RELEASE, number, (), 0)


def test_every_record_has_one_size() -> None:
    every = [
        records.encode_watch(1, (100,), 512),
        records.encode_release(1),
        records.encode_ping(),
        records.encode_goodbye(),
    ]
    assert {len(record) for record in every} == {records.RECORD_BYTES}
    assert [records.decode(record)[0] for record in every] == [b"W", b"R", b"P", b"G"]


@given(st.integers(0, 2**32 - 1))
def test_an_answer_counts_the_connections(connections: int) -> None:
    assert records.decode_answer(records.encode_answer(connections)) == connections
