"""Session: the host's side of one device, from the first byte on; decides what bytes and time mean.

It owns the stream, the topics and the outbox. The Link moves the bytes and tells the time.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from struct import error as StructError  # noqa: N812 - a class, named like one

from hostlink.errors import BadRequest, FrameTooLarge, HostlinkError, UnknownTopic, WrongType
from hostlink.protocol import events
from hostlink.protocol.clock import DeviceClock
from hostlink.protocol.control import (
    Parameter,
    TopicInfo,
    decode_log,
    decode_parameter_request,
    decode_topic_info,
    encode_parameter,
)
from hostlink.protocol.frame import (
    FIRST_TOPIC_ID,
    HEADER,
    MAX_PAYLOAD_BYTES,
    OVERHEAD_BYTES,
    TOPICS_REQUEST,
    Frame,
    Id,
    encode,
)
from hostlink.protocol.negotiation import NegotiationScheduler
from hostlink.protocol.non_rosserial import NonRosserialBytes
from hostlink.protocol.outbox import Outbox
from hostlink.protocol.stream import DEFAULT_LIMIT_BYTES, FrameStream, Skipped
from hostlink.protocol.topic_table import MAX_TOPICS, TopicTable

NEGOTIATION_QUIET_S = 0.5  # a device tells its topics without a pause; WiFi may put one in
STALLED_FRAME_S = 2.0  # longer than TCP takes to send a lost segment again
DEFAULT_BUFFER_BYTES = 512  # rosserial's

_KINDS_FROM_DEVICE = (Id.PUBLISHER, Id.SERVICE_SERVER_PUBLISHER)  # and those of service clients


@dataclass(slots=True)
class SessionCounts:
    """What came and what was wrong with it, since the link opened."""

    frames_from_device: int = 0
    frames_to_device: int = 0
    bytes_from_device: int = 0
    bytes_to_device: int = 0
    skipped_bytes: int = 0
    unknown_ids: int = 0
    refused_frames: int = 0  # to the host with an id that only the host may use, or of a refused topic
    malformed: int = 0  # control frames whose payload makes no sense
    excess_topics: int = 0  # TopicInfos over the bound of one device
    negotiations: int = 0
    asks: int = 0


class Session:
    """The state machine of one device, host side. All times are of one monotonic clock, in seconds.

    | state       | entered by               | asks for topics                           | left by                     |
    |-------------|--------------------------|-------------------------------------------|-----------------------------|
    | asking      | `open`, a wish to ask    | at once, then every 2 s without an answer | a TopicInfo                 |
    | negotiating | the first TopicInfo      | no                                        | 0.5 s quiet, another frame |
    | ready       | the end of a negotiation | unknown id, gap or damage (3 times each); | a TopicInfo                 |
    |             |                          | no time request for 5 s, or not a byte    |                             |
    |             |                          | for 3.5 s from one that asks for the time |                             |

    A wish waits until the last request is 1 s old. Messages of known topics are delivered in every state.
    """

    def __init__(
        self,
        *,
        check: Callable[[TopicInfo], int | None],
        uart_bytes_s: int | None = None,
        max_topics: int = MAX_TOPICS,
    ) -> None:
        """`check` gives the fixed payload size of a topic's type, None if it varies; it raises to refuse the topic."""
        self.counts = SessionCounts()
        self.device_clock = DeviceClock()
        self.non_rosserial = NonRosserialBytes()
        self.too_large = ""  # the last frame that was refused for its size
        self._check = check
        self._topics = TopicTable(max_topics)
        self._stream = FrameStream(fixed_bytes=self._topics.fixed_bytes)
        self._outbox = Outbox(uart_bytes_s=uart_bytes_s)
        self._refused: dict[int, HostlinkError] = {}
        self._clock = NegotiationScheduler()
        self._known: tuple[TopicInfo, ...] = ()

    # -- what the link tells ------------------------------------------------------------------------------------------

    def open(self, *, now_s: float) -> list[events.Event]:
        """The connection stands: ask for topics at once."""
        self._clock.open(now_s)
        return list(self._ask_if_due(now_s))

    def receive(self, data: bytes, *, now_s: float) -> list[events.Event]:
        """Take what came from the device."""
        self.counts.bytes_from_device += len(data)
        self._clock.heard_at_s = now_s
        found = list(self._read(self._stream.feed(data), now_s))
        found += self._ask_if_due(now_s)
        return found

    def tick(self, *, now_s: float) -> list[events.Event]:
        """Do what is due by now; call it when `deadline_s` has come."""
        found: list[events.Event] = []
        if self._stream.pending_bytes and now_s >= self._clock.heard_at_s + STALLED_FRAME_S:
            self._clock.heard_at_s = now_s
            found += self._read(self._stream.give_up(), now_s)
        if self._topics.is_negotiating and now_s >= self._clock.told_at_s + NEGOTIATION_QUIET_S:
            self._clock.is_negotiation_damaged |= self._stream.pending_bytes > 0
            found.append(self._finish_negotiation())
        self._clock.tick(now_s)
        found += self._ask_if_due(now_s)
        return found

    def deadline_s(self) -> float:
        """When `tick` must be called next if nothing comes before."""
        times = [self._clock.deadline_s()]
        if self._stream.pending_bytes:
            times.append(self._clock.heard_at_s + STALLED_FRAME_S)
        if self._topics.is_negotiating:
            times.append(self._clock.told_at_s + NEGOTIATION_QUIET_S)
        return min(times)

    def take(self, *, now_s: float, wall_ns: int) -> bytes | None:
        """The next frame to write; None when nothing waits or the device's UART is busy."""
        frame = self._outbox.take(now_s=now_s, wall_ns=wall_ns)
        if frame is not None:
            if frame is TOPICS_REQUEST:
                self.device_clock.asked(now_s)
            self.counts.frames_to_device += 1
            self.counts.bytes_to_device += len(frame)
        return frame

    def wait_s(self, now_s: float) -> float | None:
        """Seconds until `take` gives a frame; None when nothing waits."""
        return self._outbox.wait_s(now_s)

    # -- what the hub asks for ----------------------------------------------------------------------------------------

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """The usable endpoints of the last negotiation."""
        return self._known

    @property
    def longest_to_device_bytes(self) -> int:
        """The longest frame that may have been sent to the device."""
        return max((_buffer_bytes(info) for info in self._known if info.is_to_device), default=DEFAULT_BUFFER_BYTES)

    @property
    def is_asking_time(self) -> bool:
        """Whether the device asks for the time as often as a rosserial client does; its silence then says something."""
        return self._clock.is_asking_time

    @property
    def refusals(self) -> tuple[tuple[TopicInfo, HostlinkError], ...]:
        """The endpoints that cannot be used, and why."""
        known = ((self._topics.get(topic_id), reason) for topic_id, reason in self._refused.items())
        return tuple((info, reason) for info, reason in known if info is not None)

    @property
    def fixed_bytes(self) -> Mapping[int, int]:
        """Id -> the only payload size that its type can have."""
        return self._topics.fixed_bytes

    @property
    def replaced(self) -> int:
        """Commands that never left, because a newer one took their place."""
        return self._outbox.replaced

    @property
    def slowest_wait_s(self) -> float:
        """The longest that a frame waited before it left."""
        return self._outbox.slowest_wait_s

    @property
    def urgent_since_s(self) -> float | None:
        """When the frame that was taken last was put, if it carries a velocity."""
        return self._outbox.urgent_since_s

    def oldest_waiting_s(self, now_s: float) -> float:
        """How long the frame has waited that waits longest; 0 when none does."""
        return self._outbox.oldest_s(now_s)

    def keep_clear(self, *, robot_moves: bool) -> None:
        """Say whether a stop may be needed soon: then no frame may take a slow line for longer than a stop may wait."""
        self._outbox.robot_moves = robot_moves

    @property
    def rejected(self) -> dict[str, int]:
        """Starts of frames that were none, by cause."""
        return {cause.value: count for cause, count in self._stream.rejected.items()}

    def publish(
        self, topic: str, payload: bytes, *, depth: int = 1, is_urgent: bool = False, is_kept: bool = False
    ) -> None:
        """Queue a message to the device; raises UnknownTopic, WrongType or FrameTooLarge before anything is queued."""
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

    @property
    def is_stopped(self) -> bool:
        """Whether `stop` was called."""
        return self._outbox.is_stopped

    def frame_to(self, topic: str, payload: bytes) -> bytes:
        """The frame of a message to the device, as `publish` would queue it; the same errors."""
        return self._encode(self._endpoint("topic", topic, Id.SUBSCRIBER), payload)

    def topic_id(self, topic: str) -> int:
        """Of what `publish` sends to the device under this name; UnknownTopic."""
        return self._endpoint("topic", topic, Id.SUBSCRIBER).topic_id

    def call(self, service: str, payload: bytes) -> None:
        """Queue a request to a service of the device's."""
        info = self._endpoint("service", service, Id.SERVICE_SERVER_SUBSCRIBER)
        self._outbox.put_call(service, self._prompt(info, self._encode(info, payload)))

    def response_endpoint(self, request: TopicInfo) -> TopicInfo:
        """Where the device takes the response to a request of this endpoint; UnknownTopic."""
        found = self._topics.response_to(request)
        if found is None:
            raise UnknownTopic("endpoint for responses", request.name)
        return found

    def is_refused(self, info: TopicInfo) -> bool:
        """Whether the type of this endpoint is not what it is known as here."""
        return info.topic_id in self._refused

    def respond(self, response: TopicInfo, payload: bytes | None) -> None:
        """Queue a response to a request of the device's; FrameTooLarge, DeviceBusy.

        None: nobody here knows the layout. Zeros are empty texts and lists, and numbers of zero, in any; with fewer
        bytes than its layout takes a device would read on in what its buffer held before.
        """
        if payload is None:
            room_bytes = min(_buffer_bytes(response), DEFAULT_BUFFER_BYTES) - OVERHEAD_BYTES
            payload = bytes(self._topics.fixed_bytes.get(response.topic_id, max(room_bytes, 0)))
        frame = self._fitting(response.name, response.topic_id, payload, _buffer_bytes(response))
        self._outbox.put_reply(response.name, frame)

    def answer_parameter(self, name: str, parameter: Parameter) -> None:
        """Queue the answer to a parameter request; an empty one says that there is none."""
        what = f"parameter {name}"
        try:
            payload = encode_parameter(parameter)
        except (StructError, OverflowError) as error:
            raise WrongType(what, "int32 or float32", str(error)) from error
        buffers_bytes = (_buffer_bytes(info) for info in self._known if info.is_to_device)
        self._outbox.put_reply(
            name, self._fitting(what, Id.PARAMETER, payload, min(buffers_bytes, default=DEFAULT_BUFFER_BYTES))
        )

    def request_topics(self, reason: str) -> None:
        """Ask for the topics as soon as that may be: a device that lives answers."""
        self._clock.request(reason)

    def stop(self) -> None:
        """Queue the request to fall silent, after the urgent commands; the last frame of the session."""
        self._outbox.put_stop()

    # -- frames -------------------------------------------------------------------------------------------------------

    def _read(self, items: Iterator[Frame | Skipped], now_s: float) -> Iterator[events.Event]:
        for item in items:
            if isinstance(item, Skipped):
                yield from self._skip(item.data)
                continue
            self.counts.frames_from_device += 1
            topic_id = item.topic_id
            if topic_id <= Id.SERVICE_CLIENT_SUBSCRIBER:
                yield from self._take_topic_info(Id(topic_id), item.payload, now_s)
                continue
            if self._topics.is_negotiating:
                yield self._finish_negotiation()
            if topic_id >= FIRST_TOPIC_ID:
                yield from self._take_message(item)
            else:
                yield from self._take_control(item, now_s)

    def _take_message(self, frame: Frame) -> Iterator[events.Event]:
        info = self._topics.get(frame.topic_id)
        if info is None:
            self.counts.unknown_ids += 1
            self._clock.wish("unknown_id", about=frame.topic_id)
            yield events.UnknownTopicUsed(frame.topic_id)
        elif info.kind is Id.SERVICE_CLIENT_PUBLISHER:  # also of a type that was refused: the device waits
            yield events.ServiceRequested(info, frame.payload)
        elif info.topic_id in self._refused or info.kind not in _KINDS_FROM_DEVICE:
            self.counts.refused_frames += 1
        elif info.kind is Id.PUBLISHER:
            yield events.MessageReceived(info, frame.payload)
        else:
            yield events.ServiceResponded(info, frame.payload)

    def _take_control(self, frame: Frame, now_s: float) -> Iterator[events.Event]:
        if frame.topic_id == Id.TIME:
            self._clock.take_time_request(now_s)
            self._outbox.put_time()
            yield events.TimeRequested()
        elif frame.topic_id == Id.LOG and (log := decode_log(frame.payload)) is not None:
            yield events.DeviceLogged(log.level, log.text)
        elif frame.topic_id == Id.PARAMETER and (name := decode_parameter_request(frame.payload)) is not None:
            yield events.ParameterRequested(name)
        else:
            self.counts.malformed += 1

    def _skip(self, data: bytes) -> Iterator[events.Event]:
        self.counts.skipped_bytes += len(data)
        if self._topics.is_negotiating:
            self._clock.is_negotiation_damaged = True
        if self.non_rosserial.take(data):
            yield events.Protocol1Recognised()

    # -- negotiation --------------------------------------------------------------------------------------------------

    def _take_topic_info(self, kind: Id, payload: bytes, now_s: float) -> Iterator[events.Event]:
        info = decode_topic_info(kind, payload)
        if info is None or info.topic_id < FIRST_TOPIC_ID:
            self.counts.malformed += 1
            return
        self._clock.told_at_s = now_s
        if not self._topics.is_room(info.topic_id):
            yield from self._refuse_excess(info)
            return
        if self._topics.get(info.topic_id) not in (None, info):  # what waits must not meet the id's new meaning
            self._outbox.drop_messages()
        self._refused.pop(info.topic_id, None)
        self.device_clock.told(now_s)
        self._clock.is_answered = True
        fixed_bytes = None
        try:
            fixed_bytes = self._check(info)
        except HostlinkError as reason:
            self._refused[info.topic_id] = reason
            yield events.TopicRefused(info, reason)
        if info.kind is Id.SERVICE_CLIENT_PUBLISHER:
            fixed_bytes = None  # who asks is answered, whatever he asks
        self._topics.add(info, fixed_bytes)
        if not info.is_to_device:
            self._stream.limit_bytes = max(self._stream.limit_bytes, info.buffer_bytes)

    def _refuse_excess(self, info: TopicInfo) -> Iterator[events.Event]:
        """Count a topic over the bound; the first of a negotiation is told."""
        self.counts.excess_topics += 1
        self._topics.excess += 1
        if self._topics.excess == 1:
            reason = f"{info.name}: one topic more than the {self._topics.max_topics} that [link] max_topics allows"
            yield events.TopicRefused(info, BadRequest(reason))

    def _finish_negotiation(self) -> events.TopicsNegotiated:
        self._topics.finish(refused=self._refused)
        self._stream.limit_bytes = max(DEFAULT_LIMIT_BYTES, self._topics.largest_from_device_bytes())
        self._refused = {topic_id: why for topic_id, why in self._refused.items() if self._topics.get(topic_id)}
        self.counts.negotiations += 1
        known = tuple(info for info in self._topics.all() if info.topic_id not in self._refused)
        is_changed = known != self._known
        if is_changed:
            self._outbox.drop_messages()
            self._clock.forget_same_asks()
        self._known = known
        gap_at = self._topics.gap()
        self._clock.finish(gap_at, is_short=bool(self._topics.missing))
        return events.TopicsNegotiated(known, is_changed, gap_at)

    def _ask_if_due(self, now_s: float) -> Iterator[events.Event]:
        reason = self._clock.take_wish(now_s)
        if reason is not None:
            self.counts.asks += 1
            self._outbox.put_topics_request()
            yield events.TopicsAsked(reason)

    # -- towards the device -------------------------------------------------------------------------------------------

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
        """The frame, or FrameTooLarge."""
        if len(payload) + OVERHEAD_BYTES > limit_bytes:
            error = FrameTooLarge(what, len(payload) + OVERHEAD_BYTES, limit_bytes)
            self.too_large = str(error)
            raise error
        return encode(topic_id, payload)

    def _prompt(self, info: TopicInfo, frame: bytes) -> bytes:
        """The frame, or FrameTooLarge if a stop would have to wait behind it."""
        if self._outbox.robot_moves and len(frame) > self._outbox.prompt_bytes:
            raise FrameTooLarge(info.name, len(frame), int(self._outbox.prompt_bytes), when="while the robot moves")
        return frame


def response_bytes(response: TopicInfo) -> int:
    """How long the payload of a response to the device may be."""
    return _buffer_bytes(response) - OVERHEAD_BYTES


def _buffer_bytes(info: TopicInfo) -> int:
    """What the device takes, as far as a frame can be so long; old clients announce nothing."""
    return min(info.buffer_bytes, MAX_PAYLOAD_BYTES + OVERHEAD_BYTES) if info.buffer_bytes > 0 else DEFAULT_BUFFER_BYTES
