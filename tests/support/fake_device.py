"""FakeDevice: the device side of rosserial on a socket, as a script: it does what the test calls, and nothing else."""

import asyncio
import contextlib
import socket
import struct
from collections.abc import AsyncIterator, Iterable

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.background import meanwhile
from tests.support.waiting import TIMEOUT_S

CATALOG = Catalog()


def message_type(name: str) -> MessageType:
    """A type of the catalogue, which has it."""
    found = CATALOG.message(name)
    assert found is not None, name
    return found


def service_type(name: str) -> ServiceType:
    """A type of a service of the catalogue, which has it."""
    found = CATALOG.service(name)
    assert found is not None, name
    return found


def topic(kind: EndpointKind, topic_id: int, name: str, type_name: str, *, buffer_bytes: int = 512) -> DeviceEndpoint:
    """An endpoint with the md5 that its type has."""
    if kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER):
        return DeviceEndpoint(kind, topic_id, name, type_name, message_type(type_name).md5, buffer_bytes)
    service = service_type(type_name)
    is_request = kind in (EndpointKind.SERVICE_SERVER_SUBSCRIBER, EndpointKind.SERVICE_CLIENT_PUBLISHER)
    return DeviceEndpoint(
        kind, topic_id, name, type_name, (service.request if is_request else service.response).md5, buffer_bytes
    )


def service_server(name: str, type_name: str, response_id: int = 125, request_id: int = 100) -> list[DeviceEndpoint]:
    """Return the endpoints of a service that a device offers."""
    return [
        topic(EndpointKind.SERVICE_SERVER_PUBLISHER, response_id, name, type_name),
        topic(EndpointKind.SERVICE_SERVER_SUBSCRIBER, request_id, name, type_name),
    ]


def service_client(name: str, type_name: str, request_id: int = 125, response_id: int = 100) -> list[DeviceEndpoint]:
    """Return the endpoints of a service that a device calls."""
    return [
        topic(EndpointKind.SERVICE_CLIENT_PUBLISHER, request_id, name, type_name),
        topic(EndpointKind.SERVICE_CLIENT_SUBSCRIBER, response_id, name, type_name),
    ]


def announcement(infos: Iterable[DeviceEndpoint]) -> bytes:
    """Return what a device answers to a request for topics: the time, each topic, a request for the time."""
    wire = b"".join(encode(info.kind, encode_topic_info(info)) for info in infos)
    return encode(Id.TIME, bytes(8)) + wire + encode(Id.TIME, bytes(8))


def robot_topics(name: str = "robot_0") -> list[DeviceEndpoint]:
    """The topics of the paper's robot that hostlink needs."""
    return [
        topic(EndpointKind.PUBLISHER, 125, f"/{name}/odometry", "geometry_msgs/Pose2D"),
        topic(EndpointKind.SUBSCRIBER, 100, f"/{name}/velocity_commands", "geometry_msgs/Twist"),
        topic(EndpointKind.SUBSCRIBER, 101, f"/{name}/reset_odometry", "std_msgs/Empty"),
    ]


def pose(x: float, y: float = 0.0, theta: float = 0.0) -> bytes:
    """A Pose2D on the odometry topic."""
    return encode(125, struct.pack("<3d", x, y, theta))


class FakeDevice:
    """One connection of a device."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer
        self._stream = FrameStream()
        self._frames: list[Frame] = []

    async def send(self, data: bytes) -> None:
        """Send any bytes."""
        self._writer.write(data)
        await self._writer.drain()

    async def announce(self, topics: list[DeviceEndpoint]) -> None:
        """Wait for the request for topics, and answer as a device does: the time first, then each topic."""
        await self.frame(Id.PUBLISHER)
        await self.send(announcement(topics))
        await self.frame(Id.TIME)

    async def next(self) -> Frame:
        """The next frame of any kind; the connection's end is an EOFError."""
        async with asyncio.timeout(TIMEOUT_S):
            while not self._frames:
                data = await self._reader.read(65536)
                if not data:
                    raise EOFError("the host closed the connection")
                self._frames += [item for item in self._stream.feed(data) if isinstance(item, Frame)]
        return self._frames.pop(0)

    async def frame(self, topic_id: int) -> bytes:
        """The payload of the next frame with this id; others are passed over."""
        while True:
            frame = await self.next()
            if frame.topic_id == topic_id:
                return frame.payload

    async def velocity(self) -> tuple[float, float]:
        """The next velocity command: m/s, rad/s."""
        twist = struct.unpack("<6d", await self.frame(100))
        return twist[0], twist[5]

    async def velocity_other_than(self, unwanted: tuple[float, float]) -> tuple[float, float]:
        """The next velocity that differs from this one."""
        while True:
            velocity = await self.velocity()
            if velocity != unwanted:
                return velocity

    async def velocity_of(self, wanted: tuple[float, float]) -> None:
        """Wait until this velocity is commanded; what was commanded before it is passed over."""
        async with asyncio.timeout(TIMEOUT_S):
            while await self.velocity() != wanted:
                continue

    @property
    def address(self) -> tuple[str, int]:
        """Address and port of the device's end."""
        address: tuple[str, int] = self._writer.get_extra_info("sockname")
        return address

    def end_sending(self) -> None:
        """Close this end's own direction; what the host sends is still read."""
        self._writer.write_eof()

    def hang_up(self) -> None:
        """Close this end."""
        self._writer.close()

    def limit_send_buffer(self, size_bytes: int) -> None:
        """Limit what the kernel keeps of sent bytes."""
        self._writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, size_bytes)

    def break_off(self) -> None:
        """Reset the connection: what was not read is gone."""
        linger = struct.pack("ii", 1, 0)
        self._writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        self._writer.transport.abort()

    async def closed(self) -> None:
        """Wait until the host has closed the connection."""
        with contextlib.suppress(EOFError, ConnectionError):
            while True:
                await self.next()


@contextlib.asynccontextmanager
async def repeating(device: FakeDevice, data: bytes, *, interval_s: float = 0.1) -> AsyncIterator[None]:
    """The device sends this again and again, until the block or the connection ends."""

    async def repeat() -> None:
        with contextlib.suppress(OSError):  # a test has hung up
            while True:
                await device.send(data)
                await asyncio.sleep(interval_s)

    async with meanwhile(repeat()):
        yield


@contextlib.asynccontextmanager
async def fake_device(
    address: tuple[str, int], topics: list[DeviceEndpoint] | None = None, *, local_host: str | None = None
) -> AsyncIterator[FakeDevice]:
    """A device that connects, announces its topics if it has any, and closes at the end of the block."""
    local = None if local_host is None else (local_host, 0)
    reader, writer = await asyncio.open_connection(*address, local_addr=local)
    try:
        device = FakeDevice(reader, writer)
        if topics is not None:
            await device.announce(topics)
        yield device
    finally:
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()
