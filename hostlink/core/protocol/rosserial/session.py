"""Session: the host's side of rosserial with one device. Decides what bytes and times mean.

The Session owns the stream, the topics and the outbox. The Link moves the bytes and reads the clock.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from struct import error as StructError  # noqa: N812 - a class, named like one
from typing import NamedTuple

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind, to_device_key
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.link_evidence import Explain
from hostlink.core.protocol.outbox import ControlFrames, Outbox, OutgoingFrame
from hostlink.core.protocol.rosserial.control import (
    decode_log,
    decode_parameter_request,
    decode_topic_info,
    encode_parameter,
    encode_time,
    encode_topic_info,
)
from hostlink.core.protocol.rosserial.findings import explain
from hostlink.core.protocol.rosserial.frame import (
    FIRST_TOPIC_ID,
    HEADER,
    LEAD,
    MAX_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    PROTOCOL_1_MAX_BYTES,
    SEPARATOR,
    STOP_REQUEST,
    SYNC,
    TOPICS_REQUEST,
    Frame,
    Id,
    contains_protocol_1,
    encode,
)
from hostlink.core.protocol.rosserial.negotiation import NegotiationScheduler, SessionState
from hostlink.core.protocol.rosserial.stream import DEFAULT_LIMIT_BYTES, FrameStream, Rejection, Skipped
from hostlink.core.protocol.rosserial.topic_table import MAX_TOPICS, TopicTable
from hostlink.core.protocol.session import DeviceSession
from hostlink.core.runtime.stop_frames import StopFrames
from hostlink.errors import BadRequest, FrameTooLarge, HostlinkError, UnknownTopic, WrongType

STALLED_FRAME_S = 2.0  # longer than TCP takes to send a lost segment again
SLOW_FRAME_S = 11.0  # a device whose loop takes seconds sends a frame in two pieces; longer than that ends the link
_IDS_FROM_DEVICE = frozenset(
    {Id.PUBLISHER, Id.SUBSCRIBER, Id.SERVICE_SERVER_PUBLISHER, Id.SERVICE_SERVER_SUBSCRIBER, Id.PARAMETER, Id.LOG}
    | {Id.SERVICE_CLIENT_PUBLISHER, Id.SERVICE_CLIENT_SUBSCRIBER, Id.TIME}
)
DEFAULT_BUFFER_BYTES = 512  # rosserial's default
MOST_FRAMES = 64  # in what is read at once: as many as 512 bytes hold, which bounds its cost
KEPT_BYTES = 1024  # a few boot messages, or a hundred lines of plain text

VERSION_1 = events.VersionRefused(
    "version_1", "the device speaks rosserial of before 2013: rebuild it with a newer library"
)
NAME = "rosserial"
CONTROL_FRAMES = ControlFrames(lambda wall_ns: encode(Id.TIME, encode_time(wall_ns)), TOPICS_REQUEST, STOP_REQUEST)


class NonRosserialBytes:
    """The last skipped bytes, and whether they contained a frame of protocol version 1."""

    __slots__ = ("is_protocol_1", "tail")

    def __init__(self) -> None:
        self.is_protocol_1 = False
        self.tail = b""

    def add(self, data: bytes) -> bool:
        """Keep skipped bytes. Return True when they contain a frame of protocol version 1 for the first time."""
        watched = self.tail[1 - PROTOCOL_1_MAX_BYTES :] + data
        self.tail = (self.tail + data)[-KEPT_BYTES:]
        if self.is_protocol_1 or not contains_protocol_1(watched):
            return False
        self.is_protocol_1 = True
        return True


class _Taker(NamedTuple):
    """The endpoint of a topic to which the device subscribes, and the size of a payload that it takes."""

    info: DeviceEndpoint
    payload_bytes: int


class Session(DeviceSession):
    """State machine of one rosserial device, host side. All times are of one monotonic clock, in seconds.

    States and transitions are SessionState and TRANSITIONS in `negotiation.py`. Messages of known topics are delivered
    in every state.
    """

    def __init__(
        self,
        *,
        check: Callable[[DeviceEndpoint], int | None],
        uart_bytes_s: int | None = None,
        max_topics: int = MAX_TOPICS,
        is_lossy: bool = False,
    ) -> None:
        """Create the session of a new link.

        `check` returns the fixed payload size of a topic's type, or None if it varies; it raises to refuse the topic.
        `is_lossy`: the transport may lose whole frames without a trace, as UDP does.
        """
        super().__init__(NAME, Outbox(CONTROL_FRAMES, uart_bytes_s=uart_bytes_s))
        self.non_rosserial = NonRosserialBytes()
        self._check = check
        self._topics = TopicTable(max_topics)
        self._refused: dict[int, HostlinkError] = {}  # by `TopicInfo.key`
        self._known: tuple[DeviceEndpoint, ...] = ()
        self._stream = FrameStream(fixed_bytes=self._topics.fixed_bytes)
        self.negotiation = NegotiationScheduler()
        self._takers: dict[str, _Taker] = {}  # by topic; none of them since an endpoint was announced
        self._is_lossy = is_lossy
        self._has_dropped = False  # queued frames were dropped during this negotiation

    # -- what the link reports ----------------------------------------------------------------------------------------

    def open(self, *, now_s: float) -> list[events.Event]:
        """Request the topics of a new connection."""
        self.negotiation.open(now_s)
        found: list[events.Event] = []
        self._request_if_due(now_s, found)
        return found

    def note_host_pause(self, paused_s: float) -> None:
        """Do not count this time as silence of the device."""
        self.negotiation.received_at_s += paused_s

    def receive(self, data: bytes, *, now_s: float) -> list[events.Event]:
        """Process bytes from the device."""
        self.counts.bytes_from_device += len(data)
        if self._stream.pending:
            self.negotiation.note_pause(now_s - self.negotiation.received_at_s)
        self.negotiation.received_at_s = now_s
        found: list[events.Event] = []
        self._read(self._stream.feed(data), now_s, found)
        if self.negotiation.pending is not None:
            self._request_if_due(now_s, found)
        return found

    def tick(self, *, now_s: float) -> list[events.Event]:
        """Do what is due by now. Call it at `deadline_s`."""
        found: list[events.Event] = []
        negotiation = self.negotiation
        if self._stream.pending and now_s >= self._stalled_at_s():
            negotiation.received_at_s = now_s
            self._read(self._stream.give_up(), now_s, found)
        if negotiation.is_quiet(now_s):
            if self._stream.pending:
                negotiation.mark_damaged()
            found.append(self._finish_negotiation())
        negotiation.tick(now_s)
        self._request_if_due(now_s, found)
        return found

    @property
    def is_steady(self) -> bool:
        """Whether no topic request is scheduled or answered, and no part of a frame waits.

        `deadline_s` moves only later while the session stays steady and no time is requested.
        """
        negotiation = self.negotiation
        return negotiation.state is SessionState.READY and negotiation.pending is None and not self._stream.pending

    def deadline_s(self) -> float:
        """Time at which `tick` must be called if no byte arrives before."""
        deadline_s = self.negotiation.deadline_s()
        if self._stream.pending:
            return min(deadline_s, self._stalled_at_s())
        return deadline_s

    def _stalled_at_s(self) -> float:
        """Time at which the frame at the head of the stream is given up.

        One with a known id or a part of a header is kept for long: a whole frame inside it is found all the same.
        """
        pending = self._stream.pending
        is_kept = len(pending) < HEADER.size
        if not is_kept:
            topic_id: int = HEADER.unpack_from(pending)[3]
            is_kept = topic_id in _IDS_FROM_DEVICE or topic_id in self._topics.by_key
        return self.negotiation.received_at_s + (SLOW_FRAME_S if is_kept else STALLED_FRAME_S)

    def pop_frame(self, *, now_s: float, wall_ns: int) -> OutgoingFrame | None:
        """Remove and return the next frame. None: the queues are empty, or the device's UART is busy."""
        outgoing = super().pop_frame(now_s=now_s, wall_ns=wall_ns)
        if outgoing is not None:
            if outgoing.frame is TOPICS_REQUEST:
                self.device_clock.topics_requested(now_s)
            elif self._is_lossy:
                self._note_response(outgoing.frame, now_s)
        return outgoing

    def _note_response(self, frame: bytes, now_s: float) -> None:
        topic_id: int = HEADER.unpack_from(frame)[3]
        info = self._topics.by_key.get(to_device_key(topic_id))
        if info is not None and info.kind is EndpointKind.SERVICE_CLIENT_SUBSCRIBER:
            self.negotiation.answered(now_s)

    # -- what the hub reads and requests ------------------------------------------------------------------------------

    @property
    def topics(self) -> tuple[DeviceEndpoint, ...]:
        """The usable endpoints of the last negotiation."""
        return self._known

    @property
    def refusals(self) -> tuple[tuple[DeviceEndpoint, HostlinkError], ...]:
        """Endpoints that cannot be used, with the reason."""
        known = ((self._topics.by_key.get(key), reason) for key, reason in self._refused.items())
        return tuple((info, reason) for info, reason in known if info is not None)

    @property
    def fixed_bytes(self) -> Mapping[int, int]:
        """`TopicInfo.key` -> the only payload size that its type can have."""
        return self._topics.fixed_bytes

    @property
    def is_regular(self) -> bool:
        """Whether the device requests the time at the usual period."""
        return self.negotiation.is_regular

    def is_crowded(self, data: bytes) -> bool:
        """Whether the bytes have many short frames, after cheap long ones."""
        # The first count costs a third of the exact one.
        return data.count(SYNC[:1]) > MOST_FRAMES and data.count(SYNC) > MOST_FRAMES

    @property
    def bad_checksums(self) -> int:
        """Number of rejected frame starts with a wrong checksum."""
        return self._stream.rejected[Rejection.CHECKSUM] + self._stream.rejected[Rejection.LENGTH_CHECKSUM]

    @property
    def wrong_sizes(self) -> int:
        """Number of frames whose size is not that of their type."""
        return self._stream.rejected[Rejection.WRONG_SIZE]

    @property
    def is_outdated(self) -> bool:
        """Whether the device speaks protocol version 1."""
        return self.non_rosserial.is_protocol_1

    def too_small(self, least_bytes: Callable[[str], int]) -> list[str]:
        """Say which topics exceed a buffer of the device, as far as sizes are announced."""
        fixed_bytes = self._topics.fixed_bytes
        announced = [
            f"{info.name}: a frame of {fixed_bytes[info.key] + OVERHEAD_BYTES} bytes, the device takes "
            f"{info.buffer_bytes}"
            for info in self._known
            if info.key in fixed_bytes and 0 < info.buffer_bytes < fixed_bytes[info.key] + OVERHEAD_BYTES
        ]
        unsent = [
            f"{info.name}: a message of at least {size_bytes} bytes, the device sends at most {info.buffer_bytes}"
            for info in self._known
            if info.kind is EndpointKind.PUBLISHER and info.id not in fixed_bytes
            if (size_bytes := least_bytes(info.type)) > info.buffer_bytes > 0
        ]
        return announced + unsent

    @property
    def explain(self) -> Explain:
        """Rules of rosserial."""
        return explain

    def rest_of_frame_bytes(self, pieces: Iterable[bytes]) -> int:
        """Number of bytes before the first frame; 0 when it is more than a frame can have."""
        stream, before = FrameStream(), 0
        for piece in pieces:
            for item in stream.feed(piece):
                if isinstance(item, Frame):
                    return before
                before += len(item.data)
            if before > DEFAULT_LIMIT_BYTES:
                break
        return 0

    def announcement(self, endpoints: Iterable[DeviceEndpoint]) -> bytes:
        """Return the TopicInfo frames of these endpoints."""
        return b"".join(encode(info.kind, encode_topic_info(info)) for info in endpoints)

    @property
    def rejected(self) -> dict[str, int]:
        """Number of rejected frame starts, by cause."""
        return {cause.value: count for cause, count in self._stream.rejected.items()}

    def probe(self) -> None:
        """Ask something that a working device answers (TopicsAnswered), once in REQUEST_INTERVAL_S."""
        self.negotiation.probe()

    # -- what the hub sends -------------------------------------------------------------------------------------------

    def publish(
        self, topic: str, payload: bytes, *, depth: int = 1, is_urgent: bool = False, is_kept: bool = False
    ) -> None:
        """Queue a message to the device.

        Raises:
            UnknownTopic: the device does not subscribe to it.
            WrongType: the payload has not the size of the topic's type, or the topic was refused.
            FrameTooLarge: the device's buffer is smaller, or a stop would wait behind the frame.
        """
        found = self._takers.get(topic)
        if found is None or len(payload) != found.payload_bytes:
            info, frame = self._to_topic(topic, payload)
            self._takers[topic] = _Taker(info, len(payload))  # another payload of this size fits, too
        else:
            info, frame = found.info, encode(found.info.id, payload)
        if is_urgent:
            self.outbox.put_urgent(info.id, frame, is_kept=is_kept)
        else:
            self.outbox.put_command(info.id, self._prompt(info, frame), depth=depth)

    def send_zero(self, info: DeviceEndpoint, payload: bytes, *, is_kept: bool = False) -> bool:
        """Queue a zero velocity for an endpoint that has taken one before, unless its id has a new meaning since.

        A damaged announcement may have changed or removed the endpoint, which the device has all the same: a zero is
        not refused for that. Return whether it was queued.
        """
        may_have = self.may_have(info)
        if may_have:
            self.outbox.put_urgent(info.id, encode(info.id, payload), is_kept=is_kept)
        return may_have

    def may_have(self, info: DeviceEndpoint) -> bool:
        """Whether the device may still have this endpoint: its id has no other name, type and md5 sum now."""
        now = self._topics.by_key.get(info.key)
        return now is None or now.name == info.name or now.type == info.type or now.md5 == info.md5

    def endpoint_of(self, topic: str, payload: bytes) -> DeviceEndpoint:
        """Return the endpoint of a topic to which the device subscribes. It takes messages as long as this one.

        Raises:
            HostlinkError: as from `publish`.
        """
        return self._to_topic(topic, payload)[0]

    def service_endpoint(self, service: str, payload: bytes) -> DeviceEndpoint:
        """Return the endpoint that takes the requests to a service of the device. It takes one as long as this one.

        Raises:
            HostlinkError: as from `call`.
        """
        return self._to_service(service, payload)[0]

    def call(self, service: str, payload: bytes) -> None:
        """Queue a request to a service of the device. It has no identity.

        Raises:
            UnknownTopic: the device has no such service.
            WrongType: the payload has not the size of the request's type, or the service was refused.
            FrameTooLarge: the device's buffer is smaller, or a stop would wait behind the frame.
            DeviceBusy: too many requests and responses wait.
        """
        info, frame = self._to_service(service, payload)
        self.outbox.put_call(service, self._prompt(info, frame))

    def response_endpoint(self, request: DeviceEndpoint) -> DeviceEndpoint:
        """Return the endpoint at which the device receives the response to a request of this endpoint.

        Raises:
            UnknownTopic: the device announced no such endpoint.
        """
        found = self._topics.response_to(request)
        if found is None:
            raise UnknownTopic("endpoint for responses", request.name)
        return found

    def has(self, info: DeviceEndpoint) -> bool:
        """Whether the device still has this endpoint."""
        return self._topics.by_key.get(info.key) == info

    def is_refused(self, info: DeviceEndpoint) -> bool:
        """Whether this endpoint was refused because of its type."""
        return info.key in self._refused

    def respond(
        self,
        response: DeviceEndpoint,
        payload: bytes | None,
        *,
        request: bytes | None = None,  # noqa: ARG002 - a request has no identity
    ) -> None:
        """Queue a response to a request of the device.

        `payload` is None when the layout is unknown. Then zeros are sent: they decode as empty strings, empty lists and
        zero in any layout. With fewer bytes than its layout needs, a device would read old data in its buffer.

        Raises:
            FrameTooLarge: the device's buffer is smaller.
            DeviceBusy: too many requests and responses wait.
        """
        if payload is None:
            room_bytes = min(_buffer_bytes(response), DEFAULT_BUFFER_BYTES) - OVERHEAD_BYTES
            payload = bytes(self._topics.fixed_bytes.get(response.key, max(room_bytes, 0)))
        frame = self._fitting(response.name, response.id, payload, _buffer_bytes(response))
        self.outbox.put_reply(response.name, frame)

    def answer_parameter(self, name: str, parameter: Parameter) -> None:
        """Queue the answer to a parameter request. An empty Parameter means that the parameter does not exist.

        Raises:
            WrongType: a number is outside the range that the protocol can carry.
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
        self.outbox.put_reply(name, self._fitting(what, Id.PARAMETER, payload, limit_bytes), is_lasting=True)

    def room_bytes(self, endpoint: DeviceEndpoint) -> int:
        """Longest payload that fits the device's buffer."""
        return _buffer_bytes(endpoint) - OVERHEAD_BYTES

    def too_long(self, endpoint: DeviceEndpoint, payload_bytes: int) -> FrameTooLarge:
        """Return the error about a payload that exceeds the device's buffer, with the sizes of whole frames."""
        return FrameTooLarge(endpoint.name, payload_bytes + OVERHEAD_BYTES, _buffer_bytes(endpoint))

    def zero_frames(self, endpoint: DeviceEndpoint, payload: bytes) -> tuple[bytes, ...]:
        """Return the frame of a zero."""
        return (encode(endpoint.id, payload),)

    def stop_frames(self, zeros: tuple[bytes, ...]) -> StopFrames:
        """Return these frames. One that was sent in part takes the next bytes for its rest."""
        buffers_bytes = (_buffer_bytes(info) for info in self._known if info.is_to_device)
        return StopFrames(
            zeros,
            self.outbox.control.end,
            claim_bytes=max(buffers_bytes, default=DEFAULT_BUFFER_BYTES),
            lead=LEAD,
            separator=SEPARATOR,
        )

    def _endpoint(self, what: str, name: str, kind: EndpointKind) -> DeviceEndpoint:
        info = self._topics.by_name.get((name, kind))
        if info is None:
            raise UnknownTopic(what, name, tuple(known.name for known in self._known if known.kind is kind))
        if info.key in self._refused:
            raise self._refused[info.key].with_traceback(None)  # otherwise the traceback grows with each raise
        return info

    def _to_topic(self, topic: str, payload: bytes) -> tuple[DeviceEndpoint, bytes]:
        """Return the endpoint of a topic to which the device subscribes, and the frame of a message to it."""
        info = self._endpoint("topic", topic, EndpointKind.SUBSCRIBER)
        return info, self._encode(info, payload)

    def _to_service(self, service: str, payload: bytes) -> tuple[DeviceEndpoint, bytes]:
        """Return the endpoint of a service of the device, and the frame of a request to it."""
        info = self._endpoint("service", service, EndpointKind.SERVICE_SERVER_SUBSCRIBER)
        return info, self._encode(info, payload)

    def _encode(self, info: DeviceEndpoint, payload: bytes) -> bytes:
        fixed_bytes = self._topics.fixed_bytes.get(info.key)
        if fixed_bytes is not None and len(payload) != fixed_bytes:
            raise WrongType(info.name, f"{info.type} of {fixed_bytes} bytes", f"{len(payload)} bytes")
        return self._fitting(info.name, info.id, payload, _buffer_bytes(info))

    def _fitting(self, what: str, topic_id: int, payload: bytes, limit_bytes: int) -> bytes:
        """Encode the frame. Raise FrameTooLarge if it exceeds the device's buffer."""
        if len(payload) + OVERHEAD_BYTES > limit_bytes:
            error = FrameTooLarge(what, len(payload) + OVERHEAD_BYTES, limit_bytes)
            self.too_large = str(error)
            raise error
        return encode(topic_id, payload)

    def _prompt(self, info: DeviceEndpoint, frame: bytes) -> bytes:
        """Return the frame. Raise FrameTooLarge if it would delay a stop."""
        if self.outbox.robot_moves and len(frame) > self.outbox.prompt_bytes:
            raise FrameTooLarge(info.name, len(frame), int(self.outbox.prompt_bytes), when="while the robot moves")
        return frame

    # -- frames -------------------------------------------------------------------------------------------------------

    def _read(self, items: Iterator[Frame | Skipped], now_s: float, found: list[events.Event]) -> None:
        """Derive the events of frames and skipped bytes."""
        negotiation = self.negotiation
        for item in items:
            if isinstance(item, Skipped):
                self._skip(item.data, found)
                continue
            self.counts.frames_from_device += 1
            topic_id, payload = item
            if topic_id <= Id.SERVICE_CLIENT_SUBSCRIBER:
                self._add_topic_info(EndpointKind(topic_id), payload, now_s, found)
                continue
            if negotiation.state is SessionState.NEGOTIATING and self._is_behind_topics(topic_id):
                found.append(self._finish_negotiation())
            if topic_id < FIRST_TOPIC_ID:
                self._answer(item, now_s, found)
                continue
            info = self._topics.by_key.get(topic_id)
            if info is None and to_device_key(topic_id) in self._topics.by_key:
                self.counts.refused_frames += 1
            elif info is None:
                self.counts.unknown_ids += 1
                negotiation.request_about(topic_id, "unknown_id")
                found.append(events.UnknownTopicUsed(topic_id))
            elif (
                info.kind is EndpointKind.SERVICE_CLIENT_PUBLISHER
            ):  # also of a refused type: the device waits for a response
                negotiation.called(negotiation.received_at_s)
                found.append(events.ServiceRequested(info, payload))
            elif topic_id in self._refused:
                self.counts.refused_frames += 1
            elif info.kind is EndpointKind.PUBLISHER:
                found.append(events.MessageReceived(info, payload))
            else:
                found.append(events.ServiceResponded(info, payload))

    def _answer(self, frame: Frame, now_s: float, found: list[events.Event]) -> None:
        """Handle a control frame. Answer time requests here; report the others to the hub."""
        if frame.topic_id == Id.TIME:
            self.negotiation.time_requested(now_s)
            self.outbox.put_time()
            found.append(events.TimeRequested())
        elif frame.topic_id == Id.LOG and (log := decode_log(frame.payload)) is not None:
            found.append(events.DeviceLogged(log.level, log.text))
        elif frame.topic_id == Id.PARAMETER and (name := decode_parameter_request(frame.payload)) is not None:
            found.append(events.ParameterRequested(name))
        else:
            self.counts.malformed += 1

    def _skip(self, data: bytes, found: list[events.Event]) -> None:
        self.counts.skipped_bytes += len(data)
        self.negotiation.mark_damaged()
        is_protocol_1 = self.non_rosserial.add(data)
        self.foreign = self.non_rosserial.tail
        if is_protocol_1:
            found.append(VERSION_1)

    # -- negotiation --------------------------------------------------------------------------------------------------

    def _add_topic_info(self, kind: EndpointKind, payload: bytes, now_s: float, found: list[events.Event]) -> None:
        info = decode_topic_info(kind, payload)
        if info is None or info.id < FIRST_TOPIC_ID:
            self.counts.malformed += 1
            return
        may_go_on = not self._topics.has_announced(info.key)
        if self.negotiation.topic_info_received(now_s, may_go_on=may_go_on):
            self._topics.begin()
        if not self._topics.is_room(info.key):
            self._refuse_excess(info, found)
            return
        self._takers.clear()
        if self._topics.by_key.get(info.key) not in (None, info):  # frames wait for the old meaning
            self.outbox.drop_messages()
            self._has_dropped = True
        self._refused.pop(info.key, None)
        asked_at_s = self.device_clock.topics_answered(now_s)
        if asked_at_s is not None:
            found.append(events.TopicsAnswered(asked_at_s))
        fixed_bytes = None
        try:
            fixed_bytes = self._check(info)
        except HostlinkError as error:
            reason = error.with_traceback(None)  # a traceback would keep `found` and the error alive in a cycle
            self._refused[info.key] = reason
            found.append(events.TopicRefused(info, reason))
        if info.kind is EndpointKind.SERVICE_CLIENT_PUBLISHER:
            fixed_bytes = None  # every request is answered, even of a wrong size
        self._topics.add(info, fixed_bytes)
        if not info.is_to_device:
            self._stream.limit_bytes = max(self._stream.limit_bytes, info.buffer_bytes)

    def _refuse_excess(self, info: DeviceEndpoint, found: list[events.Event]) -> None:
        """Count a topic above max_topics. Report the first one of a negotiation."""
        self.counts.excess_topics += 1
        self._topics.excess += 1
        if self._topics.excess == 1:
            reason = f"{info.name}: the device has more than {self._topics.max_topics} topics ([link] max_topics)"
            found.append(events.TopicRefused(info, BadRequest(reason)))

    def _is_behind_topics(self, topic_id: int) -> bool:
        """Whether a frame shows that the device has announced all of its topics.

        A log line does not: a passthrough may insert its own log line anywhere. A configured device continues to
        publish while it announces its topics again. Until it has announced as many as before, only a pause ends the
        negotiation.
        """
        is_behind = topic_id == Id.TIME or (topic_id != Id.LOG and not self._topics.is_partial)
        return is_behind and self.negotiation.may_finish

    def _finish_negotiation(self) -> events.TopicsNegotiated:
        self._takers.clear()
        self._topics.finish(refused=self._refused)
        self._stream.limit_bytes = max(DEFAULT_LIMIT_BYTES, self._topics.largest_from_device_bytes())
        self._refused = {key: why for key, why in self._refused.items() if key in self._topics.by_key}
        self.counts.negotiations += 1
        known = tuple(info for info in self._topics.all() if info.key not in self._refused)
        is_changed = known != self._known
        if is_changed:
            self.outbox.drop_messages()
            self.negotiation.forget_causes()
        self._known = known
        has_dropped, self._has_dropped = self._has_dropped, False
        gap_at = self._topics.gap()
        is_unconfirmed = self._is_lossy and is_changed
        self.negotiation.finish(
            gap_at,
            is_short=bool(self._topics.missing),
            is_altered=self._topics.is_altered,
            is_unconfirmed=is_unconfirmed,
        )
        return events.TopicsNegotiated(known, is_changed or has_dropped, gap_at)

    def _request_if_due(self, now_s: float, found: list[events.Event]) -> None:
        reason = self.negotiation.pop_request(now_s)
        if reason is not None:
            self.counts.topic_requests += 1
            self.outbox.put_topics_request()
            found.append(events.TopicsRequested(reason))


def _buffer_bytes(info: DeviceEndpoint) -> int:
    """The device's buffer, limited to the longest frame. Old clients announce none and get DEFAULT_BUFFER_BYTES."""
    return min(info.buffer_bytes, MAX_PAYLOAD_BYTES + OVERHEAD_BYTES) if info.buffer_bytes > 0 else DEFAULT_BUFFER_BYTES
