"""CaptureBuffer: the last bytes of one direction of a link, with their times. Pure; times are arguments.

When older bytes were dropped, a capture starts with a whole frame.
"""

import heapq
from array import array
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

CAPTURE_BYTES = 65536  # 17 s of a fully used 38400 baud line, minutes of a robot's usual traffic
LEAST_BYTES = 4096  # of each buffer, however many there are
ALL_BYTES = 16 * 1024 * 1024  # of all links in both directions: 128 links keep CAPTURE_BYTES each way
_SLACK = 4  # trimmed in steps of this part, so that trimming costs little for each byte
_MAX_PIECES = 4096  # their times need as much memory as the bytes
_JOINED_BYTES = 64  # neighbours up to this size share one time, which leaves at most 2560 pieces


class Piece(NamedTuple):
    """Bytes that passed together. `end` is the position of the last byte in the direction's stream, counted from 1."""

    time_s: float
    end: int
    data: bytes


class CaptureRoom:
    """Size of the buffers of all links: CAPTURE_BYTES each, or less where ALL_BYTES do not suffice for so many."""

    __slots__ = ("bytes",)

    def __init__(self) -> None:
        self.bytes = CAPTURE_BYTES

    def divide(self, links: int) -> None:
        """Divide the room among so many links. A larger buffer is trimmed when bytes are added to it."""
        self.bytes = min(CAPTURE_BYTES, max(LEAST_BYTES, ALL_BYTES // (2 * max(1, links))))


class CaptureBuffer:
    """Ring buffer of about `room.bytes`. Of very many pieces, small neighbours share the earlier time."""

    __slots__ = ("_data", "_ends", "_room", "_times", "total_bytes")

    def __init__(self, room: CaptureRoom) -> None:
        self._room = room
        self.total_bytes = 0
        self._data = bytearray()
        self._times = array("d")
        self._ends = array("Q")

    def add(self, data: bytes, now_s: float) -> None:
        """Add bytes that passed at `now_s`."""
        if not data:
            return
        self.total_bytes += len(data)
        self._data += data
        self._times.append(now_s)
        self._ends.append(self.total_bytes)
        most_bytes = self._room.bytes
        if len(self._data) > most_bytes + most_bytes // _SLACK:
            self._trim(most_bytes)
        if len(self._times) >= _MAX_PIECES:
            self._join()

    def pieces(self, since: int = 0) -> Iterator[Piece]:
        """Yield the pieces after the first `since` bytes of the direction, oldest first, as far as they are kept."""
        base = self.total_bytes - len(self._data)
        begin = max(since, base)
        for number in range(bisect_right(self._ends, begin), len(self._ends)):
            end = self._ends[number]
            yield Piece(self._times[number], end, bytes(self._data[begin - base : end - base]))
            begin = end

    def lost_bytes(self, since: int = 0) -> int:
        """Number of bytes after the first `since` that are no longer kept."""
        return max(0, self.total_bytes - len(self._data) - since)

    def _join(self) -> None:
        times, ends = array("d"), array("Q")
        begin = end_before = self.total_bytes - len(self._data)
        for time_s, end in zip(self._times, self._ends, strict=True):
            if ends and end - begin <= _JOINED_BYTES:
                ends[-1] = end
            else:
                begin = end_before
                times.append(time_s)
                ends.append(end)
            end_before = end
        self._times, self._ends = times, ends

    def _trim(self, size_bytes: int) -> None:
        del self._data[:-size_bytes]
        gone = bisect_right(self._ends, self.total_bytes - size_bytes)
        del self._times[:gone]
        del self._ends[:gone]


class CapturedPiece(NamedTuple):
    """Bytes that passed together in one direction."""

    time_s: float
    is_from_device: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class Captured:
    """Traffic of a link after a position, in order of time."""

    pieces: tuple[CapturedPiece, ...]
    position: tuple[int, int]  # bytes from the device and to it at the end of the capture
    lost: tuple[int, int]  # bytes after the position that are no longer kept, from the device and to it

    @property
    def lost_bytes(self) -> int:
        """Lost bytes of both directions."""
        return sum(self.lost)


def captured(
    from_device: CaptureBuffer,
    to_device: CaptureBuffer,
    since: tuple[int, int],
    rest_of_frame_bytes: Callable[[Iterable[bytes]], int],
) -> Captured:
    """Merge both directions after the first `since` bytes of each.

    `rest_of_frame_bytes` returns how many bytes precede the first whole frame of bytes whose beginning is lost.
    """
    pieces = heapq.merge(
        (
            CapturedPiece(each.time_s, True, each.data)
            for each in _whole_frames(from_device, since[0], rest_of_frame_bytes)
        ),
        (
            CapturedPiece(each.time_s, False, each.data)
            for each in _whole_frames(to_device, since[1], rest_of_frame_bytes)
        ),
        key=lambda piece: piece.time_s,
    )
    position = (from_device.total_bytes, to_device.total_bytes)
    return Captured(tuple(pieces), position, (from_device.lost_bytes(since[0]), to_device.lost_bytes(since[1])))


def _whole_frames(
    buffer: CaptureBuffer, since: int, rest_of_frame_bytes: Callable[[Iterable[bytes]], int]
) -> Iterable[Piece]:
    """Return the pieces without the rest of a cut frame, which a reader would take for damage on the wire."""
    pieces = list(buffer.pieces(since))
    cut_bytes = rest_of_frame_bytes(piece.data for piece in pieces) if buffer.lost_bytes(since) else 0
    for piece in pieces:
        if cut_bytes < len(piece.data):
            yield piece._replace(data=piece.data[cut_bytes:])
        cut_bytes = max(0, cut_bytes - len(piece.data))
