"""A transport without an operating system: two ends in memory, for Link tests in virtual time.

    host, device = memory_pair(piece_bytes=3)
    await device.send(frame)          # the host receives it in pieces of 3 bytes
    await device.aclose()             # the host receives b""
    device.break_off()                # both ends get an OSError

A writer stalls when its peer does not read: with `room_bytes=0` at once.
"""

import asyncio

from hostlink.transport.base import READ_BYTES

ROOM_BYTES = 16384


class _Line:
    """One direction: what was sent and not received yet."""

    def __init__(self, room_bytes: int, piece_bytes: int) -> None:
        self._room_bytes, self._piece_bytes = room_bytes, piece_bytes
        self._waiting = bytearray()
        self._is_ended = False
        self._is_broken = False
        self._changed = asyncio.Event()

    async def put(self, data: bytes) -> None:
        """Wait for room; what was put before a cancel stays."""
        rest = memoryview(data)
        while True:
            if self._is_ended or self._is_broken:
                raise ConnectionResetError("connection lost")
            taken = rest[: self._room_bytes - len(self._waiting)]
            rest = rest[len(taken) :]
            if taken:
                self._waiting += taken
                self._change()
            if not rest:
                return
            await self._changed.wait()

    async def take(self) -> bytes:
        """Wait for a piece, or for the end."""
        while not self._waiting and not self._is_ended and not self._is_broken:
            await self._changed.wait()
        if self._is_broken:
            raise ConnectionResetError("connection reset by peer")
        piece = bytes(self._waiting[: self._piece_bytes])
        del self._waiting[: self._piece_bytes]
        self._change()
        return piece

    def end(self) -> None:
        """What waits is still received."""
        self._is_ended = True
        self._change()

    def break_off(self) -> None:
        """What waits is lost."""
        self._is_broken = True
        self._change()

    def _change(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()


class MemoryTransport:
    """One end of a `memory_pair`."""

    def __init__(self, from_peer: _Line, to_peer: _Line, *, address: str) -> None:
        self.peer = self.address = address
        self._from_peer, self._to_peer = from_peer, to_peer

    async def receive(self) -> bytes:
        """The next piece; b"" when either end was closed."""
        return await self._from_peer.take()

    async def send(self, data: bytes) -> None:
        """Returns when the line has room for all of it."""
        await self._to_peer.put(data)

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
        """As a reset or a pulled plug: an OSError at both ends."""
        self._from_peer.break_off()
        self._to_peer.break_off()


def memory_pair(
    *, room_bytes: int = ROOM_BYTES, piece_bytes: int = READ_BYTES, address: str = "memory"
) -> tuple[MemoryTransport, MemoryTransport]:
    """Two ends: `room_bytes` may wait unread in each direction, a receive returns `piece_bytes` at most."""
    one, other = _Line(room_bytes, piece_bytes), _Line(room_bytes, piece_bytes)
    return MemoryTransport(one, other, address=address), MemoryTransport(other, one, address=address)
