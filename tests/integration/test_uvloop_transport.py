"""Functions of an event loop that the daemon uses, on uvloop: reads, backpressure, options, descriptors, timers."""

import asyncio
import os
import random
import socket
import time
from collections.abc import Coroutine
from typing import TypeVar

import pytest

from hostlink.cli.uvloop_loop import UvLoop
from hostlink.core.config import Config, TcpConfig, UdpConfig
from hostlink.core.transport.base import READ_BYTES, Transport
from hostlink.core.transport.tcp import RECEIVE_BUFFER_BYTES, serve_tcp
from tests.support.daemon import daemon
from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.rosbridge import client
from tests.support.tcp_server import never
from tests.support.udp_device import udp_device
from tests.support.waiting import expect

T = TypeVar("T")
FLOOD = bytes(range(256)) * 4096  # a megabyte

pytestmark = pytest.mark.filterwarnings("default::DeprecationWarning")


def run(work: Coroutine[None, None, T]) -> T:
    with asyncio.Runner(loop_factory=UvLoop) as runner:
        return runner.run(work)


async def flooded() -> list[bytes]:
    """A peer sends a megabyte to a transport that is read later; returns what each call gave."""
    accepted: asyncio.Future[Transport] = asyncio.get_running_loop().create_future()
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), accepted.set_result, on_exhausted=never) as listener:
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
    pieces = run(flooded())
    assert b"".join(pieces) == FLOOD
    assert max(map(len, pieces)) < 2 * READ_BYTES


async def options() -> None:
    accepted: asyncio.Future[Transport] = asyncio.get_running_loop().create_future()
    async with serve_tcp(TcpConfig(host="127.0.0.1", port=0), accepted.set_result, on_exhausted=never) as listener:
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
    run(options())


async def robot_over_udp() -> None:
    config = Config(udp=UdpConfig(host="127.0.0.1", port=0, trusted=("127.0.0.0/8",)))
    async with daemon(config) as host, udp_device(host.udp, robot_topics()) as device:
        await device.send(pose(1.0))
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages == 1)
        await host.drive("robot_0", b'{"linear": 0.2, "angular": 0}')
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)


def test_a_robot_over_udp_is_read_and_driven() -> None:
    run(robot_over_udp())


async def lateness_of_timers_s() -> list[float]:
    loop, draw = asyncio.get_running_loop(), random.Random(7)
    found: list[float] = []
    for _ in range(200):
        fired = asyncio.Event()
        due_s = loop.time() + draw.uniform(-0.001, 0.004)
        loop.call_at(due_s, fired.set)
        await fired.wait()
        found.append(loop.time() - due_s)
    return found


def test_a_timer_fires_at_its_time_or_later_by_the_loops_clock() -> None:
    assert min(run(lateness_of_timers_s())) >= 0


async def clocks_s() -> list[tuple[float, float, float]]:
    loop = asyncio.get_running_loop()
    return [(time.monotonic(), loop.time(), time.monotonic()) for _ in range(1000)]


def test_the_clock_is_the_monotonic_one_in_full_resolution() -> None:
    assert all(before_s <= now_s <= after_s for before_s, now_s, after_s in run(clocks_s()))


async def last_throttled_messages() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odometry", throttle_rate=10, queue_length=1)
        await expect(lambda: len(host.hub.topics.find("/robot_0/odometry").subscribers) == 2)
        for number in range(0, 60, 2):
            await device.send(pose(float(number)) + pose(float(number + 1)))
            while (await program.receive())["msg"]["x"] != number + 1:
                pass


def test_the_last_message_of_a_throttled_subscription_is_sent() -> None:
    """A timer that fires before the message is due would leave it in the queue."""
    run(last_throttled_messages())
