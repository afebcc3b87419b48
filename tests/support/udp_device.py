"""UdpDevice: a FakeDevice that sends each piece as a datagram, and counts what passes."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator

from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.fake_device import FakeDevice
from tests.support.waiting import TIMEOUT_S

GREETING = encode(Id.TIME, bytes(8))


class UdpDevice(FakeDevice):
    """One connected socket."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self.sent_bytes = 0
        self.datagrams: list[bytes] = []  # that came
        self._stream = FrameStream()
        self._frames: list[Frame] = []

    @property
    def address(self) -> tuple[str, int]:
        """From where it sends."""
        host, port = self.socket.getsockname()[:2]
        return host, port

    @property
    def received_bytes(self) -> int:
        return sum(map(len, self.datagrams))

    async def send(self, data: bytes) -> None:
        """Send a datagram. Ignore an ICMP error of an earlier one."""
        self.sent_bytes += len(data)
        with contextlib.suppress(ConnectionRefusedError):
            self.socket.send(data)
        await asyncio.sleep(0)

    async def next(self) -> Frame:
        """The next frame of any kind."""
        async with asyncio.timeout(TIMEOUT_S):
            while not self._frames:
                data = await asyncio.get_running_loop().sock_recv(self.socket, 65536)
                self.datagrams.append(data)
                self._frames += [item for item in self._stream.feed(data) if isinstance(item, Frame)]
        return self._frames.pop(0)

    def read_waiting(self) -> list[bytes]:
        """The datagrams that have come and were not read."""
        came = []
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                came.append(self.socket.recv(65536))
        self.datagrams += came
        return came

    async def greet(self) -> None:
        """Send the datagram by which the host notices the device."""
        await self.send(GREETING)

    def hang_up(self) -> None:
        """Close the socket without informing the host."""
        self.socket.close()


@contextlib.asynccontextmanager
async def udp_device(
    address: tuple[str, int],
    topics: list[DeviceEndpoint] | None = None,
    *,
    local: tuple[str, int] = ("127.0.0.1", 0),
) -> AsyncIterator[UdpDevice]:
    """A device that sends a request for the time and announces its topics if it has any."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
        connection.setblocking(False)
        connection.bind(local)
        connection.connect(address)
        device = UdpDevice(connection)
        if topics is not None:
            await device.greet()
            await device.announce(topics)
        yield device
