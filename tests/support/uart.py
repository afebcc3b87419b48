"""Uart: a serial line at its true speed, and the receive ring behind it. Pure; time is an argument."""

from collections import deque

BITS_A_BYTE = 10  # 8N1: a start and a stop bit
RING_BYTES = 127  # docs/protocol.md#buffers-and-sizes: 128, of which one stays empty to tell full from empty


class Uart:
    """Bytes sent at one end arrive one by one at the other; a full ring loses the new ones, as the Due's does.

    `baud` None: they arrive at once, and no ring is too small.
    """

    def __init__(self, *, baud: int | None, ring_bytes: int = RING_BYTES) -> None:
        self.lost_bytes = 0
        self._byte_s = 0.0 if baud is None else BITS_A_BYTE / baud
        self._ring_bytes = ring_bytes
        self._free_at_s = 0.0  # when the line can begin the next byte
        self._line: deque[tuple[float, int]] = deque()
        self._ring: deque[int] = deque()

    def send(self, data: bytes, now_s: float) -> None:
        """Put bytes on the line; they queue up in the sender, which has room."""
        for byte in data:
            self._free_at_s = max(self._free_at_s, now_s) + self._byte_s
            self._line.append((self._free_at_s, byte))

    def read(self, now_s: float) -> int | None:
        """The next byte of the ring; None when it is empty."""
        self.settle(now_s)
        return self._ring.popleft() if self._ring else None

    def pop(self, now_s: float) -> bytes:
        """All that has arrived, for a reader that is never late."""
        arrived = bytearray()
        while (byte := self.read(now_s)) is not None:
            arrived.append(byte)
        return bytes(arrived)

    def settle(self, now_s: float) -> None:
        """Let what has arrived by now fall into the ring."""
        while self._line and self._line[0][0] <= now_s:
            _, byte = self._line.popleft()
            if self._byte_s and len(self._ring) >= self._ring_bytes:
                self.lost_bytes += 1
            else:
                self._ring.append(byte)

    def next_arrival_s(self) -> float | None:
        """Time at which the next byte arrives; None if the line is empty."""
        return self._line[0][0] if self._line else None

    def cut(self) -> None:
        """The line is dead: what was on it is gone."""
        self._line.clear()
        self._ring.clear()
