"""PlayedDevice: a device that sends what was recorded of a robot, and receives velocities without obeying them."""

import asyncio
import contextlib
from dataclasses import dataclass, field, replace

from hostlink.cancellation import raise_if_cancelled
from hostlink.protocol.control import TopicInfo, decode_topic_info, encode_topic_info
from hostlink.protocol.frame import FIRST_TOPIC_ID, MAX_PAYLOAD_BYTES, Frame, Id, encode
from hostlink.protocol.stream import FrameStream
from hostlink.protocol.topic_table import MAX_TOPICS

MAX_SUBSCRIBERS = 25  # of the original library: the ids of what a device publishes begin behind theirs
READ_BYTES = 4096
TIME_INTERVAL_S = 2.5  # as every device of the original library: a host takes it for alive
RECONNECT_S = 0.5
BUFFER_BYTES = 65535
_PLAYED, _STRING = "played", "std_msgs/String"
_STRING_MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"


@dataclass(frozen=True, slots=True)
class PlayedTopic:
    """A topic as the recording has it."""

    name: str
    type_name: str
    md5: str
    is_velocity: bool  # the device subscribes to it, instead of publishing it


@dataclass(slots=True)
class PlayedDevice:
    """One robot. `run` keeps it connected; whoever plays the recording calls `publish`.

    Beside the robot's topics it has `<robot>/played` (std_msgs/String, the recording's name): it is not the robot.
    """

    robot: str
    source: str
    topics: list[PlayedTopic]
    dropped: int = 0  # messages that came while it was not connected
    left_out: int = 0  # messages that no device can send, or that are none of its topics
    is_ready: asyncio.Event = field(default_factory=asyncio.Event)  # a host has requested its topics
    _mark: str = field(init=False)
    _writer: asyncio.StreamWriter | None = None
    _ids: dict[str, int] = field(default_factory=dict)  # of what it publishes
    _infos: list[TopicInfo] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._mark = f"/{self.robot}/{_PLAYED}"
        mark = PlayedTopic(self._mark, _STRING, _STRING_MD5, is_velocity=False)
        if not _is_taken(mark):  # a file has any names; without its mark a device may drive a robot
            self._mark = f"/{_PLAYED}"
            mark = replace(mark, name=self._mark)
        taken = [topic for topic in self.topics if _is_taken(topic)][:MAX_TOPICS]
        subscribed = [topic for topic in taken if topic.is_velocity]
        published = [mark, *(topic for topic in taken if not topic.is_velocity)]
        self._add(Id.PUBLISHER, FIRST_TOPIC_ID + max(MAX_SUBSCRIBERS, len(subscribed)), published)
        self._add(Id.SUBSCRIBER, FIRST_TOPIC_ID, subscribed)

    def _add(self, kind: Id, first_id: int, topics: list[PlayedTopic]) -> None:
        for topic_id, topic in enumerate(topics, first_id):
            if kind is Id.PUBLISHER:
                self._ids[topic.name] = topic_id
            self._infos.append(TopicInfo(kind, topic_id, topic.name, topic.type_name, topic.md5, BUFFER_BYTES))

    def publish(self, topic: str, payload: bytes) -> None:
        """Send a message of one of its topics now."""
        topic_id = self._ids.get(topic)
        if topic_id is None or len(payload) > MAX_PAYLOAD_BYTES:
            self.left_out += 1
        elif self._writer is None or not self.is_ready.is_set():
            self.dropped += 1
        else:
            self._writer.write(encode(topic_id, payload))

    async def drained(self) -> None:
        """Wait while the host reads more slowly than messages come."""
        if self._writer is not None:
            with contextlib.suppress(OSError):  # the host is gone: what comes is counted as dropped
                await self._writer.drain()

    async def run(self, host: str, port: int) -> None:
        """Connect, talk, connect again, until cancelled.

        Raises:
            OSError: there is nobody at the first try.
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
            async with asyncio.TaskGroup() as tasks:
                beat = tasks.create_task(self._beat(writer), name=f"{self.robot} beat")
                stream = FrameStream(limit_bytes=BUFFER_BYTES)
                try:
                    while data := await reader.read(READ_BYTES):
                        self._receive(stream, data, writer)
                finally:
                    beat.cancel()
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
        """Request the time, and say what this is, for whoever has come since."""
        text = self.source.encode(errors="replace")  # a file's name may be anything
        while True:
            writer.write(encode(Id.TIME, bytes(8)))
            if self.is_ready.is_set():
                self.publish(self._mark, len(text).to_bytes(4, "little") + text)
            await writer.drain()
            await asyncio.sleep(TIME_INTERVAL_S)


def _is_taken(topic: PlayedTopic) -> bool:
    """Whether a host takes its announcement: a recording may have names that no device has."""
    info = TopicInfo(Id.PUBLISHER, FIRST_TOPIC_ID, topic.name, topic.type_name, topic.md5, BUFFER_BYTES)
    return decode_topic_info(info.kind, encode_topic_info(info)) is not None
