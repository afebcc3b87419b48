"""Transport: bytes to and from one device, whatever carries them."""

from typing import Protocol

READ_BYTES = 8192  # what one turn of the loop takes from one connection: a flood is shared out by that
CLOSE_TIMEOUT_S = 1.0


class Transport(Protocol):
    """One open connection. Errors of the world are OSErrors."""

    peer: str  # for people: "192.168.4.2:53122" or "/dev/ttyACM0"
    address: str  # what stays when the peer comes back: "192.168.4.2" or "/dev/ttyACM0"

    async def receive(self) -> bytes:
        """What has come, twice READ_BYTES at most; b"" when the peer has closed."""
        ...

    async def send(self, data: bytes) -> None:
        """Returns when the operating system has taken all of it."""
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
