"""FrameStream: bytes in, however they were cut; frames and skipped bytes out. It knows no topic and no time."""

from bisect import bisect_left, insort
from collections import Counter, OrderedDict
from collections.abc import Iterator, Mapping
from enum import Enum
from heapq import heappop, heappush
from typing import NamedTuple

from hostlink.protocol.frame import HEADER, MAX_PAYLOAD_BYTES, OVERHEAD_BYTES, SYNC, SYNC_WORD, Frame, byte_sum

MAX_CLAIMED_BYTES = 4 * (MAX_PAYLOAD_BYTES + OVERHEAD_BYTES)  # read at most for one byte that completes them all
DEFAULT_LIMIT_BYTES = 1024  # twice rosserial's usual buffer: what a header may claim before topics are known
new_frame = tuple.__new__  # twice as fast as Frame(...)
_SUM_IS_RIGHT = 0xFF  # bytes and their checksum add up to 255 modulo 256


class Skipped(NamedTuple):
    """Bytes that belong to no frame."""

    data: bytes


class Rejection(Enum):
    """Why a sync was no start of a frame."""

    LENGTH_CHECKSUM = "length_checksum"
    TOO_LONG = "too_long"
    TOO_MANY = "too_many"
    CHECKSUM = "checksum"
    WRONG_SIZE = "wrong_size"
    INCOMPLETE = "incomplete"


