"""A micro-ROS board of tests/support/xrce_board.py on a real connection: UDP, TCP or a serial port."""

import asyncio
import contextlib
import os
import socket
from collections import deque
from collections.abc import AsyncIterator, Callable
from random import Random
from typing import Any

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import cdr_of
from hostlink.core.messages.message_type import MessageType
from hostlink.core.runtime.cancellation import meanwhile
from hostlink.core.runtime.loop_time import loop_time_s
from tests.support import xrce_board as board
from tests.support.paced_port import PacedPort
from tests.support.uart import RING_BYTES, BoardUart
from tests.support.waiting import expect

TX_BYTES = 64  # of an Arduino's buffer in front of its UART: Serial.write blocks while it is full


def cdr(type_name: str, values: dict[str, Any]) -> bytes:
    """A message as a board writes it."""
    type_ = Catalog().message(type_name)
    assert isinstance(type_, MessageType)
    return cdr_of(type_).from_ros1(type_.encode(values))


class Device:
    """A program of a board that runs in the time of the event loop, until its connection is closed."""

    def __init__(
        self, program: Any, send: Callable[[bytes], None], codec: board.Datagrams, *, loss: float = 0.0
    ) -> None:
        """`loss`: share of the messages that are lost, each way."""
        self.stock, self.client = program, program.client
        self._send, self._codec, self._loss, self._random = send, codec, loss, Random(1)
        self._inbox: deque[bytes] = deque()
        self._came = asyncio.Event()

    def receive(self, data: bytes) -> None:
        """Take what came from the host."""
        self._inbox.extend(each for each in self._codec.decode(data) if self._random.random() >= self._loss)
        self._came.set()

    def wake(self) -> None:
        """Let the program continue as after a message, with an empty one."""
        self._inbox.append(b"")
        self._came.set()

    async def run(self) -> None:
        """Run the program to its end, then do nothing."""
        program, message = self.stock.run(), None
        with contextlib.suppress(StopIteration):
            while True:
                self.client.now_s = loop_time_s()
                until_s = next(program) if message is None else program.send(message)
                message = None
                for each in self.client.sent:
                    if self._random.random() >= self._loss:
                        self._send(self._codec.encode(each))
                self.client.sent = []
                message = await self._wait(until_s)
        await asyncio.Future()

    async def _wait(self, until_s: float) -> bytes | None:
        """Wait until that time, or until a message arrives that the program reads. Return the message."""
        if until_s < 0:
            await asyncio.sleep(-until_s - loop_time_s())
            return None
        while not self._inbox:
            self._came.clear()
            left_s = until_s - loop_time_s()
            if left_s <= 0:
                return None
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(left_s):
                    await self._came.wait()
        return self._inbox.popleft()

    async def is_at_work(self) -> None:
        """Wait until it has created everything, and publishes."""
        await expect(lambda: self.stock.published or self.stock.failed_at)
        assert not self.stock.failed_at


class UartDevice(Device):
    """A board on a serial line with a pace. Its program does not read while it writes, or does something else.

    What arrives meanwhile is in the ring. A program that reads takes one message, and leaves the rest there.
    """

    def __init__(self, program: Any, uart: BoardUart) -> None:
        super().__init__(program, self._write, board.Serial())
        self.uart = uart

    def arrive(self) -> None:
        """Let a program read that waits for bytes."""
        self._came.set()

    def _write(self, data: bytes) -> None:
        self.uart.to_host.send(data, loop_time_s())

    async def _wait(self, until_s: float) -> bytes | None:
        line = self.uart.to_host
        await self._pause(line.free_at_s - TX_BYTES * line.byte_s)
        if until_s < 0:
            await self._pause(-until_s)
            return None
        while not self._read():
            self._came.clear()
            left_s = until_s - loop_time_s()
            if left_s <= 0:
                return None
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(left_s):
                    await self._came.wait()
        return self._inbox.popleft()

    async def _pause(self, until_s: float) -> None:
        """Read nothing until then. A machine that is late loses nothing: the ring is as full as it was then."""
        left_s = until_s - loop_time_s()
        if left_s > 0:
            await asyncio.sleep(left_s)
            self.uart.from_host.settle(until_s)

    def _read(self) -> bool:
        """Read bytes to the end of a message. Return whether there is one."""
        now_s = loop_time_s()
        while not self._inbox and (byte := self.uart.from_host.take(now_s)) is not None:
            self.receive(bytes((byte,)))
        return bool(self._inbox)


