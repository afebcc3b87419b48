"""Transport: what a link needs of a connection to a device."""

from collections.abc import Callable
from typing import Protocol

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
    def is_behind(self) -> bool:
        """Whether the system may have more bytes behind those that were received."""
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
