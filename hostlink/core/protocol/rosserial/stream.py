"""FrameStream: parser of rosserial frames. It yields frames and skipped bytes, however the reads were cut."""

from bisect import bisect_left, insort
from collections import Counter, OrderedDict
from collections.abc import Iterator, Mapping
from enum import Enum
from heapq import heappop, heappush
from typing import NamedTuple

from hostlink.core.protocol.rosserial.frame import (
    HEADER,
    MAX_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    SYNC,
    SYNC_WORD,
    Frame,
    byte_sum,
)

MAX_CLAIMED_BYTES = 4 * (MAX_PAYLOAD_BYTES + OVERHEAD_BYTES)  # limits what one received byte can complete
DEFAULT_LIMIT_BYTES = 1024  # twice rosserial's usual buffer; limit of a length field before topics are known
new_frame = tuple.__new__  # twice as fast as Frame(...)
_SUM_IS_RIGHT = 0xFF  # payload and checksum sum to 255 modulo 256


class Skipped(NamedTuple):
    """Bytes that belong to no frame."""

    data: bytes


class Rejection(Enum):
    """Reason why a sync was not the start of a frame."""

    LENGTH_CHECKSUM = "length_checksum"
    TOO_LONG = "too_long"
    TOO_MANY = "too_many"
    CHECKSUM = "checksum"
    WRONG_SIZE = "wrong_size"
    INCOMPLETE = "incomplete"


