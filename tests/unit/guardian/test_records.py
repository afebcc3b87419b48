"""Records between daemon and guardian, encoded and decoded."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.guardian import records

NUMBERS = st.integers(0, 2**64 - 1)


@given(NUMBERS, st.lists(st.integers(1, 2**16 - 1), max_size=records.MAX_TOPICS), st.integers(0, 2**32 - 1))
def test_encoded_record_is_decoded(number: int, ids: list[int], claim_bytes: int) -> None:
    topic_ids = tuple(ids)
    record = records.encode(records.WATCH, number, topic_ids, claim_bytes)
    assert records.decode(record) == (records.WATCH, number, topic_ids, claim_bytes)
    assert records.decode(records.encode(records.RELEASE, number)) == (records.RELEASE, number, (), 0)


def test_every_record_has_one_size() -> None:
    every = [
        records.encode(records.WATCH, 1, (100,), 512),
        records.encode(records.RELEASE, 1),
        records.encode(records.PING),
        records.encode(records.GOODBYE),
    ]
    assert len({len(record) for record in every}) == 1
    assert [records.decode(record)[0] for record in every] == [b"W", b"R", b"P", b"G"]


@given(st.sets(NUMBERS))
def test_beat_names_the_links_that_may_move(driven: set[int]) -> None:
    record = records.encode_beat(driven)
    assert record[:1] == records.BEAT
    assert set(records.decode_beat(record) or ()) == driven


def test_beat_with_too_many_links_means_all_and_fits_the_record() -> None:
    most = set(range(records.MAX_DRIVEN))
    assert set(records.decode_beat(records.encode_beat(most)) or ()) == most
    for surplus in (1, 100):
        record = records.encode_beat(most | {10_000 + number for number in range(surplus)})
        assert records.decode_beat(record) is None
        assert len(record) <= records.MAX_RECORD_BYTES


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
def test_answer_counts_the_connections_and_the_stopped_robots(connections: int, stopped: int) -> None:
    assert records.decode_answer(records.encode_answer(connections, stopped)) == (connections, stopped)
