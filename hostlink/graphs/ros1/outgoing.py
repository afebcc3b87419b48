"""Outgoing: what waits for one subscriber, bounded: one that does not keep up costs nobody else anything. Pure."""

from collections import deque

MAX_MESSAGES = 256
MAX_BYTES = 8 * 1024 * 1024
BATCH_BYTES = 64 * 1024  # that one write passes to the system


class Outgoing:
    """Messages in their order; of too many the oldest is dropped, and counted. The newest always stays."""

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: deque[bytes] = deque()
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def put(self, data: bytes) -> None:
        """One more message."""
        self._waiting.append(data)
        self._bytes += len(data)
        while len(self._waiting) > MAX_MESSAGES or (self._bytes > MAX_BYTES and len(self._waiting) > 1):
            self._bytes -= len(self._waiting.popleft())
            self.dropped += 1

    def pop_batch(self) -> bytes:
        """The oldest messages, BATCH_BYTES or a little more of them."""
        batch: list[bytes] = []
        size = 0
        while self._waiting and size < BATCH_BYTES:
            batch.append(self._waiting.popleft())
            size += len(batch[-1])
        self._bytes -= size
        return batch[0] if len(batch) == 1 else b"".join(batch)