class FrameStream:
    """Parser of frames in a stream in which bytes may be damaged, missing or not rosserial.

    Every sync with a correct length checksum and a length within the limit is a *candidate*. The candidate that is
    complete and correct first wins, even when another one began before it. A damaged header that claims a kilobyte
    therefore neither hides the frames inside that kilobyte nor delays them, and the result does not depend on how the
    bytes were cut. The bytes before the winner are skipped. No byte is lost: frames + skipped + pending = input.

    | head of the buffer              | result                                             |
    |---------------------------------|----------------------------------------------------|
    | no sync                         | skipped up to the next possible sync               |
    | candidate, correct, none inside | frame                                              |
    | candidate, incomplete           | waits; each candidate inside it is followed too    |
    | candidate, complete and wrong   | not a candidate any longer: its bytes are re-read  |

    `rejected` counts the false starts among the skipped bytes. A payload may contain a sync. When the frame around it
    is correct, the sync is not counted, because nothing was lost.

    MAX_CLAIMED_BYTES bounds the sum of all candidates' lengths, because one byte can complete all of them. Above the
    bound, the candidate that ends last is dropped (`too_many`). With a limit of 1024 bytes the bound is never reached.
    """

    __slots__ = (
        "_base", "_candidates", "_claimed_bytes", "_ends", "_false_starts", "_fixed_bytes", "_searched", "_taken",
        "limit_bytes", "pending", "rejected",
    )  # fmt: skip

    def __init__(self, *, limit_bytes: int = DEFAULT_LIMIT_BYTES, fixed_bytes: Mapping[int, int] | None = None) -> None:
        """`limit_bytes`: largest payload length in a header; `fixed_bytes`: id -> its only valid payload size."""
        self.limit_bytes = limit_bytes
        self.rejected: Counter[Rejection] = Counter()
        self._fixed_bytes: Mapping[int, int] = {} if fixed_bytes is None else fixed_bytes
        self.pending = bytearray()  # bytes that are neither part of a frame nor skipped yet, after `feed`
        self._taken = 0  # bytes at the head that were yielded as frames, and are not dropped yet
        self._base = 0  # stream offset of the first buffered byte
        self._candidates: OrderedDict[int, int] = OrderedDict()  # start -> end of the undecided candidates, by start
        self._ends: list[tuple[int, int]] = []  # (end, start) of the same candidates, sorted by end
        self._claimed_bytes = 0  # sum of the candidates' lengths
        self._false_starts: list[tuple[int, str]] = []  # heap of (start, Rejection) in the buffer
        self._searched = 0  # stream offset up to which every sync was checked

    def feed(self, data: bytes) -> Iterator[Frame | Skipped]:
        """Add bytes and yield what they complete.

        The iterator is lazy, so that a change of the limit or of the sizes after one frame applies to the next.
        """
        buffer, unpack = self.pending, HEADER.unpack_from
        if self._taken:  # the caller of the last `feed` stopped iterating; `finally` would need its generator's end
            self._drop(self._taken)
        is_short = len(data) < len(buffer)  # a copy of the buffer would cost more than linear work
        buffer += data
        source = buffer if is_short else bytes(buffer)  # slicing bytes is faster
        while source:
            at, last = 0, len(source) - OVERHEAD_BYTES  # last possible start of a frame
            while at <= last:  # fast path: frames at the head that are complete, correct and without a sync inside
                sync, size, check, topic_id = unpack(source, at)
                end = at + size + OVERHEAD_BYTES
                if (
                    sync != SYNC_WORD
                    or size > last - at
                    or size > self.limit_bytes
                    or (size + (size >> 8) + check) & 0xFF != _SUM_IS_RIGHT
                    or source.find(SYNC, at + 2, end) >= 0
                    or byte_sum(source[at + 5 : end]) & 0xFF != _SUM_IS_RIGHT
                    or self._fixed_bytes.get(topic_id, size) != size
                ):
                    break
                frame = new_frame(Frame, (topic_id, bytes(source[at + 7 : end - 1])))
                at = self._taken = end
                yield frame
            if at:
                self._drop(at)
            source = buffer
            if buffer:
                event = self._contested()
                if event is None:
                    return
                yield event

    def give_up(self) -> Iterator[Frame | Skipped]:
        """Stop waiting for the frame at the head. Read again from the byte after it."""
        if self._taken:
            self._drop(self._taken)
        if self.pending:
            self._reject(self._base, Rejection.INCOMPLETE)
            end = self._candidates.get(self._base)
            if end is not None:
                self._remove_candidate(bisect_left(self._ends, (end, self._base)))
            self._searched = max(self._searched, self._base + 1)
        return self.feed(b"")

    def _contested(self) -> Frame | Skipped | None:
        """Return the next event where the head is noise, incomplete or has a sync inside.

        None: more bytes are needed.
        """
        while True:
            self._search()
            if not self._ends or self._ends[0][0] > self._base + len(self.pending):
                break
            end, start = self._remove_candidate(0)
            if not self._is_right(start - self._base, end - self._base):
                continue
            if start > self._base:
                self._forget_candidates()
                self._add_candidate(start, end)
                return self._skip(start)
            payload = bytes(self.pending[7 : end - self._base - 1])
            frame = Frame(self.pending[5] | self.pending[6] << 8, payload)
            self._drop(end - self._base)
            return frame
        first = next(iter(self._candidates), self._searched)
        return self._skip(first) if first > self._base else None

    def _search(self) -> None:
        """Search for candidates, up to the last start that could end before the known candidates."""
        buffer, base = self.pending, self._base
        while True:
            at = buffer.find(SYNC, self._searched - base)
            if at < 0:
                self._searched = max(self._searched, base + len(buffer) - buffer.endswith(SYNC[:1]))
                return
            is_behind = self._ends and base + at + OVERHEAD_BYTES > self._ends[0][0]
            if is_behind or at + HEADER.size > len(buffer):
                self._searched = base + at
                return
            self._searched = base + at + 1
            _, size, check, _ = HEADER.unpack_from(buffer, at)
            if (size + (size >> 8) + check) & 0xFF != _SUM_IS_RIGHT:
                self._reject(base + at, Rejection.LENGTH_CHECKSUM)
            elif size > self.limit_bytes:
                self._reject(base + at, Rejection.TOO_LONG)
            else:
                self._add_candidate(base + at, base + at + size + OVERHEAD_BYTES)

    def _add_candidate(self, start: int, end: int) -> None:
        self._candidates[start] = end
        insort(self._ends, (end, start))
        self._claimed_bytes += end - start
        while self._claimed_bytes > MAX_CLAIMED_BYTES:
            _, dropped = self._remove_candidate(-1)
            self._reject(dropped, Rejection.TOO_MANY)

    def _remove_candidate(self, index: int) -> tuple[int, int]:
        """Remove the candidate at `index` of `_ends`. Return its end and start."""
        end, start = self._ends.pop(index)
        del self._candidates[start]
        self._claimed_bytes -= end - start
        return end, start

    def _forget_candidates(self) -> None:
        self._candidates.clear()
        self._ends.clear()
        self._claimed_bytes = 0

    def _is_right(self, start: int, end: int) -> bool:
        """Check a complete candidate. Note a wrong one as a false start."""
        topic_id = self.pending[start + 5] | self.pending[start + 6] << 8
        size = end - start - OVERHEAD_BYTES
        if byte_sum(self.pending[start + 5 : end]) & 0xFF != _SUM_IS_RIGHT:
            self._reject(self._base + start, Rejection.CHECKSUM)
        elif self._fixed_bytes.get(topic_id, size) != size:
            self._reject(self._base + start, Rejection.WRONG_SIZE)
        else:
            return True
        return False

    def _reject(self, start: int, cause: Rejection) -> None:
        """Note a false start. It is counted when its bytes are skipped, not when they are inside a frame."""
        heappush(self._false_starts, (start, cause.value))

    def _skip(self, until: int) -> Skipped:
        false_starts = self._false_starts
        while false_starts and false_starts[0][0] < until:
            self.rejected[Rejection(heappop(false_starts)[1])] += 1
        size = until - self._base
        skipped = Skipped(bytes(self.pending[:size]))
        del self.pending[:size]
        self._base = until
        return skipped

    def _drop(self, size: int) -> None:
        """Remove frames from the head, and the candidates that overlap them."""
        del self.pending[:size]
        self._taken = 0
        self._base += size
        self._searched = self._base
        if self._ends:
            self._forget_candidates()
        if self._false_starts:  # every known false start is inside the removed frames
            self._false_starts.clear()
