"""One device over UDP: a connected socket of its own.

The kernel gives such a socket the datagrams and the ICMP errors of its peer alone, in a buffer of its own: a flood from
elsewhere takes nothing from a device, an error ends no other's link, and another process can be given a duplicate.
"""

import asyncio
import contextlib
import errno
import socket
from collections import Counter
from collections.abc import Callable

from hostlink.transport.base import READ_BYTES, Allowance
from hostlink.transport.tcp import spelled
from hostlink.transport.udp_port import Datagram, receive_from

MAX_DATAGRAM_BYTES = 1452  # to a device: what passes an Ethernet or a WiFi whole, also by IPv6 (1500 - 40 - 8)
DATAGRAMS_A_TURN = 4  # of one device, before others have their turn: a robot sends tens in a second
PATIENCE_S = 1.0  # for a kernel without room: a command that waited longer means nothing
_RESERVE = bytes(56)  # a velocity: what leaves next is chosen when this much may be sent


class UdpTransport:
    """Owns the socket of one session. There is no end but silence, and the peer's system that refuses its port.

    An address that is not verified is behind while it has not sent enough for the next velocity.
    """

    kind = "udp"

    def __init__(
        self,
        connection: socket.socket,
        first: Datagram,
        *,
        is_verified: bool,
        dropped: Counter[str],
        on_other: Callable[[Datagram], object],
        on_limited: Callable[[], None] = lambda: None,
    ) -> None:
        """`first`: what began the session; `on_other`: for what came to this socket before it was connected.

        `on_limited`: called when something cannot be sent because the device is not verified.
        """
        self.peer = spelled(*first.source[:2])
        self.address: str = first.source[0]
        self._socket, self._first = connection, first
        self._allowance = Allowance(is_limited=not is_verified)
        self._dropped, self._on_other, self._on_limited = dropped, on_other, on_limited
        self._on_readable: Callable[[], None] = _ignore
        self._received = bytearray()
        self._unsent: list[bytes] = []
        self._is_reading = self._is_closed = False
        self._error: OSError | None = None
        self._progress = asyncio.Event()
        self.feed(first.data)

    @property
    def is_verified(self) -> bool:
        """Whether the device is known to be where its datagrams come from."""
        return not self._allowance.is_limited

    def verify(self) -> None:
        """The device has proven that it receives what is sent to its address."""
        self._allowance.is_limited = False
        self._progress.set()

    # -- from the device ----------------------------------------------------------------------------------------------

    def start(self, on_readable: Callable[[], None]) -> None:
        """From now on `on_readable` is called whenever bytes have come, and at the end."""
        self._on_readable = on_readable
        self._read_on()
        if self.unread_bytes or self.is_ended:
            on_readable()

    @property
    def unread_bytes(self) -> int:
        """What has come and was not read."""
        return len(self._received)

    @property
    def is_ended(self) -> bool:
        """Whether nothing more will come."""
        return self._is_closed or self._error is not None

    def read(self, limit_bytes: int) -> bytes:
        """What has come; b"" while there is nothing, and after `aclose`.

        Raises:
            OSError: the peer's system has nobody at that port, and everything before was read.
        """
        if not self._received and self._error is not None:
            raise self._error
        data = bytes(self._received[:limit_bytes])
        del self._received[:limit_bytes]
        self._read_on()
        return data

    def feed(self, data: bytes) -> None:
        """A datagram of this device that came by the port's own socket."""
        if self.is_ended or self._is_full:
            self._dropped["unread"] += 1
            return
        self._add(data)
        self._on_readable()

    async def receive(self) -> bytes:
        """What has come; b"" at the end."""
        came = asyncio.Event()
        self.start(came.set)
        await came.wait()
        return self.read(2 * READ_BYTES)

    @property
    def _is_full(self) -> bool:
        return len(self._received) >= READ_BYTES

    def _read_on(self) -> None:
        """Read the socket while there is room; else the kernel keeps what comes, up to its bound."""
        if not self._is_reading and not self._is_full and not self.is_ended:
            self._is_reading = True
            asyncio.get_running_loop().add_reader(self._socket, self._receive)

    def _stop_reading(self) -> None:
        if self._is_reading:
            self._is_reading = False
            asyncio.get_running_loop().remove_reader(self._socket)

    def _receive(self) -> None:
        for _ in range(DATAGRAMS_A_TURN):
            try:
                found = receive_from(self._socket, self._dropped)
            except BlockingIOError:
                break
            except ConnectionRefusedError:
                self._break()
                return
            except OSError:  # no way there at this moment; silence decides
                self._dropped["unreachable"] += 1
                continue
            if found is None:
                continue
            data, source = found
            if source[:2] != self._first.source[:2]:
                self._on_other(Datagram(data, source, self._first.local))
                continue
            self._add(data)
            if self._is_full:
                self._stop_reading()
                break
        if self._received:
            self._on_readable()

    def _add(self, data: bytes) -> None:
        self._received += data
        self._allowance.earn(len(data))
        self._progress.set()

    def _break(self) -> None:
        """ICMP: nobody has the device's port. As of TCP it is a reset; a refusal would be hostlink's own."""
        if not self.is_ended:
            self._error = ConnectionResetError(errno.ECONNRESET, "nobody has the device's port any more")
            self._stop_reading()
            self._progress.set()
            asyncio.get_running_loop().call_soon(self._on_readable)

    # -- to the device ------------------------------------------------------------------------------------------------

    def write(self, data: bytes) -> bool:
        """A frame is a datagram; one that no network passes whole is several.

        What may not be sent is dropped, as datagrams are: kept, it would move the robot after a stop that came later.
        """
        if self.is_ended:
            return False
        datagrams = [data[at : at + MAX_DATAGRAM_BYTES] for at in range(0, len(data), MAX_DATAGRAM_BYTES)]
        if self._allowance.allows(datagrams):
            self._unsent = datagrams
        else:
            self._give_up()
        return self._flush() and self._has_reserve

    async def drain(self) -> None:
        """Returns when what was written has left, and a velocity may be sent.

        Raises:
            OSError: the connection broke, or was closed.
        """
        await self._leave()
        while not self._has_reserve:
            if not await self._is_progress():
                self._on_limited()
            self._check()

    async def send(self, data: bytes) -> None:
        """Write, and wait until it has left."""
        self.write(data)
        await self._leave()
        await asyncio.sleep(0)  # nothing slows a sender of datagrams; others have their turn

    @property
    def _has_reserve(self) -> bool:
        return self._allowance.allows((_RESERVE,))

    def _give_up(self) -> None:
        self._unsent.clear()
        self._dropped["unsent"] += 1
        self._on_limited()

    async def _leave(self) -> None:
        """Returns when what was written has left, or the kernel had no room for it for PATIENCE_S."""
        self._check()
        loop = asyncio.get_running_loop()
        while not self._flush():
            loop.add_writer(self._socket, self._progress.set)
            try:
                if not await self._is_progress():
                    self._unsent.clear()
                    self._dropped["unsent"] += 1
            finally:
                if not self._is_closed:
                    loop.remove_writer(self._socket)
            self._check()

    async def _is_progress(self) -> bool:
        """Wait until something came or may leave, PATIENCE_S at most."""
        self._progress.clear()
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self._progress.wait()
        except TimeoutError:
            return False
        return True

    def _check(self) -> None:
        if self.is_ended:
            raise self._error or ConnectionResetError("connection lost")

    def _flush(self) -> bool:
        """Send what has room; whether all has left."""
        while self._unsent:
            try:
                self._socket.send(self._unsent[0])
            except BlockingIOError:
                return False
            except ConnectionRefusedError:
                self._break()
                return False
            except OSError:  # no way there at this moment; silence decides
                self._dropped["unreachable"] += 1
            self._allowance.spend(len(self._unsent.pop(0)))
        return True

    # -- its end ------------------------------------------------------------------------------------------------------

    def round_trip_s(self) -> float | None:
        """Nobody measures it."""
        return None

    def descriptor(self) -> int | None:
        """The socket's, until it is closed."""
        return None if self._is_closed else self._socket.fileno()

    async def aclose(self) -> None:
        """Close at once: what was sent has left."""
        if self._is_closed:
            return
        self._stop_reading()
        asyncio.get_running_loop().remove_writer(self._socket)
        self._is_closed = True
        self._progress.set()
        with contextlib.suppress(
            OSError
        ):  # a duplicate in another process gets none of the device's datagrams any more
            self._socket.connect(self._socket.getsockname())
        self._socket.close()
        on_readable, self._on_readable = self._on_readable, _ignore
        on_readable()


def _ignore() -> None:
    """Nobody reads yet: what comes waits."""
