"""A transport without an operating system: two ends in memory, for Link tests in virtual time.

    host, device = memory_pair()
    await device.send(frame)          # the host receives it
    await device.aclose()             # the host receives b""
    device.break_off()                # both ends get an OSError

A writer stalls when its peer does not read: with `room_bytes=0` at once.
"""

import asyncio
from collections.abc import Callable

from hostlink.core.transport.base import READ_BYTES

ROOM_BYTES = 16384


class _Line:
    """One direction: what was sent and not received yet."""

    def __init__(self, room_bytes: int) -> None:
        self.on_readable: Callable[[], object] = lambda: None
        self.is_ended = False
        self._room_bytes = room_bytes
        self._waiting = bytearray()
        self._is_broken = False
        self._changed = asyncio.Event()

    @property
    def unread_bytes(self) -> int:
        """Number of bytes that one reading returns."""
        return 0 if self._is_broken else min(len(self._waiting), READ_BYTES)

    @property
    def is_behind(self) -> bool:
        """Whether more waits behind what one reading returns."""
        return len(self._waiting) > self.unread_bytes

    def write(self, data: bytes) -> bool:
        """Queue data. Return False if more waits than there is room for, or if it can never be read."""
        if not self.is_ended:
            self._waiting += data
            self._change()
        return not self.is_ended and len(self._waiting) <= self._room_bytes

    async def drain(self) -> None:
        """Wait for room."""
        while True:
            if self.is_ended:
                raise ConnectionResetError("connection lost")
            if len(self._waiting) <= self._room_bytes:
                return
            await self._changed.wait()

    def read(self, limit_bytes: int) -> bytes:
        """A piece, or the end."""
        if self._is_broken:
            raise ConnectionResetError("connection reset by peer")
        piece = bytes(self._waiting[: min(limit_bytes, READ_BYTES)])
        del self._waiting[: len(piece)]
        if piece:
            self._changed.set()
            self._changed = asyncio.Event()
        return piece

    async def receive(self) -> bytes:
        """Wait for a piece, or for the end."""
        while not self._waiting and not self.is_ended:
            await self._changed.wait()
        return self.read(READ_BYTES)

    def end(self) -> None:
        """End the stream; waiting bytes are still received."""
        self.is_ended = True
        self._change()

    def break_off(self) -> None:
        """Break the stream; waiting bytes are lost."""
        self._is_broken = True
        self.end()

    def _change(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()
        self.on_readable()


class MemoryTransport:
    """One end of a `memory_pair`."""

    kind = "memory"

    def __init__(self, from_peer: _Line, to_peer: _Line, *, address: str) -> None:
        self.peer = self.address = address
        self._from_peer, self._to_peer = from_peer, to_peer

    def start(self, on_readable: Callable[[], None]) -> None:
        """Called in a turn of the loop of its own, as a system's."""
        loop = asyncio.get_running_loop()
        self._from_peer.on_readable = lambda: loop.call_soon(on_readable)
        if self.unread_bytes or self.is_ended:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes."""
        return self._from_peer.unread_bytes

    @property
    def is_behind(self) -> bool:
        """Whether more waits than one reading returns."""
        return self._from_peer.is_behind

    @property
    def is_ended(self) -> bool:
        """Whether either end was closed."""
        return self._from_peer.is_ended

    def read(self, limit_bytes: int) -> bytes:
        """The next piece; b"" while there is none, and when either end was closed."""
        return self._from_peer.read(limit_bytes)

    def write(self, data: bytes) -> bool:
        """False: the line is full."""
        return self._to_peer.write(data)

    async def drain(self) -> None:
        """Returns when the line has room for all of it."""
        await self._to_peer.drain()

    async def receive(self) -> bytes:
        """The next piece; b"" when either end was closed."""
        return await self._from_peer.receive()

    async def send(self, data: bytes) -> None:
        """Write and drain."""
        self.write(data)
        await self.drain()

    def round_trip_s(self) -> float | None:
        """There is no network."""
        return None

    def descriptor(self) -> int | None:
        """There is no operating system."""
        return None

    async def aclose(self) -> None:
        """End both directions."""
        self._from_peer.end()
        self._to_peer.end()

    def break_off(self) -> None:
        """Break the connection with an OSError at both ends, as a reset does."""
        self._from_peer.break_off()
        self._to_peer.break_off()


def memory_pair(*, room_bytes: int = ROOM_BYTES, address: str = "memory") -> tuple[MemoryTransport, MemoryTransport]:
    """Two ends: `room_bytes` may wait unread in each direction."""
    one, other = _Line(room_bytes), _Line(room_bytes)
    return MemoryTransport(one, other, address=address), MemoryTransport(other, one, address=address)