class FrameStream:
    """Reads frames from a stream in which bytes may be damaged, missing or not rosserial's.

    Every sync with a good length checksum and a claim within the limit is a *candidate*. The candidate that is
    first complete and right wins, whatever began before it: so a damaged header that claims a kilobyte costs
    neither the frames inside it nor the time until that kilobyte has come, and how the bytes were cut changes
    nothing. The bytes before the winner are skipped; no byte is ever lost: frames + skipped + pending = input.

    | head of the buffer              | what happens                                       |
    |---------------------------------|----------------------------------------------------|
    | no sync                         | skipped up to the next possible one                |
    | candidate, right, none inside   | frame                                              |
    | candidate, incomplete           | waits; each candidate inside it is followed too    |
    | candidate, complete and wrong   | no candidate any more: its bytes are read again    |

    `rejected` counts the false starts among the bytes that were skipped. A payload may hold a sync: when the frame
    around it turns out right, nothing was lost, and the sync is not counted.

    What all candidates together claim is bounded by MAX_CLAIMED_BYTES, because one byte can complete all of them. Above
    it, the candidate that ends last is dropped: `too_many`. With a limit of 1024 bytes it is never reached.
    """

    __slots__ = (
        "_base", "_buffer", "_candidates", "_claimed_bytes", "_ends", "_false_starts", "_fixed_bytes", "_searched",
        "limit_bytes", "rejected",
    )  # fmt: skip

    def __init__(self, *, limit_bytes: int = DEFAULT_LIMIT_BYTES, fixed_bytes: Mapping[int, int] | None = None) -> None:
        """`limit_bytes`: the largest payload that a header may claim; `fixed_bytes`: id -> its only right size."""
        self.limit_bytes = limit_bytes
        self.rejected: Counter[Rejection] = Counter()
        self._fixed_bytes: Mapping[int, int] = {} if fixed_bytes is None else fixed_bytes
        self._buffer = bytearray()
        self._base = 0  # where the buffer begins, counted from the first byte of the stream
        self._candidates: OrderedDict[int, int] = (
            OrderedDict()
        )  # start -> end of what is not decided yet, first at front
        self._ends: list[tuple[int, int]] = []  # (end, start) of the same, sorted: the first to be complete at front
        self._claimed_bytes = 0  # of all candidates together
        self._false_starts: list[tuple[int, str]] = []  # a heap: (start, Rejection) of what is still in the buffer
        self._searched = 0  # up to here every sync was checked

    @property
    def pending_bytes(self) -> int:
        """Bytes that are neither frame nor skipped yet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> Iterator[Frame | Skipped]:
        """Add bytes. What one frame changes (limit, sizes) holds for the next, so the iterator is lazy."""
        buffer, unpack = self._buffer, HEADER.unpack_from
        is_short = len(data) < len(buffer)  # then a copy of all would cost more than linear work
        buffer += data
        source = buffer if is_short else bytes(buffer)  # frames are cut from bytes faster
        while source:
            at, last = 0, len(source) - OVERHEAD_BYTES  # where the last frame without a payload could begin
            try:
                while at <= last:  # the fast way: frames at the head that are complete, right and uncontested
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
                    at = end
                    yield frame
            finally:  # also when nobody reads on
                if at:
                    self._drop(at)
            source = buffer
            if buffer:
                event = self._contested()
                if event is None:
                    return
                yield event

    def give_up(self) -> Iterator[Frame | Skipped]:
        """Stop waiting for what stands at the head: read again from the byte after it."""
        if self._buffer:
            self._reject(self._base, Rejection.INCOMPLETE)
            end = self._candidates.get(self._base)
            if end is not None:
                self._remove_candidate(bisect_left(self._ends, (end, self._base)))
            self._searched = max(self._searched, self._base + 1)
        return self.feed(b"")

    def _contested(self) -> Frame | Skipped | None:
        """The next event where the head is noise, incomplete or has a sync inside; None: more bytes are needed."""
        while True:
            self._search()
            if not self._ends or self._ends[0][0] > self._base + len(self._buffer):
                break
            end, start = self._remove_candidate(0)
            if not self._is_right(start - self._base, end - self._base):
                continue
            if start > self._base:
                self._forget_candidates()
                self._add_candidate(start, end)
                return self._skip(start)
            payload = bytes(self._buffer[7 : end - self._base - 1])
            frame = Frame(self._buffer[5] | self._buffer[6] << 8, payload)
            self._drop(end - self._base)
            return frame
        first = next(iter(self._candidates), self._searched)
        return self._skip(first) if first > self._base else None

    def _search(self) -> None:
        """Find candidates as far as one could still end before those that are known."""
        buffer, base = self._buffer, self._base
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
        """End and start of the candidate that stood at `index` of the ends."""
        end, start = self._ends.pop(index)
        del self._candidates[start]
        self._claimed_bytes -= end - start
        return end, start

    def _forget_candidates(self) -> None:
        self._candidates.clear()
        self._ends.clear()
        self._claimed_bytes = 0

    def _is_right(self, start: int, end: int) -> bool:
        """Judge a complete candidate; one that is wrong is a false start."""
        topic_id = self._buffer[start + 5] | self._buffer[start + 6] << 8
        size = end - start - OVERHEAD_BYTES
        if byte_sum(self._buffer[start + 5 : end]) & 0xFF != _SUM_IS_RIGHT:
            self._reject(self._base + start, Rejection.CHECKSUM)
        elif self._fixed_bytes.get(topic_id, size) != size:
            self._reject(self._base + start, Rejection.WRONG_SIZE)
        else:
            return True
        return False

    def _reject(self, start: int, cause: Rejection) -> None:
        """Note a false start, which counts when it is skipped and not when it is inside a frame."""
        heappush(self._false_starts, (start, cause.value))

    def _skip(self, until: int) -> Skipped:
        false_starts = self._false_starts
        while false_starts and false_starts[0][0] < until:
            self.rejected[Rejection(heappop(false_starts)[1])] += 1
        size = until - self._base
        skipped = Skipped(bytes(self._buffer[:size]))
        del self._buffer[:size]
        self._base = until
        return skipped

    def _drop(self, size: int) -> None:
        """Remove frames from the head; candidates that overlap them are no longer any."""
        del self._buffer[:size]
        self._base += size
        self._searched = self._base
        if self._ends:
            self._forget_candidates()
        if self._false_starts:  # they were all looked for inside the frame: none is behind its end
            self._false_starts.clear()
