"""Functions of uvloop that the TCP and UDP transports use: small reads, backpressure, options, descriptors."""

import asyncio
import os
import socket

import pytest
import uvloop

from hostlink.config import Config, TcpConfig, UdpConfig
from hostlink.transport.base import READ_BYTES, Transport
from hostlink.transport.tcp import RECEIVE_BUFFER_BYTES, serve_tcp
from tests.support.daemon import daemon
from tests.support.fake_device import pose, robot_topics
from tests.support.udp_device import udp_device
from tests.support.waiting import expect

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
                await asyncio.sleep(0.2)  # without a reader the kernel must hold the peer back
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


async def robot_over_udp() -> None:
    config = Config(udp=UdpConfig(host="127.0.0.1", port=0, trusted=("127.0.0.0/8",)))
    async with daemon(config) as host, udp_device(host.udp, robot_topics()) as device:
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
        await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.2, "angular": 0}')
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)


def test_a_robot_over_udp_is_read_and_driven() -> None:
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(robot_over_udp())
