"""Uart: a serial line at its true speed and the receive ring behind it; BoardUart: both directions. Pure.

Time is an argument.
"""

from collections import deque

BITS_A_BYTE = 10  # 8N1: a start and a stop bit
RING_BYTES = 127  # docs/protocol.md#buffers-and-sizes: 128, of which one stays empty to tell full from empty


class Uart:
    """Bytes sent at one end arrive one by one at the other; a full ring loses the new ones, as the Due's does.

    `baud` None: they arrive at once, and no ring is too small. A reader at another rate (`read_baud`) samples the bits
    of each `send` at its own rate.
    """

    def __init__(self, *, baud: int | None, ring_bytes: int = RING_BYTES) -> None:
        self.lost_bytes = 0
        self.baud = baud
        self.read_baud = baud
        self.free_at_s = 0.0  # when the line can begin the next byte
        self._ring_bytes = ring_bytes
        self._line: deque[tuple[float, int]] = deque()
        self._ring: deque[int] = deque()

    @property
    def byte_s(self) -> float:
        """Time of one byte on the line."""
        return BITS_A_BYTE / self.baud if self.baud else 0.0

    def send(self, data: bytes, now_s: float) -> None:
        """Put bytes on the line; they queue up in the sender, which has room."""
        began_s = max(self.free_at_s, now_s)
        self.free_at_s = began_s + len(data) * self.byte_s
        if self.baud and self.read_baud and self.read_baud != self.baud:
            from hostlink.core.protocol.resampling import resample  # noqa: PLC0415 - numpy takes 0.1 s to import

            data = resample(data, ratio=self.read_baud / self.baud)
        step_s = (self.free_at_s - began_s) / max(len(data), 1)
        self._line.extend((began_s + (place + 1) * step_s, byte) for place, byte in enumerate(data))

    def read(self, now_s: float) -> int | None:
        """The next byte of the ring; None when it is empty."""
        self.settle(now_s)
        return self._ring.popleft() if self._ring else None

    def take(self, now_s: float) -> int | None:
        """The next byte, for a program that has waited for it since `settle`: nothing was lost meanwhile."""
        if self._ring:
            return self._ring.popleft()
        return self._line.popleft()[1] if self._line and self._line[0][0] <= now_s else None

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
            if self.baud and len(self._ring) >= self._ring_bytes:
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


class BoardUart:
    """UART of a board. The host, or the ESP8266 in front of it, reads at once."""

    def __init__(self, *, baud: int | None, ring_bytes: int = RING_BYTES) -> None:
        self.from_host = Uart(baud=baud, ring_bytes=ring_bytes)
        self.to_host = Uart(baud=baud, ring_bytes=1 << 30)
