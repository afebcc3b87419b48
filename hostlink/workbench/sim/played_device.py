"""PlayedDevice: a device that sends what was recorded of a robot, and receives velocities without obeying them."""

import asyncio
import contextlib
from dataclasses import dataclass, field, replace

from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import decode_topic_info, encode_topic_info
from hostlink.core.protocol.rosserial.frame import FIRST_TOPIC_ID, MAX_PAYLOAD_BYTES, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.protocol.rosserial.topic_table import MAX_TOPICS
from hostlink.core.runtime.cancellation import meanwhile, raise_if_cancelled

MAX_SUBSCRIBERS = 25  # of the original library, whose published topics have the ids after those
READ_BYTES = 4096
TIME_INTERVAL_S = 2.5  # as the original library: a host expects time requests of a working device
RECONNECT_S = 0.5
BUFFER_BYTES = 65535
_PLAYED, _MARK_TYPE, _MARK_MD5 = "played", "hostlink_msgs/PlayedRecording", "992ce8a1687cec8c8bd883ec73ca41d1"


@dataclass(frozen=True, slots=True)
class PlayedTopic:
    """Topic of a recording."""

    name: str
    type_name: str
    md5: str
    is_velocity: bool  # the device subscribes to the topic instead of publishing it


@dataclass(slots=True)
class PlayedDevice:
    """Device of one recorded robot. `run` keeps it connected; the player of the recording calls `publish`.

    In addition to the robot's topics it publishes `<robot>/played` with the recording's name. The topic's type,
    hostlink_msgs/PlayedRecording, marks the device as a recording: no board has it.
    """

    robot: str
    source: str
    topics: list[PlayedTopic]
    dropped: int = 0  # messages that were published while the device was not connected
    left_out: int = 0  # messages that are too long for a frame, or of an unknown topic
    is_ready: asyncio.Event = field(default_factory=asyncio.Event)  # a host has requested its topics
    _mark: str = field(init=False)
    _writer: asyncio.StreamWriter | None = None
    _ids: dict[str, int] = field(default_factory=dict)  # of the published topics
    _infos: list[DeviceEndpoint] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._mark = f"/{self.robot}/{_PLAYED}"
        mark = PlayedTopic(self._mark, _MARK_TYPE, _MARK_MD5, is_velocity=False)
        if not _is_taken(mark):  # a file may have any names; without the mark, a host may take the device for a robot
            self._mark = f"/{_PLAYED}"
            mark = replace(mark, name=self._mark)
        taken = [topic for topic in self.topics if _is_taken(topic)][:MAX_TOPICS]
        subscribed = [topic for topic in taken if topic.is_velocity]
        published = [mark, *(topic for topic in taken if not topic.is_velocity)]
        self._add(EndpointKind.PUBLISHER, FIRST_TOPIC_ID + max(MAX_SUBSCRIBERS, len(subscribed)), published)
        self._add(EndpointKind.SUBSCRIBER, FIRST_TOPIC_ID, subscribed)

    def _add(self, kind: EndpointKind, first_id: int, topics: list[PlayedTopic]) -> None:
        for topic_id, topic in enumerate(topics, first_id):
            if kind is EndpointKind.PUBLISHER:
                self._ids[topic.name] = topic_id
            self._infos.append(DeviceEndpoint(kind, topic_id, topic.name, topic.type_name, topic.md5, BUFFER_BYTES))

    def publish(self, topic: str, payload: bytes) -> None:
        """Send a message of one of the topics."""
        topic_id = self._ids.get(topic)
        if topic_id is None or len(payload) > MAX_PAYLOAD_BYTES:
            self.left_out += 1
        elif self._writer is None or not self.is_ready.is_set():
            self.dropped += 1
        else:
            self._writer.write(encode(topic_id, payload))

    async def drained(self) -> None:
        """Wait while the host reads more slowly than messages are published."""
        if self._writer is not None:
            with contextlib.suppress(OSError):  # the host is gone: further messages are counted as dropped
                await self._writer.drain()

    async def run(self, host: str, port: int) -> None:
        """Keep the device connected until cancelled.

        Raises:
            OSError: the first connection failed.
        """
        has_connected = False
        while True:
            try:
                reader, self._writer = await asyncio.open_connection(host, port)
            except OSError:
                if not has_connected:
                    raise
            else:
                has_connected = True
                await self._talk(reader, self._writer)
            await asyncio.sleep(RECONNECT_S)

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with meanwhile((f"{self.robot} beat", self._beat(writer))):
                stream = FrameStream(limit_bytes=BUFFER_BYTES)
                while data := await reader.read(READ_BYTES):
                    self._receive(stream, data, writer)
        except* OSError:
            pass  # the host is gone; `run` tries again
        finally:
            self._writer = None
            self.is_ready.clear()
            writer.close()
            with contextlib.suppress(OSError):  # it would hide a cancellation
                await writer.wait_closed()
        raise_if_cancelled()

    def _receive(self, stream: FrameStream, data: bytes, writer: asyncio.StreamWriter) -> None:
        for found in stream.feed(data):
            if isinstance(found, Frame) and found.topic_id == Id.PUBLISHER:
                for info in self._infos:
                    writer.write(encode(info.kind, encode_topic_info(info)))
                self.is_ready.set()

    async def _beat(self, writer: asyncio.StreamWriter) -> None:
        """Request the time and publish the mark periodically, also for later subscribers."""
        text = self.source.encode(errors="replace")  # a file's name may be anything
        while True:
            writer.write(encode(Id.TIME, bytes(8)))
            if self.is_ready.is_set():
                self.publish(self._mark, len(text).to_bytes(4, "little") + text)
            await writer.drain()
            await asyncio.sleep(TIME_INTERVAL_S)


def _is_taken(topic: PlayedTopic) -> bool:
    """Whether a host accepts the announcement of the topic. A recording may have names that no device has."""
    info = DeviceEndpoint(EndpointKind.PUBLISHER, FIRST_TOPIC_ID, topic.name, topic.type_name, topic.md5, BUFFER_BYTES)
    return decode_topic_info(info.kind, encode_topic_info(info)) is not None
