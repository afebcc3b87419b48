"""Contract of every transport, checked on TCP, UDP, a serial line (a pseudo terminal) and in memory."""

import asyncio
import contextlib
import os
import resource
import socket
import struct
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import AsyncIterator, Callable

import pytest

from hostlink.core.config import SerialConfig, TcpConfig, UdpConfig
from hostlink.core.transport.base import CLOSE_TIMEOUT_S, READ_BYTES, Transport
from hostlink.core.transport.connection import KEEPALIVE
from hostlink.core.transport.serial import open_serial
from hostlink.core.transport.tcp import SEND_BUFFER_BYTES, USER_TIMEOUT_MS, serve_tcp
from hostlink.core.transport.udp import Datagram, UdpPort, UdpTransport, serve_udp
from hostlink.errors import ConfigError
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.pty_pair import pty_pair
from tests.support.stopwatch import Stopwatch
from tests.support.tcp_server import never

A_WHILE_S = 0.05
DATA = bytes(range(256)) * 16
CROWD = 40


class Peer(ABC):
    """The device's end of a transport."""

    @abstractmethod
    async def send(self, data: bytes) -> None: ...

    @abstractmethod
    async def receive(self, size: int) -> bytes: ...

    @abstractmethod
    async def close(self) -> None: ...

    async def break_off(self) -> None:
        await self.close()


class TcpPeer(Peer):
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def send(self, data: bytes) -> None:
        self.writer.write(data)
        await self.writer.drain()

    async def receive(self, size: int) -> bytes:
        return await self.reader.readexactly(size)

    async def close(self) -> None:
        self.writer.close()
        with contextlib.suppress(OSError):
            await self.writer.wait_closed()

    async def break_off(self) -> None:
        connection = self.writer.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # a reset, not an end
        self.writer.transport.abort()


class UdpPeer(Peer):
    def __init__(self, device: socket.socket) -> None:
        self.socket = device
        self.data = b""

    async def send(self, data: bytes) -> None:
        self.socket.send(data)
        await asyncio.sleep(0)

    async def receive(self, size: int) -> bytes:
        while len(self.data) < size:
            self.data += await asyncio.get_running_loop().sock_recv(self.socket, 65536)
        data, self.data = self.data[:size], self.data[size:]
        return data

    async def close(self) -> None:
        self.socket.close()


class PtyPeer(Peer):
    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        os.set_blocking(descriptor, False)

    async def send(self, data: bytes) -> None:
        loop = asyncio.get_running_loop()
        while data:
            await self._ready(loop.add_writer, loop.remove_writer)
            data = data[os.write(self.descriptor, data) :]

    async def receive(self, size: int) -> bytes:
        loop = asyncio.get_running_loop()
        data = b""
        while len(data) < size:
            await self._ready(loop.add_reader, loop.remove_reader)
            data += os.read(self.descriptor, size - len(data))
        return data

    async def close(self) -> None:
        os.close(self.descriptor)

    async def _ready(self, add: Callable[[int, Callable[[], None]], None], remove: Callable[[int], bool]) -> None:
        is_ready = asyncio.Event()
        add(self.descriptor, is_ready.set)
        try:
            await is_ready.wait()
        finally:
            remove(self.descriptor)


class MemoryPeer(Peer):
    def __init__(self, end: MemoryTransport) -> None:
        self.end = end
        self.data = b""

    async def send(self, data: bytes) -> None:
        await self.end.send(data)

    async def receive(self, size: int) -> bytes:
        while len(self.data) < size:
            self.data += await self.end.receive()
        data, self.data = self.data[:size], self.data[size:]
        return data

    async def close(self) -> None:
        await self.end.aclose()

    async def break_off(self) -> None:
        self.end.break_off()


@contextlib.asynccontextmanager
async def tcp() -> AsyncIterator[tuple[Transport, Peer]]:
    came: asyncio.Queue[Transport] = asyncio.Queue()
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), came.put_nowait, on_exhausted=never) as listener:
        peer = TcpPeer(*await asyncio.open_connection(*listener.address))
        transport = await came.get()
        try:
            yield transport, peer
        finally:
            await transport.aclose()
            await peer.close()


