"""A robot without a watchdog: it obeys the last velocity without end, and reports when each came.

Over TCP or on one end of a pseudo terminal. It reads as ros_lib does, as much at a time and as often as the test wants.
"""

import asyncio
import contextlib
import errno
import os
import socket
import struct
import time
from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.background import meanwhile
from tests.support.fake_device import robot_topics, topic
from tests.support.pty_pair import pty_pair
from tests.support.ros_lib_reader import RosLibReader
from tests.support.waiting import TIMEOUT_S, expect

ZERO = (0.0, 0.0)
BLOB_ID = 102
BLOB_BUFFER_BYTES = 32768
TURN_S = 0.002


@dataclass
class Reading:
    """Reading speed of the robot, and whether it drops frames that stop arriving."""

    bytes_a_turn: int = 65536
    turn_s: float = TURN_S
    gives_up: bool = True
    with_blobs: bool = False  # it also subscribes to long messages


@dataclass
class UnwatchedRobot:
    """Robot with the velocities that it has received."""

    name: str
    reading: Reading
    velocities: list[tuple[float, tuple[float, float]]] = field(default_factory=list)  # (time.monotonic, m/s and rad/s)
    stops: list[float] = field(default_factory=list)  # when id 11 came
    ended_at_s: float | None = None  # when the connection did
    reader: RosLibReader = field(init=False)
    descriptor: int = -1  # of its connection

    def __post_init__(self) -> None:
        self.reader = RosLibReader(self._receive, gives_up=self.reading.gives_up)

    def topics(self) -> list[DeviceEndpoint]:
        """Topics that the robot announces."""
        blob = topic(
            EndpointKind.SUBSCRIBER,
            BLOB_ID,
            f"/{self.name}/blob",
            "std_msgs/UInt8MultiArray",
            buffer_bytes=BLOB_BUFFER_BYTES,
        )
        return [*robot_topics(self.name), *([blob] if self.reading.with_blobs else [])]

    @property
    def is_moving(self) -> bool:
        """Whether its last velocity is not zero."""
        return bool(self.velocities) and self.velocities[-1][1] != ZERO

    async def stood(self, timeout_s: float = TIMEOUT_S) -> None:
        """Wait until id 11 has come, or the connection has ended."""
        await expect(lambda: self.stops or self.ended_at_s is not None, timeout_s=timeout_s)

    async def ended(self) -> None:
        """Wait for the connection's end."""
        await expect(lambda: self.ended_at_s is not None, timeout_s=TIMEOUT_S)

    def stood_after_s(self, since_s: float) -> float:
        """Return the time from `since_s` to the zero after which the robot did not move again; infinite without one."""
        moving = [index for index, (_, velocity) in enumerate(self.velocities) if velocity != ZERO]
        last = moving[-1] if moving else -1
        return self.velocities[last + 1][0] - since_s if last + 1 < len(self.velocities) else float("inf")

    async def read(self, descriptor: int) -> None:
        """Serve a connection until it ends. Late turns are made up for: the test is what was late, not the robot."""
        self.descriptor = descriptor
        due_s = time.monotonic()
        while self.ended_at_s is None:
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            due_s += self.reading.turn_s
            self._turn()

    def _turn(self) -> None:
        data = b""
        try:
            data = os.read(self.descriptor, self.reading.bytes_a_turn)
            has_ended = not data
        except OSError as error:
            has_ended = error.errno in (errno.EIO, errno.ECONNRESET, errno.EPIPE)
            if not has_ended and error.errno != errno.EAGAIN:
                raise
        if has_ended:
            self.ended_at_s = time.monotonic()
        self.reader.turn(data, time.monotonic())

    def _receive(self, topic_id: int, payload: bytes) -> None:
        if topic_id == Id.PUBLISHER:
            infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in self.topics())
            os.write(self.descriptor, encode(Id.TIME, bytes(8)) + infos + encode(Id.TIME, bytes(8)))
        elif topic_id == Id.STOP:
            self.stops.append(time.monotonic())
        elif topic_id == 100:
            twist = struct.unpack("<6d", payload)
            self.velocities.append((time.monotonic(), (twist[0], twist[5])))


@contextlib.asynccontextmanager
async def robot_on_tcp(
    address: tuple[str, int], name: str, reading: Reading | None = None, *, kind: int = socket.SOCK_STREAM
) -> AsyncIterator[UnwatchedRobot]:
    """Connected for the length of the block."""
    reading = reading or Reading()
    robot = UnwatchedRobot(name, reading)
    with socket.socket(type=kind) as connection:
        if reading.with_blobs:  # a small window, so that the daemon often waits in the middle of a frame
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect(address)
        connection.setblocking(False)
        if kind == socket.SOCK_DGRAM:
            connection.send(encode(Id.TIME, bytes(8)))  # by this the daemon knows of it
        async with meanwhile(robot.read(connection.fileno())):
            yield robot


def robot_on_udp(address: tuple[str, int], name: str) -> AbstractAsyncContextManager[UnwatchedRobot]:
    """Run a robot within the block. It begins with a time request."""
    return robot_on_tcp(address, name, kind=socket.SOCK_DGRAM)


@contextlib.asynccontextmanager
async def robot_on_pty(name: str) -> AsyncIterator[tuple[UnwatchedRobot, str]]:
    """(robot, path of its port) for the length of the block; the port vanishes at its end."""
    robot = UnwatchedRobot(name, Reading())
    with pty_pair() as (ours, path):
        os.set_blocking(ours, False)
        async with meanwhile(robot.read(ours)):
            yield robot, path
