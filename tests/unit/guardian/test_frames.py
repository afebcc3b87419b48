"""Frames to a robot whose daemon is gone. tests/property/test_guardian_frames.py tests how devices read them."""

import pytest

from hostlink.guardian.frames import INTERVAL_S, STOP_REQUEST, StopWriter, stop_sequence, zero_frame
from hostlink.protocol import frame
from hostlink.protocol.frame import encode

BUFFER_BYTES = 512


@pytest.mark.parametrize("topic_id", [100, 101, 124, 255, 256, 511, 0x1234, 0xFFFF])
def test_zero_frame_equals_the_frame_of_the_protocol_package(topic_id: int) -> None:
    assert zero_frame(topic_id) == encode(topic_id, bytes(48))


def test_stop_request_equals_that_of_the_protocol_package() -> None:
    assert STOP_REQUEST == frame.STOP_REQUEST


def test_stop_sequence_has_three_zeros_50_ms_apart_then_id_11() -> None:
    times, parts = zip(*stop_sequence((100,), 0), strict=True)
    assert times == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert list(parts) == [zero_frame(100)] * 3 + [STOP_REQUEST]


def test_stop_sequence_for_a_hanging_daemon_has_no_stop_request() -> None:
    assert stop_sequence((100,), 57, is_end=False) == stop_sequence((100,), 57)[:-1]


@pytest.mark.parametrize("claim_bytes", [1, 56, 57, 58, 114, 512, 65543])
def test_first_zero_is_repeated_over_the_length_of_any_frame(claim_bytes: int) -> None:
    first, *others = [part for _, part in stop_sequence((100,), claim_bytes)]
    assert first.removeprefix(zero_frame(100)).replace(b"\0" + zero_frame(100), b"") == b""
    assert claim_bytes <= len(first) - 2 * 57 + 1 < claim_bytes + 57
    assert others == [zero_frame(100)] * 2 + [STOP_REQUEST]


def test_unaccepted_bytes_are_kept_in_order() -> None:
    writer, sent = StopWriter((100,), BUFFER_BYTES), b""
    for step in range(1000):
        part = writer.pop_due(step / 1000)[:3]
        writer.written(len(part))
        sent += part
    assert sent == b"".join(part for _, part in stop_sequence((100,), BUFFER_BYTES))
    assert writer.is_done()
    assert writer.next_s() is None


def test_writer_returns_the_time_of_the_next_part() -> None:
    writer = StopWriter((100,), 0)
    assert not writer.is_done()
    assert writer.pop_due(0.0) == zero_frame(100)
    assert writer.next_s() == INTERVAL_S
    writer.written(56)
    assert writer.pop_due(INTERVAL_S - 0.001) == b""
    assert not writer.is_done()
