"""What a robot is sent when its daemon is gone; what devices make of it: tests/property/test_guardian_frames.py."""

import pytest

from hostlink.guardian.frames import INTERVAL_S, STOP_REQUEST, StopWriter, stop_sequence, zero_frame
from hostlink.protocol import frame
from hostlink.protocol.frame import encode

BUFFER_BYTES = 512


@pytest.mark.parametrize("topic_id", [100, 101, 124, 255, 256, 511, 0x1234, 0xFFFF])
def test_the_zero_is_the_frame_that_the_daemon_would_send(topic_id: int) -> None:
    assert zero_frame(topic_id) == encode(topic_id, bytes(48))


def test_the_request_to_fall_silent_is_the_daemons() -> None:
    assert STOP_REQUEST == frame.STOP_REQUEST


def test_zeros_at_three_times_50_ms_apart_then_id_11() -> None:
    times, parts = zip(*stop_sequence((100,), 0), strict=True)
    assert times == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert list(parts) == [zero_frame(100)] * 3 + [STOP_REQUEST]


def test_a_daemon_that_may_go_on_leaves_its_devices_talking() -> None:
    assert stop_sequence((100,), 57, is_end=False) == stop_sequence((100,), 57)[:-1]


@pytest.mark.parametrize("claim_bytes", [1, 56, 57, 58, 114, 512, 65543])
def test_the_first_zero_is_repeated_over_the_length_of_any_frame(claim_bytes: int) -> None:
    first, *others = [part for _, part in stop_sequence((100,), claim_bytes)]
    assert first.removeprefix(zero_frame(100)).replace(b"\0" + zero_frame(100), b"") == b""
    assert claim_bytes <= len(first) - 2 * 57 + 1 < claim_bytes + 57
    assert others == [zero_frame(100)] * 2 + [STOP_REQUEST]


def test_what_a_connection_does_not_accept_is_kept_in_order() -> None:
    writer, sent = StopWriter((100,), BUFFER_BYTES), b""
    for step in range(1000):
        part = writer.pop_due(step / 1000)[:3]
        writer.written(len(part))
        sent += part
    assert sent == b"".join(part for _, part in stop_sequence((100,), BUFFER_BYTES))
    assert writer.is_done()
    assert writer.next_s() is None


def test_the_writer_knows_when_there_is_more() -> None:
    writer = StopWriter((100,), 0)
    assert not writer.is_done()
    assert writer.pop_due(0.0) == zero_frame(100)
    assert writer.next_s() == INTERVAL_S
    writer.written(56)
    assert writer.pop_due(INTERVAL_S - 0.001) == b""
    assert not writer.is_done()