@contextlib.asynccontextmanager
async def udp() -> AsyncIterator[tuple[Transport, Peer]]:
    came: asyncio.Queue[UdpTransport] = asyncio.Queue()
    dropped: Counter[str] = Counter()

    def connect(port: UdpPort, first: Datagram) -> bool:
        connection = port.connect(first)
        transport = UdpTransport(connection, first, is_verified=True, dropped=dropped, on_other=lambda _: None)
        came.put_nowait(transport)
        return True

    async with serve_udp(UdpConfig(host="127.0.0.1", port=0), dropped, connect) as ports:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
            device.setblocking(False)
            device.connect(ports[0].address)
            device.send(b"!")
            transport = await came.get()
            assert await transport.receive() == b"!"
            try:
                yield transport, UdpPeer(device)
            finally:
                await transport.aclose()
    assert not dropped


@contextlib.asynccontextmanager
async def serial() -> AsyncIterator[tuple[Transport, Peer]]:
    with pty_pair() as (descriptor, path):
        transport = await open_serial(SerialConfig(path=path, baud=57600))
        try:
            yield transport, PtyPeer(descriptor)
        finally:
            await transport.aclose()


@contextlib.asynccontextmanager
async def memory() -> AsyncIterator[tuple[Transport, Peer]]:
    host, device = memory_pair()
    yield host, MemoryPeer(device)


@pytest.fixture(params=[tcp, udp, serial, memory], ids=lambda opened: opened.__name__)
async def ends(request: pytest.FixtureRequest) -> AsyncIterator[tuple[Transport, Peer]]:
    async with request.param() as pair:
        yield pair


@pytest.fixture(params=[tcp, serial, memory], ids=lambda opened: opened.__name__)
async def connected_ends(request: pytest.FixtureRequest) -> AsyncIterator[tuple[Transport, Peer]]:
    """Return both ends of transports that notice a slow or closed peer. A sender of datagrams notices neither."""
    async with request.param() as pair:
        yield pair


