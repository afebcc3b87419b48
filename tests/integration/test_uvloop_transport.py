"""What the TCP transport uses of a loop, on uvloop: one buffer a read, back-pressure, options and descriptors."""

import asyncio
import os
import socket

import pytest
import uvloop

from hostlink.config import TcpConfig
from hostlink.transport.base import READ_BYTES, Transport
from hostlink.transport.tcp import RECEIVE_BUFFER_BYTES, serve_tcp

FLOOD = bytes(range(256)) * 4096  # a megabyte

pytestmark = pytest.mark.filterwarnings("default::DeprecationWarning")


async def flooded() -> list[bytes]:
    """A peer sends a megabyte to a transport that is read later; returns what each call gave."""
    accepted: asyncio.Future[Transport] = asyncio.get_running_loop().create_future()
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), accepted.set_result) as listener:
        with socket.create_connection(listener.address) as peer:
            peer.setblocking(False)
            transport = await accepted
            async with asyncio.TaskGroup() as tasks:
                tasks.create_task(asyncio.get_running_loop().sock_sendall(peer, FLOOD))
                await asyncio.sleep(0.2)  # nobody reads: the system must hold the peer back
                pieces: list[bytes] = []
                while sum(map(len, pieces)) < len(FLOOD):
                    pieces.append(await transport.receive())
            await transport.aclose()
    return pieces


def test_a_flood_is_read_in_pieces_of_one_buffer() -> None:
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        pieces = runner.run(flooded())
    assert b"".join(pieces) == FLOOD
    assert max(map(len, pieces)) < 2 * READ_BYTES


async def options() -> None:
    accepted: asyncio.Future[Transport] = asyncio.get_running_loop().create_future()
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), accepted.set_result) as listener:
        with socket.create_connection(listener.address) as peer:
            transport = await accepted
            number = transport.descriptor()
            assert number is not None
            with socket.socket(fileno=os.dup(number)) as same:
                assert same.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
                assert same.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) == 2 * RECEIVE_BUFFER_BYTES  # Linux's way
                await transport.send(b"hello")
                assert peer.recv(8) == b"hello"
                assert transport.round_trip_s() is not None
                await transport.aclose()
                assert transport.descriptor() is None
                assert peer.recv(8) == b""  # the end arrives although a duplicate is open


def test_its_sockets_have_the_options_and_a_descriptor_to_duplicate() -> None:
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(options())
