"""Devices behind hostlink's own transports for TCP, serial ports and UDP, without an operating system.

`deliver` is one read of the system. `Flood` makes each read a full one, behind which more waits.
"""

import asyncio
import contextlib
from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import Any, cast

from hostlink.core.hub.hub import Hub
from hostlink.core.link.link import Link
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.transport.base import READ_BYTES, Transport
from hostlink.core.transport.connection import StreamTransport
from hostlink.core.transport.serial import TTY_BYTES, SerialTransport
from hostlink.core.transport.udp import DATAGRAMS_A_TURN, Datagram, UdpTransport
from tests.support.api_memory import ApiTransport
from tests.support.device_codec import encode_log
from tests.support.fake_device import announcement
from tests.support.virtual_loop import VirtualLoop

LOG_LINE = encode(Id.LOG, encode_log(Log(0, "the wheels turn at 12.3 rad/s")))
FLOOD_INTERVAL_S = 0.01


class Flood:
    """Bytes of a source that writes more than is read: from `begin` on, every read is full."""

    def __init__(self, deliver: Callable[[bytes], None], read_bytes: int, padding: bytes = LOG_LINE) -> None:
        self._deliver, self._read_bytes, self._padding = deliver, read_bytes, padding
        self._waiting = bytearray()
        self._task: asyncio.Task[None] | None = None

    def begin(self) -> None:
        self._task = self._task or asyncio.get_running_loop().create_task(self._run(), name="flood")

    def end(self) -> None:
        if self._task is not None:
            self._task.cancel()

    def send(self, data: bytes) -> None:
        """Deliver data at once, or behind what waits."""
        if self._task is None:
            self._deliver(data)
        else:
            self._waiting += data

    async def _run(self) -> None:
        while True:
            while len(self._waiting) < self._read_bytes:
                self._waiting += self._padding
            data = bytes(self._waiting[: self._read_bytes])
            del self._waiting[: self._read_bytes]
            self._deliver(data)
            await asyncio.sleep(FLOOD_INTERVAL_S)


class WiredDevice:
    """A device that announces its topics each time that they are requested."""

    transport: Transport
    read_bytes = READ_BYTES

    def __init__(self, hub: Hub, infos: Sequence[DeviceEndpoint]) -> None:
        self.link: Link
        self._hub, self._infos, self._stream = hub, infos, FrameStream()
        self.flood = Flood(self.deliver, self.read_bytes)

    def begin(self) -> None:
        self.link = self._hub.links.open(self.transport, ROSSERIAL)
        self._hub.spawn(self._hub.links.serve(self.link), name=f"link of {self.transport.peer}")

    def deliver(self, data: bytes) -> None:
        """Let the system return these bytes in one read."""
        raise NotImplementedError

    def receive(self, data: bytes) -> None:
        """Handle bytes of the host."""
        for frame in self._stream.feed(data):
            if isinstance(frame, Frame) and frame.topic_id == Id.PUBLISHER:
                asyncio.get_running_loop().call_soon(self.flood.send, announcement(self._infos))

    def vanish(self) -> None:
        """Lose the connection."""
        self.flood.end()
        self._lose()

    def _lose(self) -> None:
        raise NotImplementedError


class _System(ApiTransport):
    """asyncio's transport of a device's connection."""

    def __init__(self, peer: str, on_written: Callable[[bytes], None]) -> None:
        super().__init__(peer)
        self._on_written = on_written

    def write(self, data: Any) -> None:
        self._on_written(bytes(data))


class TcpDevice(WiredDevice):
    transport: StreamTransport

    def __init__(self, hub: Hub, infos: Sequence[DeviceEndpoint]) -> None:
        super().__init__(hub, infos)
        self._system = _System("10.0.0.3", self.receive)
        self.transport = self._made()
        self._system.protocol = self.transport
        self.transport.connection_made(self._system)
        self.begin()

    def _made(self) -> StreamTransport:
        return StreamTransport(peer="10.0.0.3:40000", address="10.0.0.3")

    def deliver(self, data: bytes) -> None:
        if not self._system.is_closed and not self._system.is_paused:
            self.transport.data_received(data)

    def _lose(self) -> None:
        if not self._system.is_closed:
            self._system.abort()


class _Port:
    """An open serial port."""

    is_open = True
    write_error = None

    def fileno(self) -> int:
        return -1

    def waiting_bytes(self) -> int:
        return 0


class SerialDevice(TcpDevice):
    read_bytes = TTY_BYTES

    def _made(self) -> StreamTransport:
        return SerialTransport(cast(Any, _Port()), peer="/dev/ttyACM0", address="/dev/ttyACM0")


class _Socket:
    """A connected socket of UDP whose datagrams the test delivers."""

    def __init__(self, peer: tuple[str, int], on_sent: Callable[[bytes], None]) -> None:
        self.waiting: deque[bytes] = deque()
        self.is_refused = False
        self._peer, self._on_sent = peer, on_sent

    def recvfrom_into(self, into: bytearray) -> tuple[int, tuple[str, int]]:
        if self.is_refused:
            raise ConnectionRefusedError
        if not self.waiting:
            raise BlockingIOError
        data = self.waiting.popleft()
        into[: len(data)] = data
        return len(data), self._peer

    def send(self, data: bytes) -> int:
        self._on_sent(data)
        return len(data)

    def fileno(self) -> int:
        return -1

    def getsockname(self) -> tuple[str, int]:
        return "10.0.0.1", 11411

    def connect(self, _: tuple[str, int]) -> None: ...
    def close(self) -> None: ...


class UdpDeviceInMemory(WiredDevice):
    read_bytes = 1400 * (DATAGRAMS_A_TURN + 1)

    def __init__(self, hub: Hub, infos: Sequence[DeviceEndpoint]) -> None:
        super().__init__(hub, infos)
        peer = ("10.0.0.3", 40000)
        self._socket = _Socket(peer, self.receive)
        first = Datagram(encode(Id.TIME, bytes(8)), peer, self._socket.getsockname())
        self.transport = UdpTransport(
            cast(Any, self._socket), first, is_verified=True, dropped=Counter(), on_other=lambda _: None
        )
        self.begin()

    def deliver(self, data: bytes) -> None:
        """Let datagrams arrive that the loop reads in one turn, one more than it does in the next."""
        if len(self._socket.waiting) <= DATAGRAMS_A_TURN:
            self._socket.waiting.extend(data[at : at + 1400] for at in range(0, len(data), 1400))
        self._readable()

    def _readable(self) -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        with contextlib.suppress(KeyError):
            loop.readers[self._socket]()

    def _lose(self) -> None:
        self._socket.is_refused = True
        self._readable()
