"""What every transport promises, checked on TCP and on a serial line (a pseudo terminal)."""

import asyncio
import contextlib
import os
import socket
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator

import pytest

from hostlink.config import SerialConfig, TcpConfig
from hostlink.errors import ConfigError
from hostlink.transport.base import CLOSE_TIMEOUT_S, Transport
from hostlink.transport.serial import open_serial
from hostlink.transport.tcp import SEND_BUFFER_BYTES, serve_tcp
from tests.support.pty_pair import pty_pair

PATIENCE_S = 5.0


class Peer(ABC):
    """The device's end of a transport."""

    @abstractmethod
    async def send(self, data: bytes) -> None: ...

    @abstractmethod
    async def receive(self, size: int) -> bytes: ...

    @abstractmethod
    async def close(self) -> None: ...


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
        await self.writer.wait_closed()


class PtyPeer(Peer):
    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        os.set_blocking(descriptor, False)

    async def send(self, data: bytes) -> None:
        await self._ready(asyncio.get_running_loop().add_writer, asyncio.get_running_loop().remove_writer)
        assert os.write(self.descriptor, data) == len(data)

    async def receive(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            await self._ready(asyncio.get_running_loop().add_reader, asyncio.get_running_loop().remove_reader)
            data += os.read(self.descriptor, size - len(data))
        return data

    async def close(self) -> None:
        os.close(self.descriptor)

    async def _ready(self, add: object, remove: object) -> None:
        is_ready = asyncio.Event()
        add(self.descriptor, is_ready.set)  # type: ignore[operator]
        try:
            await is_ready.wait()
        finally:
            remove(self.descriptor)  # type: ignore[operator]


@contextlib.asynccontextmanager
async def tcp() -> AsyncIterator[tuple[Transport, Peer]]:
    came: asyncio.Queue[Transport] = asyncio.Queue()
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), came.put_nowait) as listener:
        peer = TcpPeer(*await asyncio.open_connection(*listener.address))
        transport = await came.get()
        try:
            yield transport, peer
        finally:
            await transport.aclose()
            with contextlib.suppress(OSError):
                await peer.close()


@contextlib.asynccontextmanager
async def serial() -> AsyncIterator[tuple[Transport, Peer]]:
    with pty_pair() as (descriptor, path):
        transport = await open_serial(SerialConfig(path=path, baud=57600))
        try:
            yield transport, PtyPeer(descriptor)
        finally:
            await transport.aclose()


both = pytest.mark.parametrize("pair", [tcp, serial], ids=["tcp", "serial"])


@both
async def test_bytes_arrive_in_order_both_ways(pair: object) -> None:
    data = bytes(range(256)) * 8
    async with pair() as (transport, peer), asyncio.timeout(PATIENCE_S):  # type: ignore[operator]
        for at in range(0, len(data), 100):
            await peer.send(data[at : at + 100])
        got = b""
        while len(got) < len(data):
            got += await transport.receive()
        assert got == data
        async with asyncio.TaskGroup() as tasks:
            read = tasks.create_task(peer.receive(len(data)))
            for at in range(0, len(data), 100):
                await transport.send(data[at : at + 100])
            assert await read == data


@both
async def test_a_cancelled_receive_loses_nothing(pair: object) -> None:
    async with pair() as (transport, peer), asyncio.timeout(PATIENCE_S):  # type: ignore[operator]
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.02):
                await transport.receive()
        await peer.send(b"later")
        assert await transport.receive() == b"later"


@both
async def test_a_peer_that_goes_away_ends_the_reading(pair: object) -> None:
    async with pair() as (transport, peer), asyncio.timeout(PATIENCE_S):  # type: ignore[operator]
        await peer.send(b"last words")
        assert await transport.receive() == b"last words"
        await peer.close()
        with contextlib.suppress(
            OSError
        ):  # a port that vanishes is an error, a closed connection an end: both are ends
            assert await transport.receive() == b""


@both
async def test_closing_twice_is_once(pair: object) -> None:
    async with pair() as (transport, _):  # type: ignore[operator]
        await transport.aclose()
        await transport.aclose()
        with contextlib.suppress(OSError):
            assert await transport.receive() == b""


async def send_without_end(transport: Transport) -> None:
    async with asyncio.timeout(1.0):
        while True:
            await transport.send(bytes(10_000))


async def test_a_peer_that_never_reads_blocks_the_sender_alone_and_closing_is_bounded() -> None:
    async with tcp() as (transport, _):
        with pytest.raises(TimeoutError):
            await send_without_end(transport)
        began_s = asyncio.get_running_loop().time()
        await transport.aclose()
        assert asyncio.get_running_loop().time() - began_s < CLOSE_TIMEOUT_S + 0.5


async def test_a_reset_is_an_os_error() -> None:
    async with tcp() as (transport, peer):
        assert isinstance(peer, TcpPeer)
        connection = peer.writer.get_extra_info("socket")
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
        peer.writer.transport.abort()
        with pytest.raises(OSError, match="reset"):
            await transport.receive()


async def test_the_options_that_a_robot_needs() -> None:
    async with tcp() as (transport, peer):
        assert isinstance(peer, TcpPeer)
        connection = transport._writer.get_extra_info("socket")  # type: ignore[attr-defined]
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) <= 2 * SEND_BUFFER_BYTES  # Linux doubles it
        assert transport.address == "127.0.0.1"
        assert transport.peer.startswith("127.0.0.1:")


async def test_ipv6_addresses_are_spelled_as_usual() -> None:
    came: asyncio.Queue[Transport] = asyncio.Queue()
    async with serve_tcp(TcpConfig(host="::1", port=0), came.put_nowait) as listener:
        peer = TcpPeer(*await asyncio.open_connection(*listener.address))
        transport = await came.get()
        assert transport.address == "::1"
        assert transport.peer.startswith("[::1]:")
        await transport.aclose()
        await peer.close()


async def test_a_taken_port_says_so() -> None:
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), lambda _: None) as listener:
        with pytest.raises(ConfigError, match="is in use: another host for rosserial runs"):
            async with serve_tcp(TcpConfig(host="127.0.0.1", port=listener.address[1]), lambda _: None):
                raise AssertionError("two listeners on one port")


@pytest.mark.parametrize(
    ("path", "text"),
    [("/dev/ttyNONE", "no such port; there are:"), ("/dev/null", "/dev/null: ")],
)
async def test_a_port_that_cannot_be_opened_says_why(path: str, text: str) -> None:
    with pytest.raises(OSError, match=text):
        await open_serial(SerialConfig(path=path))


async def test_a_port_that_another_program_has_says_so() -> None:
    with pty_pair() as (_, path):
        first = await open_serial(SerialConfig(path=path))
        with pytest.raises(OSError, match="another program has it open"):
            await open_serial(SerialConfig(path=path))
        await first.aclose()
