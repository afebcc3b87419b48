"""Connections whose descriptor another process holds too: their end is an end all the same."""

import asyncio
import contextlib
import os
import socket
from collections.abc import AsyncIterator, Iterator

import pytest

from hostlink.core.config import SerialConfig, TcpConfig
from hostlink.core.transport.base import CLOSE_TIMEOUT_S, Transport
from hostlink.core.transport.serial import open_serial
from hostlink.core.transport.tcp import serve_tcp
from tests.support.memory_transport import memory_pair
from tests.support.pty_pair import pty_pair
from tests.support.stopwatch import Stopwatch
from tests.support.tcp_server import never
from tests.support.waiting import TIMEOUT_S

TOO_MUCH_BYTES = 50_000_000


@contextlib.asynccontextmanager
async def tcp() -> AsyncIterator[tuple[Transport, socket.socket]]:
    """A transport and the device's end of it."""
    came: asyncio.Queue[Transport] = asyncio.Queue()
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), came.put_nowait, on_exhausted=never) as listener:
        with socket.socket() as peer:
            peer.connect(listener.address)
            peer.setblocking(False)
            transport = await came.get()
            try:
                yield transport, peer
            finally:
                await transport.aclose()


@contextlib.contextmanager
def duplicated(transport: Transport) -> Iterator[int]:
    """A duplicate, as another process has it."""
    descriptor = transport.descriptor()
    assert descriptor is not None
    duplicate = os.dup(descriptor)
    try:
        yield duplicate
    finally:
        os.close(duplicate)


async def read_to_end(peer: socket.socket) -> bytes:
    data = b""
    async with asyncio.timeout(TIMEOUT_S):
        while part := await asyncio.get_running_loop().sock_recv(peer, 65536):
            data += part
    return data


async def send_without_end(peer: socket.socket) -> None:
    async with asyncio.timeout(TIMEOUT_S):
        while True:
            await asyncio.get_running_loop().sock_sendall(peer, b"pose")
            await asyncio.sleep(0.001)


async def test_a_device_receives_the_end_at_once() -> None:
    async with tcp() as (transport, peer):
        with duplicated(transport):
            await transport.send(b"last words")
            await transport.aclose()
            assert await read_to_end(peer) == b"last words"


async def test_device_that_read_nothing_before_the_abort_receives_the_end() -> None:
    async with tcp() as (transport, peer):
        with duplicated(transport):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(0.1):
                    await transport.send(bytes(TOO_MUCH_BYTES))
            watch = Stopwatch()
            await transport.aclose()
            assert watch.seconds < CLOSE_TIMEOUT_S + 3.0
            assert 0 < len(await read_to_end(peer)) < TOO_MUCH_BYTES


async def test_bytes_that_a_device_sends_after_the_end_are_refused() -> None:
    async with tcp() as (transport, peer):
        with duplicated(transport):
            await transport.aclose()
            assert await read_to_end(peer) == b""
            with pytest.raises(ConnectionError):
                await send_without_end(peer)


async def test_a_serial_port_can_be_opened_again() -> None:
    with pty_pair() as (device, path):
        config = SerialConfig(path=path)
        transport = await open_serial(config)
        with duplicated(transport):
            await transport.aclose()
            again = await open_serial(config)
            try:
                await again.send(b"hello")
                assert os.read(device, 100) == b"hello"
                with pytest.raises(OSError, match="another program has it open"):
                    await open_serial(config)
            finally:
                await again.aclose()


async def test_a_transport_has_a_descriptor_until_it_is_closed() -> None:
    async with tcp() as (transport, peer):
        descriptor = transport.descriptor()
        assert descriptor is not None
        with socket.socket(fileno=os.dup(descriptor)) as same:
            assert same.getpeername() == peer.getsockname()
        await transport.aclose()
        assert transport.descriptor() is None


async def test_serial_port_has_a_descriptor_and_a_memory_transport_none() -> None:
    with pty_pair() as (_, path):
        transport = await open_serial(SerialConfig(path=path))
        descriptor = transport.descriptor()
        assert descriptor is not None
        assert os.ttyname(descriptor) == path
        await transport.aclose()
        assert transport.descriptor() is None
    assert memory_pair()[0].descriptor() is None


async def test_a_connection_that_broke_has_none() -> None:
    async with tcp() as (transport, peer):
        peer.close()
        with contextlib.suppress(OSError):
            while await transport.receive():
                pass
            while True:
                await transport.send(bytes(1000))
        assert transport.descriptor() is None
