"""Transport protocol, and the rules that several transports share."""

from collections.abc import Callable, Sequence
from typing import Protocol

# -- base -------------------------------------------------------------------------------------------------------------

READ_BYTES = 8192  # read per connection and turn of the loop, so that a flood is divided among turns
CLOSE_TIMEOUT_S = 1.0


class Transport(Protocol):
    """One open connection to a device. Failures of the connection are OSErrors.

    A link calls `start`, `read` and `write`, which never wait. `receive` and `send` are for callers that may wait.
    """

    kind: str  # "tcp", "serial" or "udp"
    peer: str  # for people: "192.168.4.2:53122" or "/dev/ttyACM0"
    address: str  # unchanged when the peer reconnects: "192.168.4.2" or "/dev/ttyACM0"

    def start(self, on_readable: Callable[[], None]) -> None:
        """Call `on_readable` from now on whenever bytes arrived, and at the end."""
        ...

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes, at most 2 * READ_BYTES. Then the system slows the sender."""
        ...

    @property
    def is_ended(self) -> bool:
        """Whether the connection ended, so that no more bytes arrive."""
        ...

    def read(self, limit_bytes: int) -> bytes:
        """Return received bytes; b"" when none are unread, and at the end.

        Raises:
            OSError: the connection broke, and every byte before was read.
        """
        ...

    def write(self, data: bytes) -> bool:
        """Pass data to the operating system. False: the peer is behind; call `drain` before the next write."""
        ...

    async def drain(self) -> None:
        """Wait until the peer keeps up with the written data.

        Raises:
            OSError: the connection broke.
        """
        ...

    async def receive(self) -> bytes:
        """Wait for bytes and return at most 2 * READ_BYTES; b"" when the peer has closed."""
        ...

    async def send(self, data: bytes) -> None:
        """Write and drain."""
        ...

    def round_trip_s(self) -> float | None:
        """Round trip time as the transport measures it; None if it measures none."""
        ...

    def descriptor(self) -> int | None:
        """File descriptor that can be duplicated for another process; None if there is none or it is closed."""
        ...

    async def aclose(self) -> None:
        """Close within CLOSE_TIMEOUT_S, then abort. Further calls do nothing."""
        ...


# -- stall ------------------------------------------------------------------------------------------------------------

STALL_S = 0.4  # longer than a peer may delay an acknowledgement (lwIP on an ESP8266: 0.25 s)


class Stall:
    """Detector of a stalled peer, from the number of sent and of unacknowledged bytes."""

    def __init__(self) -> None:
        self._is_waiting = False
        self._acknowledged_bytes = 0
        self._since_s = 0.0  # time of the last progress, or of the first unacknowledged byte

    def is_stalled(self, *, sent_bytes: int, unacknowledged_bytes: int, now_s: float) -> bool:
        """Whether bytes are unacknowledged and none was acknowledged for STALL_S."""
        acknowledged_bytes = sent_bytes - unacknowledged_bytes
        if not self._is_waiting or acknowledged_bytes > self._acknowledged_bytes:
            self._acknowledged_bytes, self._since_s = acknowledged_bytes, now_s
        self._is_waiting = unacknowledged_bytes > 0
        return self._is_waiting and now_s >= self._since_s + STALL_S


# -- allowance --------------------------------------------------------------------------------------------------------

HEADER_BYTES = 28  # IPv4 and UDP header of each datagram


class Allowance:
    """Byte allowance of an unverified address: no more is sent to it than came from it, with and without headers.

    The limit prevents that a forged source address is used to flood a third host.
    """

    def __init__(self, *, is_limited: bool) -> None:
        self.is_limited = is_limited
        self._payload_bytes = self._wire_bytes = 0

    def earn(self, size_bytes: int) -> None:
        """Add a received datagram to the allowance."""
        self._payload_bytes += size_bytes
        self._wire_bytes += size_bytes + HEADER_BYTES

    def allows(self, datagrams: Sequence[bytes]) -> bool:
        """Whether all of these datagrams may be sent."""
        if not self.is_limited:
            return True
        payload_bytes = sum(map(len, datagrams))
        wire_bytes = payload_bytes + HEADER_BYTES * len(datagrams)
        return payload_bytes <= self._payload_bytes and wire_bytes <= self._wire_bytes

    def spend(self, size_bytes: int) -> None:
        """Subtract a sent datagram from the allowance."""
        self._payload_bytes -= size_bytes
        self._wire_bytes -= size_bytes + HEADER_BYTES
