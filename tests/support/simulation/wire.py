"""Connections of the simulated world: in order as TCP, with drawn delays, splits, stalls and ends."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Protocol

from hostlink.core.transport.base import READ_BYTES
from tests.support.simulation.clock import WorldLoop
from tools.faults import FaultyLine, Habits, Kind

ROOM_BYTES = 16384  # of a kernel's send buffer
UNACKNOWLEDGED_S = 0.4  # docs/robot.md#how-long-a-stop-may-wait
KEPT_S = 8.0  # TCP_USER_TIMEOUT and keepalive


class Peer(Protocol):
    """Board or program at the other end of a connection."""

    def receive(self, data: bytes) -> None: ...
    def lose_connection(self) -> None: ...


class Pipe:
    """One direction."""

    def __init__(self, loop: WorldLoop, habits: Habits, seed: str, deliver: Callable[[bytes], None]) -> None:
        self.line = FaultyLine(habits, seed)
        self.moved_s = loop.world_s  # when bytes arrived last, or none were on their way
        self.is_dead = False  # nothing arrives from now on, and neither end is told
        self._loop, self._deliver = loop, deliver
        self._is_planned = False
        self.on_empty: Callable[[], None] = lambda: None

    def send(self, data: bytes, now_s: float) -> None:
        """Put bytes on the line."""
        if not self.line.waiting_bytes:
            self.moved_s = now_s
        self.line.send(data, now_s)
        self._plan()

    def stall(self, seconds: float) -> None:
        """Hold everything for a time."""
        self.line.stand_still(self._loop.world_s + seconds)

    def heal(self) -> None:
        """Move on, and damage nothing more."""
        self.line.heal()
        self.line._still_until_s = self._loop.world_s
        self._is_planned = False
        self._plan()

    def _plan(self) -> None:
        next_s = self.line.next_s()
        if next_s is not None and not self._is_planned and not self.is_dead:
            self._is_planned = True
            self._loop.at(next_s, self._arrive)

    def _arrive(self) -> None:
        self._is_planned = False
        if self.is_dead:
            return
        for piece in self.line.pop_due(self._loop.world_s):
            self.moved_s = self._loop.world_s
            self._deliver(piece)
        if self.line.waiting_bytes:
            self._plan()
        else:
            self.on_empty()


class Connection:
    """One connection between the daemon and a board or a program. `host` is the daemon's end, a Transport."""

    def __init__(
        self, loop: WorldLoop, number: int, address: str, habits: Habits, seed: str, peer: Peer, *, kind: str = "tcp"
    ) -> None:
        self.number, self.loop, self._peer = number, loop, peer
        self.to_host = Pipe(loop, habits, f"{seed} to the host", self._reach_host)
        self.to_peer = Pipe(loop, habits, f"{seed} to the peer", self._reach_peer)
        self.host = HostEnd(self, address, kind)
        self.is_over = False  # the peer knows it

    # -- what the peer does -------------------------------------------------------------------------------------------

    def send(self, data: bytes) -> None:
        """Send bytes to the daemon."""
        if not self.is_over:
            self.to_host.send(data, self.loop.world_s)

    def close(self) -> None:
        """Close in good order: the daemon reads what was sent, then the end."""
        if not self.is_over:
            self.is_over = True
            self.to_peer.is_dead = True
            self.to_host.on_empty = self.host.end
            if not self.to_host.line.waiting_bytes:
                self.loop.after(0.0, self.host.end)

    def vanish(self) -> None:
        """Leave without a word: the network is gone. The daemon's kernel gives up after KEPT_S."""
        self.is_over = self.to_host.is_dead = self.to_peer.is_dead = True
        self.loop.after(KEPT_S, self.host.break_off)

    # -- what happens to it -------------------------------------------------------------------------------------------

    def cut(self) -> None:
        """Reset it at both ends."""
        self.to_host.is_dead = self.to_peer.is_dead = True
        self.host.break_off()
        self._tell_peer()

    def closed_by_host(self) -> None:
        """The daemon has closed its end: the peer reads what was sent, then the end."""
        self.to_host.is_dead = True
        self.to_peer.on_empty = self._tell_peer
        if not self.to_peer.line.waiting_bytes:
            self.loop.after(0.0, self._tell_peer)

    def stall(self, seconds: float) -> None:
        """Hold both directions for a time."""
        self.to_host.stall(seconds)
        self.to_peer.stall(seconds)

    def heal(self) -> None:
        """End what weather does to it."""
        self.to_host.heal()
        self.to_peer.heal()

    def harm(self, kind: Kind, count: int) -> None:
        """Damage some of the next bytes in both directions."""
        self.to_host.line.harm(kind, count)
        self.to_peer.line.harm(kind, count)

    def _tell_peer(self) -> None:
        if not self.is_over:
            self.is_over = True
            self._peer.lose_connection()

    def _reach_peer(self, data: bytes) -> None:
        if not self.is_over:
            self._peer.receive(data)
        self.host.make_room()

    def _reach_host(self, data: bytes) -> None:
        self.host.arrive(data)


