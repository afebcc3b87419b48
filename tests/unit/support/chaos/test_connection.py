"""Connections of datagrams: how they send, and what their ends are."""

import asyncio
import contextlib
import random
import socket
from collections.abc import Iterator

from tests.support.chaos.connection import DATAGRAM_BYTES, DatagramConnection
from tests.support.chaos.stage import Stage


@contextlib.contextmanager
def port() -> Iterator[socket.socket]:
    with socket.socket(type=socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.setblocking(False)
        yield made


async def test_data_is_sent_in_datagrams_that_pass_a_wifi_whole() -> None:
    with port() as daemon:
        device = await DatagramConnection.dial(daemon.getsockname(), "127.0.9.1", "device")
        data = random.Random(1).randbytes(3 * DATAGRAM_BYTES + 10)
        await device.send(data)
        came = [daemon.recvfrom(65536) for _ in range(4)]
        assert b"".join(datagram for datagram, _ in came) == data
        assert [len(datagram) for datagram, _ in came] == [*[DATAGRAM_BYTES] * 3, 10]
        daemon.sendto(b"answer", came[0][1])
        assert await device.receive() == b"answer"
        device.close()


async def test_a_cut_ends_what_waits_for_a_datagram() -> None:
    with port() as daemon:
        device = await DatagramConnection.dial(daemon.getsockname(), "127.0.9.1", "device")
        async with asyncio.timeout(5), asyncio.TaskGroup() as tasks:
            waiting = tasks.create_task(device.receive())
            await asyncio.sleep(0)
            device.cut()
            assert await waiting == b""
        device.close()


async def test_a_part_of_the_devices_come_over_udp_and_leave_their_room() -> None:
    with port() as daemon, socket.create_server(("127.0.0.1", 0)) as tcp:
        stage = Stage(tcp.getsockname(), tcp.getsockname(), lambda _: None, daemon.getsockname())
        kinds = []
        for number in range(20):
            async with stage.device(random.Random(number)) as device:
                kinds.append(isinstance(device, DatagramConnection))
        assert set(kinds) == {True, False}
        without = Stage(tcp.getsockname(), tcp.getsockname(), lambda _: None)
        async with without.device(random.Random(kinds.index(True))) as device:
            assert not isinstance(device, DatagramConnection)
