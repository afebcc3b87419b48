"""Turns of two protocols at one serial port, whose device speaks either: told by its bytes."""

from collections.abc import Callable

from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.transport.base import Transport
from hostlink.core.transport.connection import ignore

KEPT_BYTES = 2048  # in which a message of the other protocol is looked for: it may come in pieces
OWN_S = 1.0  # after a message of the link's own protocol, bytes that look like the other one's are not


class Turn:
    """Transport of one link at a port. It stays open when the bytes of the other protocol end the link.

    `taken` has these bytes then, for the link of the next turn.
    """

    def __init__(self, port: Transport, other: DeviceProtocol, *, first: bytes = b"") -> None:
        """`first`: what the turn before has read of this one's protocol."""
        self.kind, self.peer, self.address = port.kind, port.peer, port.address
        self.count_own: Callable[[], int] = lambda: 0  # messages of this turn's protocol so far
        self.on_other: Callable[[], None] = ignore
        self.taken = b""
        self._port, self._other, self._first = port, other, first
        self._recent = b""  # read since the last message of this turn's protocol
        self._own, self._own_s = 0, float("-inf")
        self._read_s = float("-inf")  # when the bytes before were read

    def _judge(self, data: bytes) -> bool:
        """Look for the other protocol. Return whether the turn ends with these bytes."""
        own, now_s = self.count_own(), loop_time_s()
        if own != self._own:
            self._own, self._own_s, self._recent = own, self._read_s, b""
        self._read_s = now_s
        self._recent = (self._recent + data)[-KEPT_BYTES:]
        if now_s < self._own_s + OWN_S or not self._other.is_in(self._recent):
            return False
        self.taken = self._recent
        self.on_other()
        return True

    # -- what a link needs --------------------------------------------------------------------------------------------

    def start(self, on_readable: Callable[[], None]) -> None:
        """Call `on_readable` from now on whenever bytes arrived, and at the end."""
        self._port.start(on_readable)
        if self._first:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes."""
        return len(self._first) + self._port.unread_bytes

    @property
    def is_behind(self) -> bool:
        """Whether the system may have more bytes behind those that were received."""
        return self._port.is_behind

    @property
    def is_ended(self) -> bool:
        """Whether the port is gone, so that no more bytes arrive."""
        return self._port.is_ended

    def read(self, limit_bytes: int) -> bytes:
        """Return received bytes; none when the turn ends with them.

        Raises:
            OSError: the port is gone, and every byte before was read.
        """
        if self._first:
            data, self._first = self._first[:limit_bytes], self._first[limit_bytes:]
            return data
        data = self._port.read(limit_bytes)
        return b"" if self._judge(data) else data

    def write(self, data: bytes) -> bool:
        """Pass data to the port. False: it is behind."""
        return self._port.write(data)

    async def drain(self) -> None:
        """Wait until the port has accepted the written data."""
        await self._port.drain()

    async def receive(self) -> bytes:
        """Wait for bytes; b"" at the end."""
        return await self._port.receive()

    async def send(self, data: bytes) -> None:
        """Write and drain."""
        await self._port.send(data)

    def round_trip_s(self) -> float | None:
        """Return None: a port has no measurement of its round trip."""
        return self._port.round_trip_s()

    def descriptor(self) -> int | None:
        """File descriptor of the port, until it is being closed."""
        return self._port.descriptor()

    async def aclose(self) -> None:
        """Close the port, unless the other protocol has the next turn."""
        if not self.taken:
            await self._port.aclose()
