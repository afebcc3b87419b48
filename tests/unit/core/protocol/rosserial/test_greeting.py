"""Recognition of a device's datagram by a whole frame in it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import MAX_HEADS, has_frame
from hostlink.core.protocol.rosserial.stream import FrameStream

TIME = encode(Id.TIME, bytes(8))


@given(st.integers(0, 0xFFFF), st.binary(max_size=300), st.binary(max_size=20), st.binary(max_size=20))
def test_whole_frame_is_found_at_any_offset(topic_id: int, payload: bytes, before: bytes, after: bytes) -> None:
    assert has_frame(before + encode(topic_id, payload) + after)


@pytest.mark.parametrize("frame", [TIME, TOPICS_REQUEST, encode(125, bytes(range(24)))])
def test_partial_or_damaged_frame_is_not_found(frame: bytes) -> None:
    for end in range(len(frame)):
        assert not has_frame(frame[:end])
    for at in range(len(frame)):
        assert not has_frame(frame[:at] + bytes([frame[at] ^ 1]) + frame[at + 1 :])


@given(st.binary(max_size=200))
def test_has_frame_agrees_with_the_stream(data: bytes) -> None:
    is_frame = any(isinstance(item, Frame) for item in FrameStream().feed(data))
    assert has_frame(data) == is_frame


def test_has_frame_examines_a_bounded_number_of_starts() -> None:
    heads = b"\xff\xfe" * MAX_HEADS
    assert has_frame(heads[2:] + TIME)
    assert not has_frame(heads + TIME)


def test_empty_data_has_no_frame() -> None:
    assert not has_frame(b"")
