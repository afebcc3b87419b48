"""Transport: bytes to and from one device, whatever carries them."""

from collections.abc import Callable, Sequence
from typing import Protocol

# -- base -------------------------------------------------------------------------------------------------------------

READ_BYTES = 8192  # what one turn of the loop takes from one connection: a flood is shared out by that
CLOSE_TIMEOUT_S = 1.0


class Transport(Protocol):
    """One open connection. Errors of the world are OSErrors.

    A link calls `start`, `read` and `write`, which never wait; `receive` and `send` are for whoever may wait.
    """

    kind: str  # "tcp", "serial" or "udp"
    peer: str  # for people: "192.168.4.2:53122" or "/dev/ttyACM0"
    address: str  # what stays when the peer comes back: "192.168.4.2" or "/dev/ttyACM0"

    def start(self, on_readable: Callable[[], None]) -> None:
        """From now on `on_readable` is called whenever bytes have come, and at the end."""
        ...

    @property
    def unread_bytes(self) -> int:
        """What has come and was not read, twice READ_BYTES at most: then the system slows the sender."""
        ...

    @property
    def is_ended(self) -> bool:
        """Whether nothing more will come."""
        ...

    def read(self, limit_bytes: int) -> bytes:
        """What has come, in pieces; b"" while there is nothing, and at the end.

        Raises:
            OSError: the connection broke, and everything before was read.
        """
        ...

    def write(self, data: bytes) -> bool:
        """Pass it to the operating system; False: the peer is behind, call `drain` before the next."""
        ...

    async def drain(self) -> None:
        """Returns when the peer keeps up with what was written.

        Raises:
            OSError: the connection broke.
        """
        ...

    async def receive(self) -> bytes:
        """What has come, twice READ_BYTES at most; b"" when the peer has closed."""
        ...

    async def send(self, data: bytes) -> None:
        """Write and drain."""
        ...

    def round_trip_s(self) -> float | None:
        """How long the network takes there and back, as it measures by itself; None: it does not."""
        ...

    def descriptor(self) -> int | None:
        """What another process can be given a duplicate of; None: it is closed, or there is none."""
        ...

    async def aclose(self) -> None:
        """Close within CLOSE_TIMEOUT_S, then abort; once is enough."""
        ...


# -- stall ------------------------------------------------------------------------------------------------------------

STALL_S = 0.4  # longer than a peer may hold an acknowledgement back (lwIP, so an ESP8266: 0.25 s)


class Stall:
    """Compares how much was sent in all with how much of that the peer has not acknowledged."""

    def __init__(self) -> None:
        self._is_waiting = False
        self._acknowledged_bytes = 0
        self._since_s = 0.0  # of the last progress, or of the first byte that waits

    def is_stalled(self, *, sent_bytes: int, unacknowledged_bytes: int, now_s: float) -> bool:
        """Whether something waits, and nothing was acknowledged for STALL_S."""
        acknowledged_bytes = sent_bytes - unacknowledged_bytes
        if not self._is_waiting or acknowledged_bytes > self._acknowledged_bytes:
            self._acknowledged_bytes, self._since_s = acknowledged_bytes, now_s
        self._is_waiting = unacknowledged_bytes > 0
        return self._is_waiting and now_s >= self._since_s + STALL_S


# -- allowance --------------------------------------------------------------------------------------------------------

HEADER_BYTES = 28  # of IPv4 and UDP, for each datagram


class Allowance:
    """Never more than came from there, with headers and without: nobody can have a flood sent to somebody else."""

    def __init__(self, *, is_limited: bool) -> None:
        self.is_limited = is_limited
        self._payload_bytes = self._wire_bytes = 0

    def earn(self, size_bytes: int) -> None:
        """A datagram came."""
        self._payload_bytes += size_bytes
        self._wire_bytes += size_bytes + HEADER_BYTES

    def allows(self, datagrams: Sequence[bytes]) -> bool:
        """Whether all of these may be sent."""
        if not self.is_limited:
            return True
        payload_bytes = sum(map(len, datagrams))
        wire_bytes = payload_bytes + HEADER_BYTES * len(datagrams)
        return payload_bytes <= self._payload_bytes and wire_bytes <= self._wire_bytes

    def spend(self, size_bytes: int) -> None:
        """A datagram was sent."""
        self._payload_bytes -= size_bytes
        self._wire_bytes -= size_bytes + HEADER_BYTES
