"""MessagesToDevice: what the host sends to one device, refused before it is queued if the device cannot take it."""

from struct import error as StructError  # noqa: N812 - a class, named like one

from hostlink.errors import FrameTooLarge, HostlinkError, UnknownTopic, WrongType
from hostlink.protocol.control import Parameter, TopicInfo, encode_parameter
from hostlink.protocol.frame import HEADER, MAX_PAYLOAD_BYTES, OVERHEAD_BYTES, Id, encode
from hostlink.protocol.outbox import Outbox
from hostlink.protocol.topic_table import TopicTable

DEFAULT_BUFFER_BYTES = 512  # rosserial's


class MessagesToDevice:
    """The half of a Session that sends. The other half negotiates what the device takes."""

    def __init__(self, topics: TopicTable, outbox: Outbox) -> None:
        self.too_large = ""  # the last frame that was refused for its size
        self._topics = topics
        self._outbox = outbox
        self._refused: dict[int, HostlinkError] = {}
        self._known: tuple[TopicInfo, ...] = ()

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """The usable endpoints of the last negotiation."""
        return self._known

    @property
    def longest_to_device_bytes(self) -> int:
        """The longest frame that may have been sent to the device."""
        return max((_buffer_bytes(info) for info in self._known if info.is_to_device), default=DEFAULT_BUFFER_BYTES)

    @property
    def replaced(self) -> int:
        """Commands that never left, because a newer one took their place."""
        return self._outbox.replaced

    @property
    def slowest_wait_s(self) -> float:
        """The longest that a frame waited before it left."""
        return self._outbox.slowest_wait_s

    @property
    def is_stopped(self) -> bool:
        """Whether `stop` was called."""
        return self._outbox.is_stopped

    def oldest_waiting_s(self, now_s: float) -> float:
        """How long the frame has waited that waits longest; 0 when none does."""
        return self._outbox.oldest_s(now_s)

    def keep_clear(self, *, robot_moves: bool) -> None:
        """While the robot moves, no frame may take a slow line for longer than a stop may wait."""
        self._outbox.robot_moves = robot_moves

    def publish(
        self, topic: str, payload: bytes, *, depth: int = 1, is_urgent: bool = False, is_kept: bool = False
    ) -> None:
        """Queue a message to the device.

        Raises:
            UnknownTopic: the device does not subscribe to it.
            WrongType: the payload has not the size of the topic's type, or the topic was refused.
            FrameTooLarge: the device's buffer is smaller, or a stop would wait behind the frame.
        """
        info = self._endpoint("topic", topic, Id.SUBSCRIBER)
        frame = self._encode(info, payload)
        if is_urgent:
            self._outbox.put_urgent(info.topic_id, frame, is_kept=is_kept)
        else:
            self._outbox.put_command(info.topic_id, self._prompt(info, frame), depth=depth)

    def send_last(self, frame: bytes) -> None:
        """Queue a frame for an endpoint that the device may still have, unless its id is another's by now."""
        topic_id: int = HEADER.unpack_from(frame)[3]
        if self._topics.get(topic_id) is None:
            self._outbox.put_urgent(topic_id, frame)

    def frame_to(self, topic: str, payload: bytes) -> bytes:
        """The frame of a message to the device, as `publish` would queue it.

        Raises:
            HostlinkError: as from `publish`.
        """
        return self._encode(self._endpoint("topic", topic, Id.SUBSCRIBER), payload)

    def topic_id(self, topic: str) -> int:
        """The id of a topic to which the device subscribes.

        Raises:
            UnknownTopic: it does not.
            WrongType: the topic was refused.
        """
        return self._endpoint("topic", topic, Id.SUBSCRIBER).topic_id

    def call(self, service: str, payload: bytes) -> None:
        """Queue a request to a service of the device.

        Raises:
            UnknownTopic: the device has no such service.
            WrongType: the payload has not the size of the request's type, or the service was refused.
            FrameTooLarge: the device's buffer is smaller, or a stop would wait behind the frame.
            DeviceBusy: too many requests and responses wait.
        """
        info = self._endpoint("service", service, Id.SERVICE_SERVER_SUBSCRIBER)
        self._outbox.put_call(service, self._prompt(info, self._encode(info, payload)))

    def response_endpoint(self, request: TopicInfo) -> TopicInfo:
        """Where the device receives the response to a request of this endpoint.

        Raises:
            UnknownTopic: it announced no such endpoint.
        """
        found = self._topics.response_to(request)
        if found is None:
            raise UnknownTopic("endpoint for responses", request.name)
        return found

    def has(self, info: TopicInfo) -> bool:
        """Whether the device still has this endpoint."""
        return self._topics.get(info.topic_id) == info

    def is_refused(self, info: TopicInfo) -> bool:
        """Whether the type of this endpoint is not what it is known as here."""
        return info.topic_id in self._refused

    def respond(self, response: TopicInfo, payload: bytes | None) -> None:
        """Queue a response to a request of the device.

        None: nobody here knows the layout. Zeros are empty texts and lists, and numbers of zero, in any; with fewer
        bytes than its layout takes a device would read on in what its buffer contained before.

        Raises:
            FrameTooLarge: the device's buffer is smaller.
            DeviceBusy: too many requests and responses wait.
        """
        if payload is None:
            room_bytes = min(_buffer_bytes(response), DEFAULT_BUFFER_BYTES) - OVERHEAD_BYTES
            payload = bytes(self._topics.fixed_bytes.get(response.topic_id, max(room_bytes, 0)))
        frame = self._fitting(response.name, response.topic_id, payload, _buffer_bytes(response))
        self._outbox.put_reply(response.name, frame)

    def answer_parameter(self, name: str, parameter: Parameter) -> None:
        """Queue the answer to a parameter request; an empty one means that there is none.

        Raises:
            WrongType: a number is outside of what the protocol can carry.
            FrameTooLarge: the smallest buffer of the device is smaller.
            DeviceBusy: too many requests and responses wait.
        """
        what = f"parameter {name}"
        try:
            payload = encode_parameter(parameter)
        except (StructError, OverflowError) as error:
            raise WrongType(what, "int32 or float32", str(error)) from error
        buffers_bytes = (_buffer_bytes(info) for info in self._known if info.is_to_device)
        limit_bytes = min(buffers_bytes, default=DEFAULT_BUFFER_BYTES)
        self._outbox.put_reply(name, self._fitting(what, Id.PARAMETER, payload, limit_bytes))

    def stop(self) -> None:
        """Queue the request to fall silent, after the urgent commands; the last frame of the session."""
        self._outbox.put_stop()

    def _endpoint(self, what: str, name: str, kind: Id) -> TopicInfo:
        info = self._topics.find(name, kind)
        if info is None:
            raise UnknownTopic(what, name, tuple(known.name for known in self._known if known.kind is kind))
        if info.topic_id in self._refused:
            raise self._refused[info.topic_id].with_traceback(None)  # else it grows by each raise
        return info

    def _encode(self, info: TopicInfo, payload: bytes) -> bytes:
        fixed_bytes = self._topics.fixed_bytes.get(info.topic_id)
        if fixed_bytes is not None and len(payload) != fixed_bytes:
            raise WrongType(info.name, f"{info.type} of {fixed_bytes} bytes", f"{len(payload)} bytes")
        return self._fitting(info.name, info.topic_id, payload, _buffer_bytes(info))

    def _fitting(self, what: str, topic_id: int, payload: bytes, limit_bytes: int) -> bytes:
        """The frame, if the device's buffer has room for it."""
        if len(payload) + OVERHEAD_BYTES > limit_bytes:
            error = FrameTooLarge(what, len(payload) + OVERHEAD_BYTES, limit_bytes)
            self.too_large = str(error)
            raise error
        return encode(topic_id, payload)

    def _prompt(self, info: TopicInfo, frame: bytes) -> bytes:
        """The frame, unless a stop would wait behind it."""
        if self._outbox.robot_moves and len(frame) > self._outbox.prompt_bytes:
            raise FrameTooLarge(info.name, len(frame), int(self._outbox.prompt_bytes), when="while the robot moves")
        return frame


def response_bytes(response: TopicInfo) -> int:
    """How long the payload of a response to the device may be."""
    return _buffer_bytes(response) - OVERHEAD_BYTES


def _buffer_bytes(info: TopicInfo) -> int:
    """The device's buffer, no longer than the longest frame; old clients announce none."""
    return min(info.buffer_bytes, MAX_PAYLOAD_BYTES + OVERHEAD_BYTES) if info.buffer_bytes > 0 else DEFAULT_BUFFER_BYTES
