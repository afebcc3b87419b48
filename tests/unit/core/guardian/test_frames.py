"""Frames to a robot whose daemon is gone. tests/property/test_guardian_frames.py tests how devices read them."""

import pytest

from hostlink.core.guardian.frames import StopWriter, packed, stop_sequence
from hostlink.core.protocol.rosserial.frame import LEAD, SEPARATOR, STOP_REQUEST, encode
from hostlink.core.runtime.stop_frames import INTERVAL_S, StopFrames
from tests.support.rosserial_stop import rosserial_stop

BUFFER_BYTES = 512
ZERO = encode(100, bytes(48))
SHORT = encode(101, bytes(4))


def test_stop_sequence_has_three_zeros_50_ms_apart_then_the_end() -> None:
    times, parts = zip(*stop_sequence(rosserial_stop((ZERO,))), strict=True)
    assert times == pytest.approx([0.0, 0.05, 0.1, 0.15])
    assert list(parts) == [ZERO] * 3 + [STOP_REQUEST]


def test_stop_sequence_without_an_end_is_over_after_the_zeros() -> None:
    assert stop_sequence(rosserial_stop((ZERO,), 57), has_end=False) == stop_sequence(rosserial_stop((ZERO,), 57))[:-1]


@pytest.mark.parametrize("zeros", [(ZERO,), (SHORT,), (ZERO, SHORT), (SHORT,) * 16], ids=["48", "4", "48+4", "16x4"])
@pytest.mark.parametrize("claim_bytes", [1, 56, 57, 58, 114, 512, 65543])
def test_first_zeros_are_repeated_over_the_length_of_any_frame(claim_bytes: int, zeros: tuple[bytes, ...]) -> None:
    first, *others = [part for _, part in stop_sequence(rosserial_stop(zeros, claim_bytes))]
    once = b"\0".join(zeros)
    again_bytes = len(once) + 1
    assert first.startswith(LEAD + once)
    first = first.removeprefix(LEAD)
    assert first.removeprefix(once).replace(b"\0" + once, b"") == b""
    assert claim_bytes <= len(first) - 2 * again_bytes + 1 < claim_bytes + again_bytes
    assert others == [once] * 2 + [STOP_REQUEST]


def test_a_device_without_zeros_gets_its_end_after_the_length_of_any_frame() -> None:
    assert stop_sequence(rosserial_stop((), 3)) == [(0.0, LEAD + bytes(4)), (pytest.approx(0.15), STOP_REQUEST)]


def test_parts_have_whole_frames_and_are_as_few_as_the_limit_allows() -> None:
    frames = (bytes(4), bytes(4), bytes(5), bytes(20), bytes(1))
    assert packed(frames, SEPARATOR, 9) == [bytes(9), bytes(5), bytes(20), bytes(1)]
    assert packed(frames, SEPARATOR, 8) == [bytes(4), bytes(4), bytes(5), bytes(20), bytes(1)]
    assert packed((), SEPARATOR, 8) == []


def test_unaccepted_bytes_are_kept_in_order() -> None:
    writer, sent = StopWriter(rosserial_stop((ZERO, SHORT), BUFFER_BYTES)), b""
    for step in range(1000):
        part = writer.pop_due(step / 1000)[:3]
        if part:
            writer.written(len(part))
        sent += part
    assert sent == b"".join(part for _, part in stop_sequence(rosserial_stop((ZERO, SHORT), BUFFER_BYTES)))
    assert writer.is_done()
    assert writer.next_s() is None


def test_writer_returns_the_time_of_the_next_part() -> None:
    writer = StopWriter(rosserial_stop((ZERO,)))
    assert not writer.is_done()
    assert writer.pop_due(0.0) == ZERO
    assert writer.next_s() == INTERVAL_S
    writer.written(56)
    assert writer.pop_due(INTERVAL_S - 0.001) == b""
    assert not writer.is_done()


def test_parts_that_are_late_are_written_one_after_the_other() -> None:
    writer = StopWriter(rosserial_stop((ZERO,)))
    assert writer.pop_due(1.0) == ZERO
    assert writer.next_s() is None
    for expected in (ZERO, ZERO, STOP_REQUEST):
        writer.written(len(writer.pop_due(1.0)))
        assert writer.pop_due(1.0) == expected
    assert writer.has_waiting


def test_answers_precede_zeros_and_are_dropped_while_the_device_reads_nothing() -> None:
    writer = StopWriter(StopFrames((b"zero", b"other")))
    assert writer.pop_due(0.0) == b"zero"
    writer.answer([b"answer"])
    sent = []
    while part := writer.pop_due(0.0):
        sent.append(part)
        writer.written(len(part))
    writer.answer([])
    assert not writer.has_waiting
    writer.answer([b"answer", b"second"])
    while part := writer.pop_due(0.0):
        sent.append(part)
        writer.written(len(part))
    assert sent == [b"zero", b"other", b"answer", b"second", b"zero", b"other"]


def test_zeros_are_repeated_at_the_interval_that_the_protocol_wants() -> None:
    sequence = stop_sequence(StopFrames((b"zero",), b"end", interval_s=0.12))
    assert [at_s for at_s, _ in sequence] == pytest.approx([0.0, 0.12, 0.24, 0.36])
