"""Records between daemon and guardian, encoded and decoded."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.guardian import records
from hostlink.core.runtime.stop_frames import StopFrames
from tests.support.rosserial_stop import rosserial_stop

NUMBERS = st.integers(0, 2**64 - 1)


FRAMES = st.lists(st.binary(min_size=1, max_size=200), max_size=16).map(tuple)
STOPS = st.builds(
    StopFrames,
    FRAMES,
    st.binary(max_size=20),
    claim_bytes=st.integers(0, 2**32 - 1),
    lead=st.binary(max_size=4),
    separator=st.binary(max_size=2),
    interval_s=st.floats(0.01, 1.0),
    acknowledger=st.text(max_size=50),
)


@given(NUMBERS, STOPS)
def test_encoded_record_is_decoded(number: int, stop: StopFrames) -> None:
    record = records.encode(records.WATCH, number, stop)
    assert records.decode(record) == (records.WATCH, number, stop)
    for kind in (records.RELEASE, records.PING, records.GOODBYE):
        assert records.decode(records.encode(kind, number)) == (kind, number, StopFrames())


@given(FRAMES, st.binary(max_size=20), st.data())
def test_record_cut_anywhere_is_not_decoded(zeros: tuple[bytes, ...], end: bytes, data: st.DataObject) -> None:
    record = records.encode(records.WATCH, 1, rosserial_stop(zeros, 512, end))
    size_bytes = data.draw(st.integers(0, len(record) - 1))
    with pytest.raises(struct.error):
        records.decode(record[:size_bytes])


@given(st.lists(st.integers(1, 70_000), max_size=24), st.integers(0, 5000))
def test_frames_that_fit_are_kept_in_order_and_the_record_fits_the_buffer(sizes: list[int], end_bytes: int) -> None:
    zeros = tuple(bytes(size) for size in sizes)
    stop = records.fitting(rosserial_stop(zeros, 512, bytes(end_bytes)))
    fitted, end, each = stop.zeros, stop.end, iter(zeros)
    assert all(frame in each for frame in fitted)
    assert stop == rosserial_stop(fitted, 512, end)
    assert len(records.encode(records.WATCH, 1, stop)) <= records.MAX_RECORD_BYTES
    room_bytes = records.MAX_FRAMES_BYTES - sum(len(frame) + 2 for frame in fitted)
    assert room_bytes >= 0
    assert end in {bytes(end_bytes), b""}
    left_out = list(sizes)
    for frame in fitted:
        left_out.remove(len(frame))
    assert all(size + 2 > room_bytes for size in left_out)
    assert bool(end) == (0 < end_bytes <= room_bytes - 2)


def test_a_frame_that_is_too_long_takes_no_room_from_the_others() -> None:
    def fitting(*frames: bytes) -> StopFrames:
        return records.fitting(StopFrames(frames, b"e"))

    assert fitting(b"a", bytes(5000), b"b") == StopFrames((b"a", b"b"), b"e")
    assert fitting(bytes(4095), bytes(4094), b"b") == StopFrames((bytes(4094),), b"")


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