async def receive_exactly(transport: Transport, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = await transport.receive()
        assert 0 < len(piece) <= 2 * READ_BYTES
        data += piece
    return data


async def send_without_end(transport: Transport) -> None:
    while True:
        await transport.send(bytes(10_000))


async def has_ended(transport: Transport) -> bool:
    """Whether receive() says so: b"", or an OSError where the port itself has gone."""
    try:
        return await transport.receive() == b""
    except OSError:
        return True


class TestContract:
    """Rules that hold for every transport."""

    @pytest.mark.slow
    @pytest.mark.parametrize("piece_bytes", [1, 100, len(DATA)])
    async def test_bytes_arrive_in_order_however_split(self, ends: tuple[Transport, Peer], piece_bytes: int) -> None:
        transport, peer = ends
        pieces = [DATA[at : at + piece_bytes] for at in range(0, len(DATA), piece_bytes)]
        async with asyncio.TaskGroup() as tasks:
            from_device = tasks.create_task(receive_exactly(transport, len(DATA)))
            to_device = tasks.create_task(peer.receive(len(DATA)))
            for piece in pieces:
                await peer.send(piece)
                await transport.send(piece)
        assert from_device.result() == DATA
        assert to_device.result() == DATA

    async def test_a_cancelled_receive_loses_nothing(self, ends: tuple[Transport, Peer]) -> None:
        transport, peer = ends
        sent = [bytes([number]) * 3 for number in range(60)]
        got = b""
        async with asyncio.TaskGroup() as tasks:
            for number, piece in enumerate(sent):
                reading = tasks.create_task(transport.receive())
                await asyncio.sleep(0)
                await peer.send(piece)
                for _ in range(number % 6):  # the cancellation is before, with and after the bytes
                    await asyncio.sleep(0)
                reading.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    got += await reading
        wanted = b"".join(sent)
        got += await receive_exactly(transport, len(wanted) - len(got))
        assert got == wanted

    async def test_a_peer_that_closes_ends_the_reading(self, connected_ends: tuple[Transport, Peer]) -> None:
        transport, peer = connected_ends
        await peer.send(b"last words")
        assert await receive_exactly(transport, 10) == b"last words"
        await peer.close()
        assert await has_ended(transport)

    async def test_a_broken_connection_ends_a_receive_that_waits(self, connected_ends: tuple[Transport, Peer]) -> None:
        transport, peer = connected_ends
        async with asyncio.TaskGroup() as tasks:
            reading = tasks.create_task(has_ended(transport))
            await asyncio.sleep(0)
            await peer.break_off()
        assert reading.result()

    async def test_sending_into_a_broken_connection_is_an_os_error(self, ends: tuple[Transport, Peer]) -> None:
        transport, peer = ends
        await peer.break_off()
        with pytest.raises(OSError, match=r"."):
            await send_without_end(transport)

    async def test_send_waits_until_the_peer_reads(self, connected_ends: tuple[Transport, Peer]) -> None:
        transport, peer = connected_ends
        data = DATA * 256
        async with asyncio.TaskGroup() as tasks:
            sending = tasks.create_task(transport.send(data))
            done, _ = await asyncio.wait({sending}, timeout=A_WHILE_S)
            assert not done
            assert await peer.receive(len(data)) == data

    async def test_a_send_that_waits_can_be_cancelled_and_closing_is_bounded(
        self, ends: tuple[Transport, Peer]
    ) -> None:
        transport, _ = ends
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(A_WHILE_S):
                await send_without_end(transport)
        watch = Stopwatch()
        await transport.aclose()
        assert watch.seconds < CLOSE_TIMEOUT_S + 3.0  # tests/unit/core/transport/test_connection.py has the exact time
        assert await has_ended(transport)

    async def test_a_close_that_is_cancelled_aborts(self, ends: tuple[Transport, Peer]) -> None:
        transport, _ = ends
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(A_WHILE_S):
                await send_without_end(transport)
        with contextlib.suppress(TimeoutError):  # memory is closed at once
            async with asyncio.timeout(A_WHILE_S):
                await transport.aclose()
        async with asyncio.timeout(A_WHILE_S):
            assert await has_ended(transport)

    async def test_closing_twice_is_once(self, ends: tuple[Transport, Peer]) -> None:
        transport, _ = ends
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(transport.aclose())
            tasks.create_task(transport.aclose())
        await transport.aclose()
        assert await has_ended(transport)
        with pytest.raises(OSError, match="onnection lost"):
            await transport.send(b"too late")

    async def test_closing_ends_a_receive_that_waits(self, ends: tuple[Transport, Peer]) -> None:
        transport, _ = ends
        async with asyncio.TaskGroup() as tasks:
            reading = tasks.create_task(has_ended(transport))
            await asyncio.sleep(0)
            await transport.aclose()
        assert reading.result()

    async def test_bytes_sent_before_closing_still_arrive(self, ends: tuple[Transport, Peer]) -> None:
        transport, peer = ends
        async with asyncio.TaskGroup() as tasks:
            reading = tasks.create_task(peer.receive(len(DATA)))
            await transport.send(DATA)
            await transport.aclose()
        assert reading.result() == DATA

    async def test_the_peer_has_a_name(self, ends: tuple[Transport, Peer]) -> None:
        transport, _ = ends
        assert transport.address
        assert transport.peer.startswith(transport.address)


async def test_a_reset_is_an_os_error_that_names_it() -> None:
    async with tcp() as (transport, peer):
        await peer.break_off()
        with pytest.raises(ConnectionResetError, match="reset"):
            await transport.receive()


async def test_the_options_that_a_robot_needs() -> None:
    async with tcp() as (transport, _):
        connection = transport.transport.get_extra_info("socket")  # type: ignore[attr-defined]
        found = {name: connection.getsockopt(socket.IPPROTO_TCP, getattr(socket, name)) for name in KEEPALIVE}
        assert found == KEEPALIVE
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == USER_TIMEOUT_MS
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) <= 2 * SEND_BUFFER_BYTES  # Linux doubles it


