"""The pseudo-terminal with the pace of a serial line, and a board at its end."""

import os
import select
import termios
import time
from collections.abc import Iterator

import pytest

from hostlink.core.protocol.resampling import resample
from tests.support.paced_port import PacedPort, paced_port
from tests.support.uart import BoardUart
from tests.support.waiting import expect

SPEEDS = {115200: termios.B115200, 57600: termios.B57600}


def opened(port: PacedPort, baud: int) -> int:
    """Open the port as a host does."""
    host = os.open(port.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    settings = termios.tcgetattr(host)
    settings[4] = settings[5] = SPEEDS[baud]
    termios.tcsetattr(host, termios.TCSANOW, settings)
    return host


@pytest.fixture
def hosts() -> Iterator[list[int]]:
    made: list[int] = []
    yield made
    for each in made:
        os.close(each)


async def test_bytes_take_the_time_of_the_line_in_both_directions(hosts: list[int]) -> None:
    async with paced_port() as port:
        hosts.append(opened(port, 115200))
        board, data = BoardUart(baud=115200, ring_bytes=4096), bytes(range(1, 251)) * 4
        with port.plugged(board):
            began_s = time.monotonic()
            os.write(hosts[0], data)
            board.to_host.send(data, began_s)
            read, received = bytearray(), bytearray()
            while len(received) < len(data) or len(read) < len(data):
                await expect(lambda: read_into(read, hosts[0]) or board.from_host.next_arrival_s() is not None)
                received += board.from_host.pop(time.monotonic())
            assert (read, received) == (data, data)
            assert time.monotonic() - began_s > 0.9 * len(data) * 10 / 115200


def read_into(read: bytearray, host: int) -> bool:
    try:
        data = os.read(host, 4096)
    except BlockingIOError:
        return False
    read += data
    return bool(data)


async def test_board_at_another_rate_than_the_port_reads_and_sends_other_bytes(hosts: list[int]) -> None:
    async with paced_port() as port:
        hosts.append(opened(port, 115200))
        board, data, read = BoardUart(baud=57600), b"hostlink" * 2, bytearray()
        with port.plugged(board):
            board.to_host.send(data, time.monotonic())
            wanted = resample(data, ratio=2.0)
            await expect(lambda: (read_into(read, hosts[0]), bytes(read) == wanted)[1])
            os.write(hosts[0], data)
            await expect(lambda: port.arrived)
            await expect(lambda: len(board.from_host.pop(time.monotonic() + 1)) > 0)
            assert board.from_host.read_baud == 57600


async def test_bytes_to_a_board_that_is_not_there_are_lost(hosts: list[int]) -> None:
    async with paced_port() as port:
        hosts.append(opened(port, 115200))
        os.write(hosts[0], b"lost")
        await expect(lambda: not readable(port))
        board = BoardUart(baud=115200)
        with port.plugged(board):
            os.write(hosts[0], b"kept")
            await expect(lambda: port.arrived)
        assert b"".join(data for _, data in port.arrived) == b"kept"


def readable(port: PacedPort) -> bool:
    return bool(select.select([port._descriptor], [], [], 0)[0])