class HostEnd:
    """The daemon's end of a connection: a Transport, whose kernel notes when each byte has arrived."""

    def __init__(self, connection: Connection, address: str, kind: str) -> None:
        self.connection = connection
        self.kind, self.address, self.peer = kind, address, f"{address}:{connection.number}"
        self.read_bytes = 0
        self.on_written: Callable[[bytes], None] = lambda _: None
        self.on_stuck: Callable[[bool], None] = lambda _: None  # the peer takes no more, or takes bytes again
        self.is_ended = False
        self._loop = connection.loop
        self._waiting = bytearray()
        self._arrived_bytes = 0
        self._arrivals: deque[tuple[int, float]] = deque()  # (bytes until then, time)
        self._on_readable: Callable[[], None] | None = None
        self._is_broken = self._is_closed = self._is_told = self._is_stuck = self.is_dead = False
        self._moved = asyncio.Event()

    # -- Transport ----------------------------------------------------------------------------------------------------

    def start(self, on_readable: Callable[[], None]) -> None:
        self._on_readable = on_readable
        if self._waiting or self.is_ended:
            self._tell()

    @property
    def unread_bytes(self) -> int:
        return 0 if self._is_broken else min(len(self._waiting), READ_BYTES)

    @property
    def is_behind(self) -> bool:
        return len(self._waiting) > self.unread_bytes

    def read(self, limit_bytes: int) -> bytes:
        if self._is_broken:
            raise ConnectionResetError("connection reset by peer")
        piece = bytes(self._waiting[: min(limit_bytes, READ_BYTES)])
        del self._waiting[: len(piece)]
        self.read_bytes += len(piece)
        return piece

    def write(self, data: bytes) -> bool:
        if self.is_dead or self._is_broken or self._is_closed:
            return not self._is_broken
        self.on_written(data)
        self.connection.to_peer.send(data, self._loop.time())
        return self._is_roomy()

    async def drain(self) -> None:
        while True:
            if self._is_broken or self._is_closed:
                raise ConnectionResetError("connection lost")
            if self._is_roomy():
                return
            await self._moved.wait()

    async def receive(self) -> bytes:
        raise NotImplementedError("links read in callbacks")

    async def send(self, data: bytes) -> None:
        self.write(data)
        await self.drain()

    def round_trip_s(self) -> float | None:
        return None

    def descriptor(self) -> int | None:
        return None if self._is_closed else self.connection.number

    async def aclose(self) -> None:
        self.close()

    # -- the rest of the world ----------------------------------------------------------------------------------------

    def close(self) -> None:
        """Close it, as the daemon or its end does."""
        if not self._is_closed and not self.is_dead:
            self._is_closed = True
            self._moved.set()
            self.connection.closed_by_host()

    def arrive(self, data: bytes) -> None:
        """Receive bytes, as the kernel does."""
        if not self._is_closed and not self.is_dead:
            self._waiting += data
            self._arrived_bytes += len(data)
            self._arrivals.append((self._arrived_bytes, self._loop.world_s))
            self._tell()

    def arrived_s(self, until_bytes: int) -> float:
        """Return when so many bytes had arrived. The number never decreases from call to call."""
        while self._arrivals[0][0] < until_bytes:
            self._arrivals.popleft()
        return self._arrivals[0][1]

    def end(self) -> None:
        """The peer has closed."""
        self.is_ended = True
        self._tell()

    def break_off(self) -> None:
        """The connection was reset."""
        self.is_ended = self._is_broken = True
        self._moved.set()
        self._tell()

    def die(self) -> None:
        """The daemon's process is gone."""
        self.is_dead = True
        self._on_readable = None

    def make_room(self) -> None:
        """Bytes have reached the peer."""
        if self._is_roomy():
            self._moved.set()
            self._moved.clear()

    def _is_roomy(self) -> bool:
        pipe = self.connection.to_peer
        is_stuck = pipe.line.waiting_bytes > 0 and self._loop.time() >= pipe.moved_s + UNACKNOWLEDGED_S
        is_roomy = not is_stuck and pipe.line.waiting_bytes <= ROOM_BYTES
        if is_roomy == self._is_stuck:
            self._is_stuck = not is_roomy
            self.on_stuck(self._is_stuck)
        return is_roomy

    def _tell(self) -> None:
        """Call the reader in the next turn of the loop, once for all that has come until then."""
        if self._on_readable is not None and not self._is_told:
            self._is_told = True
            self._loop.call_soon(self._call)

    def _call(self) -> None:
        self._is_told = False
        if self._on_readable is not None and not self.is_dead:
            self._on_readable()
