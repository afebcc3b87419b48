"""Frames to a robot whose daemon is gone. tests/property/test_guardian_frames.py tests how devices read them."""

import pytest

from hostlink.core.guardian.frames import INTERVAL_S, LEAD, StopWriter, packed, stop_sequence
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, encode

BUFFER_BYTES = 512
ZERO = encode(100, bytes(48))
SHORT = encode(101, bytes(4))


def test_stop_sequence_has_three_zeros_50_ms_apart_then_the_end() -> None:
    times, parts = zip(*stop_sequence((ZERO,), 0, STOP_REQUEST), strict=True)
    assert times == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert list(parts) == [ZERO] * 3 + [STOP_REQUEST]


def test_stop_sequence_without_an_end_is_over_after_the_zeros() -> None:
    assert stop_sequence((ZERO,), 57) == stop_sequence((ZERO,), 57, STOP_REQUEST)[:-1]


@pytest.mark.parametrize("zeros", [(ZERO,), (SHORT,), (ZERO, SHORT), (SHORT,) * 16], ids=["48", "4", "48+4", "16x4"])
@pytest.mark.parametrize("claim_bytes", [1, 56, 57, 58, 114, 512, 65543])
def test_first_zeros_are_repeated_over_the_length_of_any_frame(claim_bytes: int, zeros: tuple[bytes, ...]) -> None:
    first, *others = [part for _, part in stop_sequence(zeros, claim_bytes, STOP_REQUEST)]
    once = b"\0".join(zeros)
    again_bytes = len(once) + 1
    assert first.startswith(LEAD + once)
    first = first.removeprefix(LEAD)
    assert first.removeprefix(once).replace(b"\0" + once, b"") == b""
    assert claim_bytes <= len(first) - 2 * again_bytes + 1 < claim_bytes + again_bytes
    assert others == [once] * 2 + [STOP_REQUEST]


def test_a_device_without_zeros_gets_its_end_after_the_length_of_any_frame() -> None:
    assert stop_sequence((), 3, STOP_REQUEST) == [(0.0, LEAD + bytes(4)), (pytest.approx(0.15), STOP_REQUEST)]


def test_parts_have_whole_frames_and_are_as_few_as_the_limit_allows() -> None:
    frames = (bytes(4), bytes(4), bytes(5), bytes(20), bytes(1))
    assert packed(frames, 9) == [bytes(9), bytes(5), bytes(20), bytes(1)]
    assert packed(frames, 8) == [bytes(4), bytes(4), bytes(5), bytes(20), bytes(1)]
    assert packed((), 8) == []


def test_unaccepted_bytes_are_kept_in_order() -> None:
    writer, sent = StopWriter((ZERO, SHORT), BUFFER_BYTES, STOP_REQUEST), b""
    for step in range(1000):
        part = writer.pop_due(step / 1000)[:3]
        if part:
            writer.written(len(part))
        sent += part
    assert sent == b"".join(part for _, part in stop_sequence((ZERO, SHORT), BUFFER_BYTES, STOP_REQUEST))
    assert writer.is_done()
    assert writer.next_s() is None


def test_writer_returns_the_time_of_the_next_part() -> None:
    writer = StopWriter((ZERO,), 0, STOP_REQUEST)
    assert not writer.is_done()
    assert writer.pop_due(0.0) == ZERO
    assert writer.next_s() == INTERVAL_S
    writer.written(56)
    assert writer.pop_due(INTERVAL_S - 0.001) == b""
    assert not writer.is_done()


def test_parts_that_are_late_are_written_one_after_the_other() -> None:
    writer = StopWriter((ZERO,), 0, STOP_REQUEST)
    assert writer.pop_due(1.0) == ZERO
    assert writer.next_s() is None
    for expected in (ZERO, ZERO, STOP_REQUEST):
        writer.written(len(writer.pop_due(1.0)))
        assert writer.pop_due(1.0) == expected
    assert writer.has_waiting