@pytest.mark.parametrize(("host", "prefix"), [("127.0.0.1", "127.0.0.1:"), ("::1", "[::1]:")])
async def test_addresses_are_spelled_as_usual(host: str, prefix: str) -> None:
    came: asyncio.Queue[Transport] = asyncio.Queue()
    async with serve_tcp(TcpConfig(host=host, port=0), came.put_nowait, on_exhausted=never) as listener:
        peer = TcpPeer(*await asyncio.open_connection(*listener.address))
        transport = await came.get()
        assert transport.address == host
        assert transport.peer == f"{prefix}{peer.writer.get_extra_info('sockname')[1]}"
        await transport.aclose()
        await peer.close()


async def test_a_port_in_use_is_named_in_the_error() -> None:
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), lambda _: None, on_exhausted=never) as listener:
        with pytest.raises(
            ConfigError, match="is in use, probably by another rosserial host; stop it, or choose another"
        ):
            async with serve_tcp(
                TcpConfig(host="127.0.0.1", port=listener.address[1]), lambda _: None, on_exhausted=never
            ):
                raise AssertionError("two listeners on one port")


@pytest.mark.parametrize(
    ("config", "text"),
    [
        (TcpConfig(port=65536), r"^TCP 0\.0\.0\.0:65536: invalid port; choose 0 \(any free port\) to 65535$"),
        (
            TcpConfig(host="192.0.2.1"),
            r"^TCP 192\.0\.2\.1:11411: cannot be listened on: (Cannot assign requested|could not bind on any) address",
        ),
        (TcpConfig(host="a" * 70), "invalid host name; choose another with --listen HOST:PORT"),
        (TcpConfig(host="2001:db8::1"), r"^TCP \[2001:db8::1\]:11411: cannot be listened on: "),
    ],
)
async def test_an_address_that_cannot_be_listened_on_gives_the_reason(config: TcpConfig, text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        async with serve_tcp(config, lambda _: None, on_exhausted=never):
            raise AssertionError("it listens")


async def test_the_listener_outlives_a_lack_of_descriptors() -> None:
    loop = asyncio.get_running_loop()
    is_short = asyncio.Event()
    came: asyncio.Queue[Transport] = asyncio.Queue()
    usual = resource.getrlimit(resource.RLIMIT_NOFILE)
    config = TcpConfig(host="127.0.0.1", port=0)
    async with serve_tcp(config, came.put_nowait, on_exhausted=is_short.set) as listener:
        with socket.socket() as device:
            device.setblocking(False)
            resource.setrlimit(resource.RLIMIT_NOFILE, (device.fileno() + 1, usual[1]))
            try:
                await loop.sock_connect(device, listener.address)
                await is_short.wait()
            finally:
                resource.setrlimit(resource.RLIMIT_NOFILE, usual)
            transport = await came.get()  # the acceptor tries again
            await transport.aclose()


async def test_of_a_crowd_that_connects_at_once_few_are_accepted_in_one_turn_of_the_loop() -> None:
    turn, turns = 0, []
    accepted: list[Transport] = []

    def accept(transport: Transport) -> None:
        accepted.append(transport)
        turns.append(turn)

    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), accept, on_exhausted=never) as listener:
        with contextlib.ExitStack() as crowd:
            for _ in range(CROWD):  # all of them in one turn
                crowd.enter_context(socket.create_connection(listener.address))
            while len(accepted) < CROWD:
                turn += 1
                await asyncio.sleep(0)
        for transport in accepted:
            await transport.aclose()
    assert max(map(turns.count, turns)) <= 2  # newer Pythons accept one more than they are given


async def test_a_port_that_vanishes_while_writing_leaves_no_traceback(caplog: pytest.LogCaptureFixture) -> None:
    async with serial() as (transport, peer):
        await peer.close()
        with pytest.raises(OSError, match="Input/output error"):
            await transport.send(b"to nobody")
        assert await has_ended(transport)
    assert caplog.text == ""
