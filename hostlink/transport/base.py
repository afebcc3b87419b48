"""Transport: bytes to and from one device, whatever carries them."""

from collections.abc import Callable
from typing import Protocol

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
