"""CaptureBuffer: the last 64 KiB with their times, in bounded memory."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.link.capture_buffer import (
    ALL_BYTES,
    CAPTURE_BYTES,
    LEAST_BYTES,
    CaptureBuffer,
    CaptureRoom,
    captured,
)
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.protocol.rosserial.session import Session


def contents(buffer: CaptureBuffer, since: int = 0) -> bytes:
    return b"".join(piece.data for piece in buffer.pieces(since))


def test_capture_returns_the_bytes_with_their_times() -> None:
    buffer = CaptureBuffer(CaptureRoom())
    buffer.add(b"abc", 1.0)
    buffer.add(b"", 1.5)
    buffer.add(b"de", 2.0)
    assert list(buffer.pieces()) == [(1.0, 3, b"abc"), (2.0, 5, b"de")]
    assert list(buffer.pieces(4)) == [(2.0, 5, b"e")]
    assert list(buffer.pieces(5)) == []
    assert buffer.lost_bytes() == 0


@given(st.lists(st.integers(0, 3 * CAPTURE_BYTES), max_size=6), st.integers(0, 9 * CAPTURE_BYTES))
def test_buffer_keeps_the_newest_bytes(sizes: list[int], since: int) -> None:
    buffer, passed = CaptureBuffer(CaptureRoom()), b""
    for number, size in enumerate(sizes):
        data = bytes([number]) * size
        buffer.add(data, float(number))
        passed += data
    kept = contents(buffer)
    assert len(kept) >= min(len(passed), CAPTURE_BYTES)
    assert len(kept) <= 1.25 * CAPTURE_BYTES
    assert passed.endswith(kept)
    assert buffer.total_bytes == len(passed)
    assert contents(buffer, since) == passed[max(since, len(passed) - len(kept)) :]
    assert buffer.lost_bytes(since) == max(0, len(passed) - len(kept) - since)


def test_many_links_divide_the_room_and_a_buffer_is_trimmed_to_its_part() -> None:
    room = CaptureRoom()
    buffer = CaptureBuffer(room)
    buffer.add(bytes(CAPTURE_BYTES), 1.0)
    room.divide(1000)
    assert 2 * 1000 * room.bytes <= ALL_BYTES
    buffer.add(b"new", 2.0)
    assert len(contents(buffer)) == room.bytes < CAPTURE_BYTES
    assert contents(buffer).endswith(b"new")
    assert buffer.lost_bytes() == CAPTURE_BYTES + 3 - room.bytes
    room.divide(1_000_000)
    assert room.bytes == LEAST_BYTES
    for links in (0, 1, 128):
        room.divide(links)
        assert room.bytes == CAPTURE_BYTES


def test_single_bytes_are_kept_with_few_ordered_times() -> None:
    buffer = CaptureBuffer(CaptureRoom())
    for number in range(3 * CAPTURE_BYTES):
        buffer.add(bytes([number & 0xFF]), number / 1000)
    pieces = list(buffer.pieces())
    assert len(contents(buffer)) >= CAPTURE_BYTES
    assert len(pieces) <= 4096
    times = [piece.time_s for piece in pieces]
    assert times == sorted(times)
    for piece in pieces:
        first = piece.end - len(piece.data)
        assert 0 <= first / 1000 - piece.time_s <= 0.1  # neighbours share the earlier time, never a later one


def both(data: bytes, size: int) -> tuple[CaptureBuffer, CaptureBuffer]:
    from_device, to_device = CaptureBuffer(CaptureRoom()), CaptureBuffer(CaptureRoom())
    for number, at in enumerate(range(0, len(data), size)):
        from_device.add(data[at : at + size], float(number))
    return from_device, to_device


@given(st.integers(1, 2000), st.integers(0, 900))
def test_capture_with_lost_bytes_starts_with_a_whole_frame(size: int, payload_bytes: int) -> None:
    frame = encode(125, bytes(payload_bytes))
    found = captured(
        *both(frame * (3 * CAPTURE_BYTES // len(frame)), size),
        since=(0, 0),
        rest_of_frame_bytes=Session(check=lambda _: None).rest_of_frame_bytes,
    )
    kept = b"".join(piece.data for piece in found.pieces)
    assert found.lost[0] > 0
    assert kept == frame * (len(kept) // len(frame))
    assert len(kept) >= CAPTURE_BYTES - len(frame)


def test_bytes_without_frames_are_kept() -> None:
    found = captured(
        *both(b"speed 1\r\n" * CAPTURE_BYTES, 512),
        since=(0, 0),
        rest_of_frame_bytes=Session(check=lambda _: None).rest_of_frame_bytes,
    )
    assert sum(len(piece.data) for piece in found.pieces) >= CAPTURE_BYTES


def test_capture_with_its_beginning_has_every_byte() -> None:
    found = captured(
        *both(b"boot\n" + encode(125, b"1"), 3),
        since=(0, 0),
        rest_of_frame_bytes=Session(check=lambda _: None).rest_of_frame_bytes,
    )
    assert b"".join(piece.data for piece in found.pieces) == b"boot\n" + encode(125, b"1")
    assert found.lost_bytes == 0