def stock(*, key: bytes = b"\1\2\3\4", **how: bool | float) -> board.Stock:
    """The program of a board like linorobot2."""
    client = board.Client(key=key)
    pose = {"position": {"x": 0.5}, "orientation": {"w": 1.0}}
    odometry = cdr("nav_msgs/Odometry", {"header": {"frame_id": "odom"}, "pose": {"pose": pose}})
    return board.Stock(client, odometry, cdr("sensor_msgs/Imu", {"orientation": {"w": 1.0}}), **how)  # type: ignore[arg-type]


@contextlib.asynccontextmanager
async def udp_board(
    address: tuple[str, int],
    program: board.Stock | board.Talker | None = None,
    *,
    loss: float = 0.0,
    local: str = "127.0.0.1",
    local_port: int = 0,
) -> AsyncIterator[Device]:
    """A board with a socket of its own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connection:
        connection.setblocking(False)
        connection.bind((local, local_port))
        connection.connect(address)

        def send(data: bytes) -> None:
            with contextlib.suppress(ConnectionRefusedError):  # no host is there yet, or no more
                connection.send(data)

        def read() -> bytes:
            try:
                return connection.recv(65536)
            except (BlockingIOError, ConnectionRefusedError):
                return b""

        device = Device(program or stock(), send, board.Datagrams(), loss=loss)
        async with _running(device, connection.fileno(), read):
            yield device


@contextlib.asynccontextmanager
async def tcp_board(address: tuple[str, int], program: board.Stock | None = None) -> AsyncIterator[Device]:
    """A board with a TCP connection."""
    reader, writer = await asyncio.open_connection(*address)
    device = Device(program or stock(), writer.write, board.Lengths())

    async def receive() -> None:
        while data := await reader.read(65536):
            device.receive(data)

    try:
        async with meanwhile(("board", device.run()), ("receiving of the board", receive())):
            yield device
    finally:
        writer.transport.abort()


@contextlib.asynccontextmanager
async def serial_board(descriptor: int, program: board.Stock | None = None) -> AsyncIterator[Device]:
    """A board at the device's end of a pseudo-terminal."""

    def send(data: bytes) -> None:
        os.write(descriptor, data)

    def read() -> bytes:
        try:
            return os.read(descriptor, 65536)
        except (BlockingIOError, OSError):  # no host has the port open
            return b""

    device = Device(program or stock(), send, board.Serial())
    async with _running(device, descriptor, read):
        yield device


@contextlib.asynccontextmanager
async def uart_board(
    port: PacedPort, program: Any = None, *, baud: int, ring_bytes: int = RING_BYTES
) -> AsyncIterator[UartDevice]:
    """A board at a port with the pace of its line."""
    device = UartDevice(program or stock(), BoardUart(baud=baud, ring_bytes=ring_bytes))
    with port.plugged(device.uart, device.arrive):
        async with meanwhile(("board", device.run())):
            yield device


@contextlib.asynccontextmanager
async def _running(device: Device, descriptor: int, read: Callable[[], bytes]) -> AsyncIterator[None]:
    loop = asyncio.get_running_loop()

    def receive() -> None:
        data = read()
        if data:
            device.receive(data)

    loop.add_reader(descriptor, receive)
    try:
        async with meanwhile(("board", device.run())):
            yield
    finally:
        loop.remove_reader(descriptor)
