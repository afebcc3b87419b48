"""CaptureBuffer: the last bytes of one direction of a link with the times at which they passed. Pure: time comes in."""

import heapq
from array import array
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

CAPTURE_BYTES = 65536  # 17 s of a full 38400 baud line, minutes of a robot's usual traffic
_SLACK_BYTES = CAPTURE_BYTES // 4  # more than that is trimmed at once, so that it costs next to nothing a byte
_MAX_PIECES = 4096  # the times then take as much memory as the bytes
_JOINED_BYTES = 64  # what neighbours may share a time for: at most 2560 pieces are left then


class Piece(NamedTuple):
    """Bytes that passed together; `end` counts the bytes of the direction up to and with its last one."""

    time_s: float
    end: int
    data: bytes


class CaptureBuffer:
    """The last CAPTURE_BYTES and a little more. Of very many pieces, small neighbours share the earlier time."""

    def __init__(self) -> None:
        self.total_bytes = 0
        self._data = bytearray()
        self._times = array("d")
        self._ends = array("Q")

    def add(self, data: bytes, now_s: float) -> None:
        """Add what passed just now."""
        if not data:
            return
        self.total_bytes += len(data)
        self._data += data
        self._times.append(now_s)
        self._ends.append(self.total_bytes)
        if len(self._data) > CAPTURE_BYTES + _SLACK_BYTES:
            self._trim()
        if len(self._times) >= _MAX_PIECES:
            self._join()

    def pieces(self, since: int = 0) -> Iterator[Piece]:
        """The pieces after the first `since` bytes of the direction, oldest first; what is lost is left out."""
        base = self.total_bytes - len(self._data)
        begin = max(since, base)
        for number in range(bisect_right(self._ends, begin), len(self._ends)):
            end = self._ends[number]
            yield Piece(self._times[number], end, bytes(self._data[begin - base : end - base]))
            begin = end

    def lost_bytes(self, since: int = 0) -> int:
        """How many bytes after the first `since` are not in the buffer any more."""
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

    def _trim(self) -> None:
        del self._data[:-CAPTURE_BYTES]
        gone = bisect_right(self._ends, self.total_bytes - CAPTURE_BYTES)
        del self._times[:gone]
        del self._ends[:gone]


class CapturedPiece(NamedTuple):
    """Bytes that passed together, in one direction."""

    time_s: float
    is_from_device: bool
    data: bytes


@dataclass(frozen=True, slots=True)
class Captured:
    """What passed on a link after a position, in order of time."""

    pieces: tuple[CapturedPiece, ...]
    position: tuple[int, int]  # bytes from the device and to it, up to here
    lost_bytes: int  # after the position, and not kept


def captured(from_device: CaptureBuffer, to_device: CaptureBuffer, since: tuple[int, int]) -> Captured:
    """Both directions after the first `since` bytes of each."""
    pieces = heapq.merge(
        (CapturedPiece(piece.time_s, True, piece.data) for piece in from_device.pieces(since[0])),
        (CapturedPiece(piece.time_s, False, piece.data) for piece in to_device.pieces(since[1])),
        key=lambda piece: piece.time_s,
    )
    position = (from_device.total_bytes, to_device.total_bytes)
    return Captured(tuple(pieces), position, from_device.lost_bytes(since[0]) + to_device.lost_bytes(since[1]))
