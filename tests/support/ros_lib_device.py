"""RosLibDevice: a device that calls services as ros_lib's `ServiceClient::call` does: it only waits for the response.

Its buffer is memory: a response that is longer than it overwrites the memory behind it, one that is shorter than its
layout is read on into what an earlier frame left there. Both are a DeviceCrashed here.
"""

import asyncio
import contextlib
import random
import struct
from collections.abc import AsyncIterator
from typing import Any

from hostlink.core.hub.hub import Hub
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.messages.fields import FORMATS, VARIABLE, Layout
from hostlink.core.messages.message_type import MessageType
from hostlink.core.messages.parsing import parse_service
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.session import DEFAULT_BUFFER_BYTES
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.original_device import DeviceCrashed

REQUESTS, RESPONSES = 125, 100  # the ids of the first service client of a device
TIME_INTERVAL_S = 2.5
HANGS_S = 30.0  # a real one would wait without end


class Hangs(AssertionError):
    """The device waits for a response that does not come."""


class GivenUp(Exception):
    """`call` returned without a response: the host requested the topics, or sent stop, or the connection ended."""


def clients(
    name: str, type_name: str, *, md5: tuple[str, str], buffer_bytes: int = 512, count: int = 1
) -> list[DeviceEndpoint]:
    """The endpoints of service clients, of which each has two."""
    request_md5, response_md5 = md5
    return [
        info
        for number in range(count)
        for info in (
            DeviceEndpoint(EndpointKind.SERVICE_CLIENT_PUBLISHER, REQUESTS + number, name, type_name, request_md5, 512),
            DeviceEndpoint(
                EndpointKind.SERVICE_CLIENT_SUBSCRIBER, RESPONSES + number, name, type_name, response_md5, buffer_bytes
            ),
        )
    ]


def response_type(fields: str) -> MessageType:
    """Return the layout of a response of the device's program; its fields are not messages."""
    _, response = parse_service("test/Type", f"---\n{fields}", "a test")
    return MessageType(response, {})


class RosLibDevice:
    """One device on one connection."""

    def __init__(self, end: MemoryTransport, topics: list[DeviceEndpoint], response: MessageType) -> None:
        self._end, self.topics, self._layout = end, topics, response.layout
        self._stream = FrameStream()
        self._frames: list[Frame] = []
        self.buffer_bytes = next((info.buffer_bytes for info in topics if info.is_to_device), 0) or DEFAULT_BUFFER_BYTES
        self._memory = bytearray(random.Random(1).randbytes(self.buffer_bytes))  # what earlier frames left

    async def call(self, request: bytes, *, client: int = 0) -> dict[str, Any]:
        """Call a service and return the response. Raise Hangs without one."""
        await self.send(REQUESTS + client, request)
        try:
            async with asyncio.timeout(HANGS_S):
                return await self.response(client=client)
        except TimeoutError:
            raise Hangs(f"no response for {HANGS_S} s") from None

    async def send(self, topic_id: int, payload: bytes) -> None:
        """Put a frame on the wire."""
        await self._end.send(encode(topic_id, payload))

    async def response(self, *, client: int = 0) -> dict[str, Any]:
        """Spin until the response has arrived, as `call` does after its request."""
        while True:
            frame = await self.next()
            if frame.topic_id == Id.PUBLISHER:
                await self.announce()
                raise GivenUp("asked for the topics")
            if frame.topic_id == Id.STOP:
                raise GivenUp("stopped")
            if frame.topic_id == RESPONSES + client:
                return self._deserialize(frame.payload)

    async def next(self) -> Frame:
        """The next frame from the host."""
        while not self._frames:
            data = await self._end.receive()
            if not data:
                raise GivenUp("the connection ended")
            self._frames += [item for item in self._stream.feed(data) if isinstance(item, Frame)]
        return self._frames.pop(0)

    async def announce(self) -> None:
        """Announce what it has, then a frame that ends the negotiation."""
        infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in self.topics)
        await self._end.send(infos + encode(Id.TIME, bytes(8)))

    async def keep_time(self) -> None:
        """Request the time as `spinOnce` does."""
        with contextlib.suppress(OSError):
            while True:
                await asyncio.sleep(TIME_INTERVAL_S)
                await self.send(Id.TIME, bytes(8))

    async def hang_up(self) -> None:
        """Close the connection."""
        await self._end.aclose()

    def _deserialize(self, payload: bytes) -> dict[str, Any]:
        if len(payload) > self.buffer_bytes:
            raise DeviceCrashed(f"{len(payload)} bytes into a buffer of {self.buffer_bytes}")
        self._memory[: len(payload)] = payload
        values, _ = self._read(self._layout, 0)
        return values

    def _read(self, layout: Layout, at: int) -> tuple[dict[str, Any], int]:
        values: dict[str, Any] = {}
        for field in layout.fields:
            count, found = abs(field.array_length), []
            if field.array_length == VARIABLE:
                (count,), at = self._unpack("<I", at)
            for _ in range(count):
                value, at = self._value(field.type, at)
                found.append(value)
            values[field.name] = found if field.array_length >= VARIABLE else found[0]
        return values, at

    def _value(self, type_name: str, at: int) -> tuple[Any, int]:
        if type_name != "string":
            (value,), at = self._unpack(f"<{FORMATS[type_name]}", at)
            return value, at
        (length,), at = self._unpack("<I", at)
        if at + length > self.buffer_bytes:
            raise DeviceCrashed(f"a text of {length} bytes in a buffer of {self.buffer_bytes}")
        return self._memory[at : at + length].decode(), at + length

    def _unpack(self, form: str, at: int) -> tuple[tuple[Any, ...], int]:
        size = struct.calcsize(form)
        if at + size > self.buffer_bytes:
            raise DeviceCrashed(f"read at {at} in a buffer of {self.buffer_bytes}")
        return struct.unpack_from(form, self._memory, at), at + size


class Connected:
    """A device, and its link at the host."""

    def __init__(self, device: RosLibDevice, link: Link) -> None:
        self.device, self.link = device, link
        self.end: LinkEnd | None = None


@contextlib.asynccontextmanager
async def ros_lib_device(hub: Hub, topics: list[DeviceEndpoint], response: MessageType) -> AsyncIterator[Connected]:
    """A device that has announced its topics to a running hub."""
    host_end, device_end = memory_pair()
    link = hub.links.open(host_end, ROSSERIAL)
    made = Connected(RosLibDevice(device_end, topics, response), link)

    async def serve() -> None:
        made.end = await hub.links.serve(link)

    hub.spawn(serve(), name="link of a test")
    while (await made.device.next()).topic_id != Id.PUBLISHER:
        pass
    await made.device.announce()
    while (await made.device.next()).topic_id != Id.TIME:
        pass
    async with asyncio.TaskGroup() as tasks:
        clock = tasks.create_task(made.device.keep_time(), name="clock of the device")
        try:
            yield made
        finally:
            clock.cancel()
            await made.device.hang_up()


@contextlib.asynccontextmanager
async def running_hub(hub: Hub) -> AsyncIterator[Hub]:
    """For the length of the block."""
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(hub.run(), name="hub")
        await hub.is_running.wait()
        yield hub
        await asyncio.sleep(1.0)  # what ends with the block has ended; virtual
        running.cancel()
