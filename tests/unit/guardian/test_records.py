"""Daemon and guardian understand each other."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.guardian import records

NUMBERS = st.integers(0, 2**64 - 1)


@given(NUMBERS, st.integers(0, 2**16 - 1), st.integers(0, 2**32 - 1))
def test_a_record_says_what_was_meant(number: int, topic_id: int, claim_bytes: int) -> None:
    record = records.encode_watch(number, topic_id, claim_bytes)
    assert records.decode(record) == (records.WATCH, number, topic_id, claim_bytes)
    assert records.decode(records.encode_release(number)) == (records.RELEASE, number, 0, 0)


def test_every_record_has_one_size() -> None:
    every = [
        records.encode_watch(1, 100, 512),
        records.encode_release(1),
        records.encode_ping(),
        records.encode_goodbye(),
    ]
    assert {len(record) for record in every} == {records.RECORD_BYTES}
    assert [records.decode(record)[0] for record in every] == [b"W", b"R", b"P", b"G"]


@given(st.integers(0, 2**32 - 1))
def test_an_answer_says_how_many_are_held(held: int) -> None:
    assert records.decode_answer(records.encode_answer(held)) == held
