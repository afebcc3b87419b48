"""XrceSession: the host's side of DDS-XRCE with one micro-ROS board. Decides what bytes and times mean.

The session owns the framing, the clients behind one address, their objects and streams, and the outbox. The Link moves
the bytes and reads the clock.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from typing import Final

from hostlink.core.messages.serialisation import CDR
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind, to_device_key
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.link_evidence import Explain
from hostlink.core.protocol.outbox import ControlFrames, Outbox, OutgoingFrame
from hostlink.core.protocol.session import DeviceSession
from hostlink.core.protocol.xrce.client import EMPTY, REPEAT_S, WAITING_MAX, Reading, XrceClient, is_data_for
from hostlink.core.protocol.xrce.evidence import DOUBT_S, Evidence
from hostlink.core.protocol.xrce.findings import Facts, OwnCounts, explain
from hostlink.core.protocol.xrce.framing import Framing
from hostlink.core.protocol.xrce.names import NO_TYPE
from hostlink.core.protocol.xrce.objects import ENDPOINTS, decode_object, kind_of
from hostlink.core.protocol.xrce.payloads import Payloads
from hostlink.core.protocol.xrce.resume import SessionState
from hostlink.core.protocol.xrce.streams import WINDOW, ReliableInput, ReliableOutput
from hostlink.core.protocol.xrce.wire import (
    BEST_EFFORT,
    CLIENT_ID,
    FORMAT,
    KEYLESS,
    LAST_FRAGMENT,
    LITTLE,
    NO_STREAM,
    RELIABLE,
    REPLACE,
    REQUEST_BYTES,
    REUSE,
    SAMPLE_IDENTITY_BYTES,
    SUBHEADER_BYTES,
    UNLIMITED,
    VERSION,
    ClientInfo,
    Kind,
    Message,
    ObjectKind,
    Range,
    ReadRequest,
    Status,
    Submessage,
    decode_acknack,
    decode_client,
    decode_heartbeat,
    decode_message,
    decode_read,
    decode_request,
    decode_submessages,
    decode_timestamp,
    distance,
    encode_client,
    encode_data,
    encode_info,
    encode_message,
    encode_status,
    encode_status_agent,
    encode_submessage,
    encode_timestamp_reply,
    join_submessages,
)
from hostlink.core.runtime.stop_frames import StopFrames
from hostlink.errors import BadPayload, DeviceBusy, DeviceGone, FrameTooLarge, HostlinkError, UnknownTopic, WrongType

NAME: Final = "micro-ROS"
UNANSWERED: Final = "its board answered nothing about a long message, which was dropped"
UNANNOUNCED: Final = "its board has begun anew and has not announced it yet"
CHANGED: Final = "its board has created it again with another name or type, which is announced within a second"
CLIENTS_MAX: Final = 4  # behind one address; the id of an endpoint has two bits for them
MTU_MIN: Final = 32  # less has no room for an answer
QUIET_S: Final = 0.1  # a board creates its objects one after another, each within a round trip
RESTART_SILENCE_S: Final = 1.0  # another client with this session id or key is the same board after a restart
GONE_S: Final = 3.0
LEAVING_S: Final = 1.0  # a client that is refuted takes its last zeros until then
KEEPALIVE_S: Final = 1.0  # after this silence a HEARTBEAT asks whether the board is alive
KEPT_BYTES: Final = 1024  # of bytes that are in no message
LATE_CREATION_S: Final = 2.0  # a CREATE_CLIENT of the session before is a late datagram until then
ZERO_NUMBERS: Final = (0, 0x5555, 0xAAAA)
STOP_INTERVAL_S: Final = 0.12  # a client asks for an acknowledgement after 100 ms without a message
ACKNOWLEDGER: Final = "hostlink.core.protocol.xrce.acknowledging"
ZEROS_BYTES: Final = 64  # of a response whose layout is unknown
CALL_NUMBERS: Final = 2**32 - 1  # of calls, from 1 on
CALLS_MAX: Final = 16  # of one service client or service of the device, waiting
FRAGMENT_BYTE: Final = bytes((Kind.FRAGMENT,))
ACK_S: Final = 0.005  # a client sends the next fragment sooner than this
ANSWERS: Final = "answers"
CREATED: Final = LITTLE | REUSE | REPLACE

SLOT_SHIFT: Final = 14
EXTRA_BYTES: Final = 12  # an ACKNACK or a HEARTBEAT with its padding


class Quality:
    """Counts of one connection for a diagnosis, since the link opened."""

    __slots__ = (
        "best_effort", "best_effort_late", "creations", "deleted", "duplicates", "missing", "pings", "refuted",
        "reliable", "resent", "restarts", "resumed", "unknown", "unread", "waits",
    )  # fmt: skip

    def __init__(self) -> None:
        self.pings = 0  # of a client, or before there is one
        self.creations = 0  # CREATE_CLIENT
        self.best_effort = 0  # messages; those that were lost are in the SessionCounts
        self.best_effort_late = 0
        self.reliable = 0  # messages, each counted once
        self.duplicates = 0  # messages that the device sent twice, unless it was asked for them while it began
        self.missing = 0  # times that a message had not come when a later one had
        self.resent = 0  # messages that were sent to the device again
        self.waits = 0  # HEARTBEATs of a device that has waited for an acknowledgement
        self.restarts = 0  # clients that began anew
        self.deleted = 0  # clients that ended, and have not begun anew
        self.refuted = 0  # stored clients that were others
        self.resumed = 0  # clients that went on after a restart of the host
        self.unknown = 0  # messages of clients that were not created here
        self.unread = 0  # messages to readers that want no more


class _TimeAnswer:
    """Answer to the last TIMESTAMP. Its time is that of sending."""

    __slots__ = ("key", "originated", "session")

    def __init__(self) -> None:
        self.session, self.key, self.originated = KEYLESS, b"", bytes(8)

    def encode(self, wall_ns: int) -> bytes:
        reply = encode_timestamp_reply(wall_ns, self.originated)
        return encode_message(self.session, self.key, NO_STREAM, 0, reply)


class XrceSession(DeviceSession):
    """State of one micro-ROS board, host side. All times are of one monotonic clock, in seconds.

    | a client is   | until                                                                              |
    |---------------|------------------------------------------------------------------------------------|
    | created       | CREATE_CLIENT: it has no objects                                                   |
    | announced     | nothing was created for QUIET_S, or it published: the hub knows its endpoints      |
    | created again | the same key: its objects stay; another key: they go, and the next ones are awaited |
    | resumed       | from a stored state: nothing is sent or passed on until its Evidence is enough     |
    | gone          | DELETE of the client                                                               |
    """

    def __init__(
        self,
        framing: Framing,
        payloads: Payloads,
        *,
        uart_bytes_s: int | None = None,
        max_topics: int = 256,
        velocity_stream: int = NO_STREAM,
        state: SessionState | None = None,
    ) -> None:
        """`velocity_stream`: NO_STREAM or BEST_EFFORT, for clients that refuse messages without a number.

        `state`: what an earlier session with a board of this address had.
        """
        self._time = _TimeAnswer()
        control = ControlFrames(self._time.encode, b"", b"")
        super().__init__(NAME, Outbox(control, uart_bytes_s=uart_bytes_s, encode=self._encode))
        self.quality = Quality()
        self.state_version = 0  # changes when the state is worth storing
        self._framing, self._payloads = framing, payloads
        self._max_topics, self._velocity_stream = max_topics, velocity_stream
        self._now_s = 0.0
        self._clients: dict[tuple[int, bytes], XrceClient] = {}
        self._replaced: dict[int, tuple[bytes, float]] = {}  # session id -> key before the current one, since when
        self._known: tuple[DeviceEndpoint, ...] = ()
        self._by_key: dict[int, DeviceEndpoint] = {}
        self._by_name: dict[tuple[str, int], DeviceEndpoint] = {}
        self._refused: dict[int, HostlinkError] = {}
        self._announce_s = math.inf  # when the endpoints are complete
        self._is_restarted = False  # since the last announcement
        self._acks: dict[tuple[int, bytes, int], None] = {}  # streams to acknowledge
        self._calls: dict[int, deque[int]] = {}  # numbers of the last calls to a service of the device
        self._call_number = 1  # of the next call; 0 is that of `zero_frames`
        self._requests = 0  # of the device, since the link opened
        self._undecodable = 0
        if state is not None:
            self._resume(state)

    # -- what the link reports ----------------------------------------------------------------------------------------

    def open(self, *, now_s: float) -> list[events.Event]:
        """Begin a new connection. A board speaks first."""
        self._now_s = now_s
        for client in self._clients.values():
            client.begin(now_s)
        return []

    def receive(self, data: bytes, *, now_s: float) -> list[events.Event]:
        """Process bytes from the device. What answers them is queued before this returns."""
        self._now_s = now_s
        self.counts.bytes_from_device += len(data)
        found: list[events.Event] = []
        messages = self._framing.feed(data)
        for skipped in self._framing.skipped:
            self._skip(skipped)
        for each in messages:
            message = decode_message(each)
            if message is None:
                self._skip(each)
            else:
                self.counts.frames_from_device += 1
                self._read(message, now_s, found)
        for client in self._clients.values():
            if client.held:
                self._send_held(client, now_s)
        if self._acks:
            self._put_acks(now_s)
        self._release(now_s)
        return found

    def tick(self, *, now_s: float) -> list[events.Event]:
        """Do what is due by now. Call it at `deadline_s`."""
        self._now_s = now_s
        found: list[events.Event] = []
        if now_s >= self._announce_s:
            if any(each.is_creating for each in self._clients.values()):
                self._announce_s = now_s + QUIET_S
            else:
                self._announce(found)
        for client in list(self._clients.values()):
            if now_s >= client.leaves_s:
                self._remove(client)
                continue
            if now_s >= client.settled_s:
                self._judge(client, found)
                if not client.is_confirmed:  # it only listens, and its number tells nothing for sure
                    self._refute(client)
                    continue
            if now_s >= client.heartbeat_s:
                if heartbeat := client.due_heartbeat(now_s):
                    self._put(heartbeat)
                self._note_tried(client, found)
            elif now_s >= client.silent_at_s(KEEPALIVE_S):
                if self._is_replaced(client, now_s):
                    self._remove(client)
                    continue
                if client.is_reset_due:  # it may begin later. One whose session is the same tells its numbers again
                    self._begin_anew(client)
                self._put(client.message(NO_STREAM, client.heartbeat(now_s)))
            if now_s >= client.repair_s and (repair := client.due_repair(now_s)):
                self._put(client.message(NO_STREAM, repair))
            if now_s >= client.ack_s:
                client.ack_s = math.inf
                self._acks |= {(client.session, client.id_key, stream): None for stream in client.inputs}
            self._send_held(client, now_s)
            self._repeat_zeros(client, now_s)
        self._put_acks(now_s)
        self._release(now_s)
        return found

    def deadline_s(self) -> float:
        """Time at which `tick` must be called if no byte arrives before."""
        deadline_s = self._announce_s
        for client in self._clients.values():
            deadline_s = min(deadline_s, client.planned_s, client.silent_at_s(KEEPALIVE_S))
            if client.samples:
                deadline_s = min(deadline_s, self._sample_due_s(client))
            if client.held:
                deadline_s = min(deadline_s, client.free_s(self._now_s))
            for zero in client.zeros.values():
                deadline_s = min(deadline_s, zero.due_s)
        return deadline_s

    @property
    def is_steady(self) -> bool:
        """Whether only a long silence is waited for."""
        return self._announce_s == math.inf and not any(
            each.planned_s < math.inf or each.samples or each.held or each.zeros for each in self._clients.values()
        )

    @property
    def is_regular(self) -> bool:
        """Whether the board answers a HEARTBEAT, as a live client with a reliable stream does."""
        return any(each.has_answered for each in self._clients.values())

    def pop_frame(self, *, now_s: float, wall_ns: int) -> OutgoingFrame | None:
        """Remove and return the next frame. None: the queues are empty, or the device's UART is busy."""
        self._now_s = now_s
        return super().pop_frame(now_s=now_s, wall_ns=wall_ns)

    @property
    def captured_as(self) -> str:
        """Name by which the protocol of a capture is found again: with the transport, which has its own framing."""
        return f"{NAME}/{self._framing.captured_as}"

    @property
    def bad_checksums(self) -> int:
        """Number of serial frames with a wrong checksum."""
        return self._framing.bad_checksums

    @property
    def wrong_sizes(self) -> int:
        """Number of messages that are not of their type."""
        return self._undecodable

    @property
    def rejected(self) -> dict[str, int]:
        """Number of rejected frames, by cause."""
        framing = self._framing
        found = {"checksum": framing.bad_checksums, "length": framing.bad_lengths, "wrong_size": self._undecodable}
        return {cause: count for cause, count in found.items() if count}

    def too_small(self, least_bytes: Callable[[str], int]) -> list[str]:
        """Say which topics are longer than a message and are published without acknowledgement: none arrives."""
        found: list[str] = []
        for client in self._clients.values():
            for each in client.objects.endpoints():
                if each.kind == ObjectKind.DATAWRITER and not each.is_reliable:
                    name, type_ = client.objects.name_and_type(each)
                    room_bytes = client.mtu - client.header_bytes - SUBHEADER_BYTES - REQUEST_BYTES
                    if (size_bytes := least_bytes(type_)) > room_bytes:
                        found.append(
                            f"{name}: a message of at least {size_bytes} bytes, best effort takes {room_bytes}"
                        )
        return found

    @property
    def own_counts(self) -> tuple[int, ...]:
        """The OwnCounts for the rules."""
        q = self.quality
        return OwnCounts(
            greetings=q.pings + q.creations,
            best_effort=q.best_effort,
            best_effort_lost=self.counts.lost_messages,
            reliable=q.reliable,
            duplicates=q.duplicates,
            missing=q.missing,
            resent=q.resent,
            restarts=q.restarts,
            waits=q.waits,
            unknown=q.unknown,
        )

    @property
    def explain(self) -> Explain:
        """Rules of micro-ROS, with what is known now."""
        slowest = max(self._clients.values(), key=_measured_s, default=None)
        facts = Facts(
            is_serial=self._framing.transport == "serial",
            clients=len(self._clients),
            resumed=self.quality.resumed,
            refuted=self.quality.refuted,
            pings=self.quality.pings,
            round_trip_s=0.0 if slowest is None else slowest.round_trip_s,
            least_round_trip_s=0.0 if slowest is None else slowest.least_round_trip_s,
            round_trips=0 if slowest is None else slowest.round_trips,
            too_large=self.too_large,
            raw=tuple(f"{each.name} ({each.type})" for each in self.raw_endpoints if each.type != NO_TYPE),
            references=tuple(each.name for each in self._known if each.type == NO_TYPE),
            excess=self.excess_objects + self.counts.excess_topics,
        )
        return partial(explain, facts)

    def rest_of_frame_bytes(self, pieces: Iterable[bytes]) -> int:
        """Number of bytes before the first whole message of captured bytes whose beginning is lost."""
        return self._framing.rest_bytes(pieces)

    # -- what the device is -------------------------------------------------------------------------------------------

    @property
    def topics(self) -> tuple[DeviceEndpoint, ...]:
        """The usable endpoints of the last announcement."""
        return self._known

    @property
    def refusals(self) -> tuple[tuple[DeviceEndpoint, HostlinkError], ...]:
        """Endpoints that cannot be used, with the reason."""
        return tuple((self._by_key[key], reason) for key, reason in self._refused.items())

    def is_refused(self, endpoint: DeviceEndpoint) -> bool:
        """Whether this endpoint was refused because of its type."""
        return endpoint.key in self._refused

    def has(self, endpoint: DeviceEndpoint) -> bool:
        """Whether the device still has this endpoint."""
        is_known = self._by_key.get(endpoint.key) == endpoint
        return is_known and self._holding(endpoint) is not None and not self._is_changed(endpoint)

    def may_have(self, endpoint: DeviceEndpoint) -> bool:
        """Whether the device may still have this endpoint: its id has no other name or type now."""
        return self._by_key.get(endpoint.key, endpoint) == endpoint and not self._is_changed(endpoint)

    @property
    def raw_encoding(self) -> str:
        """Serialisation of messages whose type has no definition: CDR."""
        return CDR

    @property
    def raw_endpoints(self) -> tuple[DeviceEndpoint, ...]:
        """Endpoints whose messages are passed on as CDR, because their type has no definition."""
        return tuple(each for each in self._known if self._payloads.is_raw(each))

    @property
    def node(self) -> str:
        """Name of the board's node, with its namespace if it has one; empty if it is unknown."""
        return next((each.objects.node for each in self._clients.values() if each.objects.node), "")

    @property
    def round_trip_s(self) -> float | None:
        """Time from a HEARTBEAT to its answer: network and a turn of the board's loop; None if it is not measured."""
        measured = [each for each in self._clients.values() if each.round_trips]
        return max((each.round_trip_s for each in measured), default=None)

    @property
    def turn_s(self) -> float | None:
        """Part of `round_trip_s` that is more than the shortest: what the board's loop adds."""
        measured = [each for each in self._clients.values() if each.round_trips]
        return max((each.round_trip_s - each.least_round_trip_s for each in measured), default=None)

    @property
    def too_long_messages(self) -> int:
        """Number of messages that were dropped because the device's history does not hold all of their fragments."""
        return sum(each.output.refused for each in self._clients.values())

    @property
    def excess_objects(self) -> int:
        """Number of objects that were refused because the device has too many."""
        return sum(each.objects.refused for each in self._clients.values())

    def announcement(self, endpoints: Iterable[DeviceEndpoint]) -> bytes:
        """Return messages that create these endpoints, for the beginning of a capture."""
        clients = {client.slot: client for client in self._clients.values()}
        by_slot: dict[int, list[DeviceEndpoint]] = {}
        for each in endpoints:
            by_slot.setdefault(_slot(each), []).append(each)
        found: list[bytes] = []
        for slot, of_client in by_slot.items():
            client = clients.get(slot)
            if client is not None:
                found += _announce_client(client, of_client)
        return self._framing.joined(found)

    @property
    def kept_bytes(self) -> int:
        """Bytes of unfinished messages, and of the objects that the board has created."""
        clients = self._clients.values()
        unfinished = sum(stream.kept_bytes for each in clients for stream in each.inputs.values())
        return unfinished + sum(each.objects.kept_bytes for each in clients)

    def drop_unfinished(self) -> None:
        """Forget messages that are not whole."""
        for client in self._clients.values():
            for stream in client.inputs.values():
                stream.drop_unfinished()

    def probe(self) -> None:
        """Ask something that a working board answers (TopicsAnswered), at most once a second."""
        now_s = self._now_s
        for client in self._clients.values():
            if client.is_confirmed and not client.is_reset_due and now_s - client.probed_s >= KEEPALIVE_S:
                self._put(client.message(NO_STREAM, client.heartbeat(now_s)))
                self.device_clock.topics_requested(now_s)

    # -- what the hub sends -------------------------------------------------------------------------------------------

    def publish(
        self, topic: str, payload: bytes, *, depth: int = 1, is_urgent: bool = False, is_kept: bool = False
    ) -> None:
        """Queue a message to the device.

        Raises:
            UnknownTopic: the device does not subscribe to it.
            WrongType: the payload is not one of the topic's type, or the topic was refused.
            FrameTooLarge: the device has less room, or a stop would wait behind the message.
        """
        endpoint, client, content = self._to_endpoint("topic", topic, EndpointKind.SUBSCRIBER, payload)
        if is_urgent:
            message = self._velocity(client, endpoint, content)
            client.note_velocity(endpoint.id, self._now_s)
            self._drop_samples(client, endpoint)
            if client.is_listening(self._now_s) or self._now_s < client.free_s(self._now_s):
                self.outbox.replaced += endpoint.id in client.held
                client.held[endpoint.id] = (message, is_kept)
            else:
                self.outbox.put_urgent(endpoint.id, message, is_kept=is_kept)
            return
        self._check_room(client, endpoint, content)
        waiting = client.samples.setdefault(object_id(endpoint), deque())
        while len(waiting) >= depth:
            waiting.popleft()
            self.outbox.replaced += 1
        waiting.append(content)
        self._release(self._now_s)

    def send_zero(self, endpoint: DeviceEndpoint, payload: bytes, *, is_kept: bool = False) -> bool:
        """Queue a zero, and repeat it until the board has answered it. Return whether the device `may_have` it."""
        client = self._client_of(endpoint)
        if client is None or not self.may_have(endpoint):
            return False
        if endpoint.kind is not EndpointKind.SUBSCRIBER:  # a service that stops the device
            self.call(endpoint.name, payload)
            return True
        client.held.pop(endpoint.id, None)
        self._drop_samples(client, endpoint)
        message = self._velocity(client, endpoint, self._translated(endpoint, payload))
        client.note_zero(endpoint.id, message, self._now_s)
        self.outbox.put_urgent(endpoint.id, message, is_kept=is_kept)
        return True

    def drop_commands(self, endpoint: DeviceEndpoint) -> None:
        """Send no message of an endpoint that waits, and none again that was lost."""
        super().drop_commands(endpoint)
        client = self._client_of(endpoint)
        if client is not None:
            client.held.pop(endpoint.id, None)
            self._drop_samples(client, endpoint)

    def zero_frames(self, endpoint: DeviceEndpoint, payload: bytes) -> tuple[bytes, ...]:
        """Return a zero: a message without a number, which stays the same.

        On a best-effort stream a client takes numbers that are ahead of its newest one, by less than half of all. Of
        three zeros, each a third of all numbers ahead of the one before, the newest number is behind one at any time.
        """
        client = self._client_of(endpoint)
        if client is None:
            return ()
        content = self._translated(endpoint, payload)
        if endpoint.kind is not EndpointKind.SUBSCRIBER:  # a service that stops the device
            content = _identity(0) + content
        data = encode_data(client.request_of(object_id(endpoint)), object_id(endpoint), content)
        numbers = (0,) if self._velocity_stream == NO_STREAM else ZERO_NUMBERS
        messages = (client.message(self._velocity_stream, data, number) for number in numbers)
        return tuple(map(self._framing.encode, messages))

    def stop_frames(self, zeros: tuple[bytes, ...]) -> StopFrames:
        """Return these messages, and what acknowledges those of the board. On TCP none is expected to be half sent."""
        return StopFrames(zeros, interval_s=STOP_INTERVAL_S, acknowledger=f"{ACKNOWLEDGER}:{self._framing.transport}")

    def endpoint_of(self, topic: str, payload: bytes) -> DeviceEndpoint:
        """Return the endpoint of a topic to which the device subscribes. It takes messages as long as this one.

        Raises:
            HostlinkError: as from `publish`.
        """
        endpoint, client, content = self._to_endpoint("topic", topic, EndpointKind.SUBSCRIBER, payload)
        self._check_room(client, endpoint, content)
        return endpoint

    def service_endpoint(self, service: str, payload: bytes) -> DeviceEndpoint:
        """Return the endpoint that takes the requests to a service of the device. It takes one as long as this one.

        Raises:
            HostlinkError: as from `call`.
        """
        return self._to_service(service, payload)[0]

    def call(self, service: str, payload: bytes) -> bytes:
        """Queue a request to a service of the device, and return its identity.

        Raises:
            UnknownTopic: the device has no such service.
            WrongType: the payload is not one of the request's type, or the service was refused.
            FrameTooLarge: the device has less room, or a stop would wait behind the message.
            DeviceBusy: too many requests and responses wait.
        """
        endpoint, client, content = self._to_service(service, payload)
        self._check_prompt(endpoint, len(content))
        number, identity = self._call_number, _identity(self._call_number)
        self._put_sample(client, endpoint, identity + content)
        self._calls.setdefault(endpoint.id, deque(maxlen=CALLS_MAX)).append(number)
        self.number_calls(number + 1)
        return identity

    def number_calls(self, first: int) -> None:
        """Give the next call this number: an answer to an earlier daemon's call must not be that to it."""
        self._call_number = (first - 1) % CALL_NUMBERS + 1

    def response_endpoint(self, request: DeviceEndpoint) -> DeviceEndpoint:
        """Return the endpoint at which the device receives the response to a request of this endpoint.

        Raises:
            UnknownTopic: the device announced no such endpoint.
        """
        response = request._replace(kind=EndpointKind.SERVICE_CLIENT_SUBSCRIBER)
        if request.kind is not EndpointKind.SERVICE_CLIENT_PUBLISHER or self._by_key.get(response.key) != response:
            raise UnknownTopic("endpoint for responses", request.name)
        return response

    def respond(self, response: DeviceEndpoint, payload: bytes | None, *, request: bytes | None = None) -> None:
        """Queue a response to the request with this identity.

        `payload` is None when the layout is unknown. Then zeros are sent, as for rosserial.

        Raises:
            FrameTooLarge: the device has less room.
            DeviceBusy: too many requests and responses wait.
            UnknownTopic: the device does not wait for this response.
        """
        client = self._client_of(response)
        waiting = None if client is None else client.calls.get(object_id(response))
        if client is None or waiting is None or request is None or request not in waiting:
            raise UnknownTopic("request", response.name)
        content = bytes(ZEROS_BYTES) if payload is None else self._translated(response, payload)
        self._check_room(client, response, content)
        self._put_sample(client, response, request[-REQUEST_BYTES:] + content)
        waiting.remove(request)

    def is_waiting_for(self, service: DeviceEndpoint, request: bytes) -> bool:
        """Whether the device still waits for the response to this request: it has not begun anew meanwhile."""
        client = self._client_of(service)
        return client is not None and request in client.calls.get(object_id(service), ())

    def leave_unanswered(self, service: DeviceEndpoint, request: bytes) -> None:
        """Forget a request: its response cannot be sent, and others may wait in its place."""
        client = self._client_of(service)
        if client is not None:
            client.calls.get(object_id(service), set()).discard(request)

    def room_bytes(self, endpoint: DeviceEndpoint) -> int:
        """Longest payload that the device takes at an endpoint: in one message, or in as many as its history holds."""
        client = self._client_of(endpoint)
        if client is None:
            return 0
        before_bytes = REQUEST_BYTES + (SAMPLE_IDENTITY_BYTES if endpoint.kind is not EndpointKind.SUBSCRIBER else 0)
        return client.room_bytes(object_id(endpoint)) - before_bytes

    def answer_parameter(self, name: str, parameter: Parameter) -> None:
        """Do nothing: a board asks for no parameters in this way."""

    # -- endpoints ----------------------------------------------------------------------------------------------------

    def _client_of(self, endpoint: DeviceEndpoint) -> XrceClient | None:
        slot = _slot(endpoint)
        return next((each for each in self._clients.values() if each.slot == slot and each.is_confirmed), None)

    def _holding(self, endpoint: DeviceEndpoint) -> tuple[XrceClient, tuple[str, str]] | None:
        """Return the client of an endpoint, and the name and type that its object has now; None if it has none."""
        client = self._client_of(endpoint)
        now = None if client is None else client.objects.by_id.get(object_id(endpoint))
        return None if client is None or now is None else (client, client.objects.name_and_type(now))

    def _is_changed(self, endpoint: DeviceEndpoint) -> bool:
        """Whether the object of an endpoint has another name or type now."""
        holding = self._holding(endpoint)
        return holding is not None and holding[1] != (endpoint.name, endpoint.type)

    def _drop_changed(self, client: XrceClient) -> None:
        """Drop what waits for readers that have another name or type now: they would misread the bytes."""
        for each in self._by_key.values():
            if each.kind is EndpointKind.SUBSCRIBER and _slot(each) == client.slot and self._is_changed(each):
                self.outbox.drop_topic(each.id)
                client.drop_velocity(each.id)
                self._drop_samples(client, each)

    def _to_endpoint(
        self, what: str, name: str, kind: EndpointKind, payload: bytes
    ) -> tuple[DeviceEndpoint, XrceClient, bytes]:
        """Return the endpoint of a name, its client, and the payload for it."""
        endpoint = self._by_name.get((name, kind))
        if endpoint is None:
            raise UnknownTopic(what, name, tuple(each.name for each in self._known if each.kind is kind))
        holding = self._holding(endpoint)
        if holding is None or not holding[0].is_announced:  # it may have begun anew, at rest
            raise UnknownTopic(what, name, why=UNANNOUNCED)
        client, now = holding
        if now != (endpoint.name, endpoint.type):
            raise UnknownTopic(what, name, why=CHANGED)
        if endpoint.key in self._refused:
            raise self._refused[endpoint.key].with_traceback(None)  # otherwise the traceback grows with each raise
        return endpoint, client, self._translated(endpoint, payload)

    def _to_service(self, service: str, payload: bytes) -> tuple[DeviceEndpoint, XrceClient, bytes]:
        found = self._to_endpoint("service", service, EndpointKind.SERVICE_SERVER_SUBSCRIBER, payload)
        self._check_room(found[1], found[0], found[2])
        return found

    def _translated(self, endpoint: DeviceEndpoint, payload: bytes) -> bytes:
        try:
            return self._payloads.to_device(endpoint, payload)
        except BadPayload as error:
            raise WrongType(endpoint.name, endpoint.type, f"{len(payload)} bytes: {error}") from None

    def _check_room(self, client: XrceClient, endpoint: DeviceEndpoint, content: bytes) -> None:
        if len(content) > self.room_bytes(endpoint):
            raise self._too_large(endpoint, len(content), self.room_bytes(endpoint))
        if endpoint.kind is EndpointKind.SUBSCRIBER:
            self._check_prompt(endpoint, len(content) + client.header_bytes + SUBHEADER_BYTES + REQUEST_BYTES)

    def _too_large(self, endpoint: DeviceEndpoint, size_bytes: int, room_bytes: int) -> FrameTooLarge:
        """Return the error of a message that the board has no room for, and keep its text for the findings."""
        error = FrameTooLarge(endpoint.name, size_bytes, room_bytes)
        self.too_large = str(error)
        return error

    def _check_prompt(self, endpoint: DeviceEndpoint, size_bytes: int) -> None:
        """Raise FrameTooLarge if a message would delay a stop."""
        if self.outbox.robot_moves and size_bytes > self.outbox.prompt_bytes:
            raise FrameTooLarge(endpoint.name, size_bytes, int(self.outbox.prompt_bytes), when="while the robot moves")

    def _velocity(self, client: XrceClient, endpoint: DeviceEndpoint, content: bytes) -> bytes:
        """Return the message of a velocity, which has no acknowledgement and fits one message."""
        data = encode_data(client.request_of(object_id(endpoint)), object_id(endpoint), content)
        message = client.message(self._velocity_stream, data)
        if len(message) > client.mtu:
            raise self._too_large(endpoint, len(message), client.mtu)
        return message

    def _drop_samples(self, client: XrceClient, endpoint: DeviceEndpoint) -> None:
        """Drop the messages of a reader that wait. A number that was given is sent with an empty body.

        Of a message in fragments the client needs all: these stay.
        """
        id_, start = object_id(endpoint), client.header_bytes
        self.outbox.replaced += client.drop_samples(id_)
        for each in self.outbox.answers.get(ANSWERS, ()):
            if each.frame[0] == client.session and is_data_for(each.frame[start:], id_):
                each.frame = each.frame[:start] + EMPTY

    # -- messages from the device -------------------------------------------------------------------------------------

    def _skip(self, data: bytes) -> None:
        self.counts.skipped_bytes += len(data)
        self.foreign = (self.foreign + data)[-KEPT_BYTES:]

    def _read(self, message: Message, now_s: float, found: list[events.Event]) -> None:
        """Read one message: at once, in order, or not at all, as its stream has it."""
        client = self._clients.get((message.session, message.key))
        stream = message.stream
        if client is not None:
            client.note_heard(now_s)
        if stream == NO_STREAM:
            for each in self._submessages(message.body):
                self._handle_plain(client, message, each, found)
            return
        if client is None:
            self.counts.unknown_ids += 1
            self.quality.unknown += 1
            return
        if client.is_over:
            return
        if client.is_reset_due:
            self._settle_reset(client, message)
            if client.is_reset_due:
                return
        if stream < RELIABLE:
            lossy = client.lossy_input(stream)
            lost = -1 if lossy is None else lossy.lost_before(message.number)
            if lost < 0:
                self.quality.best_effort_late += 1
                return
            self.quality.best_effort += 1
            self.counts.lost_messages += lost  # gaps in the numbers: exact
            for each in self._submessages(message.body):
                self._handle(client, stream, each, found)
            return
        if client.is_refuted_by(stream, message.number):
            self._refute(client)
            return
        reliable = client.input(stream)
        if reliable is None:
            self.counts.refused_frames += 1
            return
        client.note_message(now_s)
        before = reliable.duplicates
        bodies = reliable.receive(message.number, message.body)
        again = reliable.duplicates - before
        if again and not client.was_creating(now_s) and reliable.is_judged(message.number):
            self.quality.duplicates += again
        self.quality.reliable += 1 - again
        self._read_bodies(client, reliable, bodies, found)

    def _read_bodies(
        self,
        client: XrceClient,
        reliable: ReliableInput,
        bodies: list[bytes],
        found: list[events.Event],
        *,
        is_asked: bool = False,
    ) -> None:
        """Read the bodies of a reliable stream in order, and acknowledge them.

        A part of a message, and what came in the wrong order, waits for a moment: a client that reads two ACKNACKs in
        the wrong order forgets what it keeps, and sends everything again when something is missing.
        """
        bodies += reliable.give_up(self._now_s)
        is_first_part = len(bodies) == 1 and bodies[0][:1] == FRAGMENT_BYTE and not bodies[0][1] & LAST_FRAGMENT
        is_early = not is_asked and bool(is_first_part or reliable.missing())
        if is_early:
            client.ack_s = min(client.ack_s, self._now_s + ACK_S)  # the rest follows, or was only overtaken
        else:
            self._acks[client.session, client.id_key, reliable.stream] = None
        for body in bodies:
            for each in self._submessages(body):
                if each.kind != Kind.FRAGMENT:
                    reliable.fragments.end_skipping()
                    self._handle(client, reliable.stream, each, found)
                    continue
                whole = reliable.fragments.add(each.payload, is_last=bool(each.flags & LAST_FRAGMENT))
                for inner in self._submessages(whole) if whole is not None else ():
                    self._handle(client, reliable.stream, inner, found)

    def _submessages(self, body: bytes) -> list[Submessage]:
        found, rest_bytes = decode_submessages(body)
        self.counts.malformed += rest_bytes > 0
        return found

    def _handle_plain(
        self, client: XrceClient | None, message: Message, submessage: Submessage, found: list[events.Event]
    ) -> None:
        """Handle a submessage on no stream. Some need no client."""
        kind = submessage.kind
        if kind == Kind.CREATE_CLIENT:
            self.quality.creations += 1
            self._create_client(submessage)
        elif kind == Kind.GET_INFO:
            self.quality.pings += 1
            request = decode_request(submessage)
            if request is None:
                self.counts.malformed += 1
                return
            info = encode_info(*request, is_in_session=client is not None)
            self._put(encode_message(message.session, message.key, NO_STREAM, 0, info))
        elif kind == Kind.TIMESTAMP:
            originated = decode_timestamp(submessage)
            if originated is None:
                self.counts.malformed += 1
                return
            self._time.session, self._time.key, self._time.originated = message.session, message.key, originated
            self.outbox.put_time()
            found.append(events.TimeRequested())
        elif kind == Kind.DELETE and (request := decode_request(submessage)) is not None and request[1] == CLIENT_ID:
            self._delete_client(client)
            status = encode_status(*request, Status.OK)
            self._put(encode_message(message.session, message.key, NO_STREAM, 0, status))
        elif client is None:
            self.counts.unknown_ids += 1
            self.quality.unknown += 1
        else:
            self._handle(client, NO_STREAM, submessage, found)

    def _handle(self, client: XrceClient, stream: int, submessage: Submessage, found: list[events.Event]) -> None:
        """Handle a submessage of a client."""
        kind = submessage.kind
        if client.is_over:
            return
        if kind == Kind.WRITE_DATA:
            self._take_data(client, submessage, found)
        elif kind == Kind.ACKNACK and (told := decode_acknack(submessage)) is not None:
            if told.stream == RELIABLE:
                self._take_acknack(client, told, found)
        elif kind == Kind.HEARTBEAT and (told := decode_heartbeat(submessage)) is not None:
            if told.stream >= RELIABLE and client.is_refuted_by(told.stream, told.first, told.second):
                self._refute(client)
                return
            if told.stream >= RELIABLE and client.is_reset_due:
                self._settle_by_heartbeat(client, told)
            reliable = client.input(told.stream) if told.stream >= RELIABLE else None
            if reliable is not None:
                self.quality.waits += 1
                bodies = reliable.heartbeat(told.first, told.second)
                self._read_bodies(client, reliable, bodies, found, is_asked=True)
        elif kind == Kind.READ_DATA and (wanted := decode_read(submessage)) is not None:
            self._take_read(client, stream, wanted, submessage.payload)
        elif kind in {Kind.CREATE, Kind.DELETE} and (request := decode_request(submessage)) is not None:
            if kind == Kind.DELETE:
                status = client.delete(request[1])
            else:
                new = decode_object(submessage)
                if not client.is_confirmed and (new is None or not client.objects.has(new)):
                    self._refute(client)
                    return
                status = Status.INVALID_DATA if new is None else client.objects.create(new, submessage.flags)
                self.counts.malformed += new is None
                if status == Status.OK:
                    self._drop_changed(client)
            client.note_creating(self._now_s)
            if status in {Status.OK, Status.MATCHED}:
                self._announce_s = self._now_s + QUIET_S
            self._answer(client, stream, encode_status(*request, status))
        else:
            self.counts.malformed += 1

    # -- clients ------------------------------------------------------------------------------------------------------

    def _create_client(self, submessage: Submessage) -> None:
        """Create a client, or find that it is an earlier one again."""
        info = decode_client(submessage)
        if info is None:
            self.counts.malformed += 1
            return
        status: int = Status.OK
        if info.version[:1] != VERSION[:1]:
            status = Status.INCOMPATIBLE
        elif info.mtu < MTU_MIN:
            status = Status.INVALID_DATA
        else:
            known = self._clients.get((info.session, _id_key(info)))
            if known is not None and known.is_over:
                self._remove(known)
                known = None
            if known is not None and known.info.key == info.key:
                self._create_again(known, info)
            elif self._is_late(info):
                return
            elif not self._add_client(info, known):
                status = Status.RESOURCES
        agent = encode_status_agent(status)
        self._put(encode_message(info.session, info.key, NO_STREAM, 0, agent))

    def _create_again(self, known: XrceClient, info: ClientInfo) -> None:
        """Take a client's CREATE_CLIENT that is not its first: a repetition, or a new session of the same board."""
        if not known.is_confirmed:
            known.is_confirmed = True
            known.reset_streams(self._now_s)
            self._announce_s = self._now_s + QUIET_S
        known.info, known.mtu = info, min(info.mtu, self._framing.limit_bytes)
        may_be_late = self._now_s - known.asked_s < LATE_CREATION_S
        known.asked_s = self._now_s
        if not known.has_begun:  # the answer was lost: its objects follow now
            known.note_creating(self._now_s)
        elif may_be_late:
            known.is_reset_due = True
        else:
            self._begin_anew(known)
            known.note_creating(self._now_s)
            self._announce_s = self._now_s + RESTART_SILENCE_S  # its objects follow, and it takes nothing before

    def _is_late(self, info: ClientInfo) -> bool:
        """Whether a CREATE_CLIENT is a late datagram of the session before."""
        key, since_s = self._replaced.get(info.session, (b"", -math.inf))
        return key == info.key and self._now_s - since_s < LATE_CREATION_S

    def _add_client(self, info: ClientInfo, before: XrceClient | None) -> bool:
        """Add a client in place of the one before it, if there is one. Return whether there is room."""
        if before is None:
            silent = [
                each
                for each in self._clients.values()
                if self._now_s - each.heard_s >= RESTART_SILENCE_S
                and (each.session == info.session or each.info.key == info.key or len(self._clients) >= CLIENTS_MAX)
            ]
            before = min(silent, key=_heard_s, default=None)
        if before is not None:
            self._replaced[before.session] = before.info.key, self._now_s
            self._remove(before)
            self.quality.restarts += 1
        elif len(self._clients) >= CLIENTS_MAX:
            return False
        elif self.quality.deleted:
            self.quality.deleted -= 1
            self.quality.restarts += 1
        slot = min(set(range(CLIENTS_MAX)) - {each.slot for each in self._clients.values()})
        client = XrceClient(
            info,
            slot,
            max_endpoints=self._max_topics,
            limit_bytes=self._framing.limit_bytes,
            now_s=self._now_s,
        )
        client.output.is_new = True
        client.note_creating(self._now_s)
        self._clients[info.session, client.id_key] = client
        return True

    def _is_replaced(self, client: XrceClient, now_s: float) -> bool:
        """Whether a client is silent, and a later one may be the same board after a restart."""
        if now_s - client.heard_s < GONE_S:
            return False
        return any(
            each.created_s > client.created_s
            and (
                each.session == client.session
                or each.info.key == client.info.key
                # A client that was heard for longer after the other one was created is another one.
                or (each.created_s > client.heard_s - RESTART_SILENCE_S and _is_likewise(each, client))
            )
            for each in self._clients.values()
        )

    def _is_overtaken(self, client: XrceClient) -> bool:
        """Whether a client was silent since another one was created, which may be the same board after a restart."""
        return any(each.created_s > client.heard_s for each in self._clients.values())

    def _delete_client(self, client: XrceClient | None) -> None:
        if client is not None:
            self._remove(client)
            self.quality.deleted += 1
            self._announce_s = self._now_s + QUIET_S

    def _remove(self, client: XrceClient) -> None:
        """Remove a client. The hub keeps its endpoints until others are complete, or none come."""
        client.is_over = True
        del self._clients[client.session, client.id_key]
        self.outbox.drop_messages()
        self._is_restarted = True
        self._announce_s = self._now_s + RESTART_SILENCE_S
        for each in [each for each in self._calls if each >> SLOT_SHIFT == client.slot]:
            del self._calls[each]

    def _settle_reset(self, client: XrceClient, message: Message) -> None:
        """Decide by a number after a repeated CREATE_CLIENT whether the client began a new session.

        A small number may be of either, and is dropped. A client repeats what is not acknowledged.
        """
        reliable = client.inputs.get(message.stream)
        if message.number == 0 or (reliable is not None and abs(distance(reliable.next, message.number)) > WINDOW):
            self._begin_anew(client)
        elif message.number > WINDOW:
            client.is_reset_due = False

    def _settle_by_heartbeat(self, client: XrceClient, told: Range) -> None:
        """Decide by a HEARTBEAT: a client that has begun anew has no acknowledgement, and has sent little."""
        reliable = client.inputs.get(told.stream)
        if reliable is not None and -1 <= distance(reliable.next, told.second) <= WINDOW:
            client.is_reset_due = False  # a late CREATE_CLIENT: the session is the same
        elif not told.first:
            self._begin_anew(client)

    def _begin_anew(self, client: XrceClient) -> None:
        """Begin a new session of a client: it has its objects, and awaits nothing of the session before."""
        client.reset_streams(self._now_s)
        client.drop_calls()
        client.is_announced = False
        self.quality.restarts += 1
        self.outbox.drop_messages()
        self._is_restarted = True
        self._announce_s = self._now_s + QUIET_S

    # -- what a client requests and sends -----------------------------------------------------------------------------

    def _take_read(self, client: XrceClient, stream: int, wanted: ReadRequest, payload: bytes) -> None:
        id_ = wanted.object_id
        if id_ not in client.objects.by_id:
            self._answer(client, stream, encode_status(wanted.request, id_, Status.UNKNOWN_REFERENCE))
            return
        client.readings[id_] = Reading(wanted, self._now_s)
        client.reads.pop(id_, None)
        if wanted.samples == UNLIMITED and not wanted.seconds:
            client.reads[id_] = payload
        self.state_version += 1

    def _take_data(self, client: XrceClient, submessage: Submessage, found: list[events.Event]) -> None:
        """Take a message, a request or a response."""
        request = decode_request(submessage)
        if request is None or submessage.flags & FORMAT or not submessage.flags & LITTLE:
            self.counts.malformed += 1
            return
        written = client.objects.by_id.get(request[1])
        if written is None or written.kind not in ENDPOINTS or written.kind == ObjectKind.DATAREADER:
            self.counts.unknown_ids += 1
            if client.is_doubted(self._now_s):
                self._refute(client)
                return
            found.append(events.UnknownTopicUsed(request[1]))
            return
        if written.kind == ObjectKind.DATAWRITER:
            client.note_published(written.id, self._now_s)
        id_ = endpoint_id(client.slot, written.id)
        endpoint = self._by_key.get(id_) if self._announce_s == math.inf else None
        if endpoint is not None and written.kind == ObjectKind.DATAWRITER and client.is_confirmed and not self._refused:
            payload = self._payload(client, endpoint, submessage.payload[REQUEST_BYTES:])  # nearly always
            if not isinstance(payload, BadPayload):
                found.append(events.MessageReceived(endpoint, payload))
            return
        if endpoint is None:
            endpoint = DeviceEndpoint(ENDPOINTS[written.kind][0], id_, *client.objects.name_and_type(written))
        if client.evidence is not None and not client.is_confirmed:
            self._weigh(client, client.evidence, endpoint, submessage.payload, found)
            return
        if self._announce_s < math.inf and self._by_key.get(endpoint.key) != endpoint:
            self._announce(found)
        content = submessage.payload[REQUEST_BYTES:]
        if written.kind == ObjectKind.REQUESTER:
            self._take_request(client, endpoint, submessage.payload, found)
        elif self._by_key.get(endpoint.key) != endpoint or endpoint.key in self._refused:
            self.counts.refused_frames += 1
        elif written.kind == ObjectKind.REPLIER:
            self._take_response(client, endpoint, content, found)
        else:
            payload = self._payload(client, endpoint, content)
            if not isinstance(payload, BadPayload):
                found.append(events.MessageReceived(endpoint, payload))

    def _payload(self, client: XrceClient, endpoint: DeviceEndpoint, content: bytes) -> bytes | BadPayload:
        """Translate what a device sends. What is not of its type is counted, and the reason is returned."""
        try:
            return self._payloads.from_device(endpoint, content)
        except BadPayload as error:
            self._undecodable += 1
            id_ = object_id(endpoint)
            if id_ not in client.unfit:
                client.unfit.add(id_)
                self.state_version += 1
                if client.is_doubted(self._now_s):
                    self._refute(client)
            return error.with_traceback(None)

    def _take_request(
        self, client: XrceClient, endpoint: DeviceEndpoint, payload: bytes, found: list[events.Event]
    ) -> None:
        """Take a request of the device, also of a refused type: it waits for a response."""
        if self._by_key.get(endpoint.key) != endpoint:
            self.counts.refused_frames += 1
            return
        content = payload[REQUEST_BYTES:]
        translated = content if endpoint.key in self._refused else self._payload(client, endpoint, content)
        id_ = object_id(endpoint)
        waiting = client.calls.setdefault(id_, set())
        if isinstance(translated, BadPayload) or len(waiting) + len(client.samples.get(id_, ())) >= CALLS_MAX:
            self.counts.refused_frames += 1
            return
        self._requests += 1
        request = self._requests.to_bytes(8, "little") + payload[:REQUEST_BYTES]  # a board that restarts repeats these
        waiting.add(request)
        found.append(events.ServiceRequested(endpoint, translated, request))

    def _take_response(
        self, client: XrceClient, endpoint: DeviceEndpoint, content: bytes, found: list[events.Event]
    ) -> None:
        """Take the response to a call. Those before it are no longer answered."""
        waiting = self._calls.get(endpoint.id, deque())
        number = int.from_bytes(content[SAMPLE_IDENTITY_BYTES - 4 : SAMPLE_IDENTITY_BYTES], "little")
        if content[:SAMPLE_IDENTITY_BYTES] != _identity(number) or number not in waiting:
            self.counts.refused_frames += 1
            return
        while waiting.popleft() != number:
            self.counts.refused_frames += 1
        identity = content[:SAMPLE_IDENTITY_BYTES]
        payload = self._payload(client, endpoint, content[SAMPLE_IDENTITY_BYTES:])
        if isinstance(payload, BadPayload):
            found.append(events.ResponseRefused(endpoint, payload, identity))
        else:
            found.append(events.ServiceResponded(endpoint, payload, identity))

    def _take_acknack(self, client: XrceClient, told: Range, found: list[events.Event]) -> None:
        now_s = self._now_s
        if client.is_reset_due:
            return  # it may be of the session before
        evidence = client.evidence
        if evidence is not None and not client.output.is_known and not evidence.fits_acknack(told.first, now_s):
            self._refute(client)
            return
        again, mark = client.acknowledge(told, now_s)
        self._note_tried(client, found)
        self.quality.resent += len(again)
        for each in again:
            client.note_provoked(now_s)
            self._put(each)
        client.note_answered(mark, now_s)
        asked_at_s = self.device_clock.topics_answered(now_s)
        if asked_at_s is not None:
            found.append(events.TopicsAnswered(asked_at_s))
        self._judge(client, found)

    # -- announcing the endpoints -------------------------------------------------------------------------------------

    def _announce(self, found: list[events.Event]) -> None:
        """Report the endpoints that the clients have created so far."""
        self._announce_s = math.inf
        before, is_restarted = self._known, self._is_restarted
        self._is_restarted = False
        self._by_key.clear()
        self._by_name.clear()
        self._refused.clear()
        self._payloads.forget()
        known: list[DeviceEndpoint] = []
        overtaken = {client.slot for client in self._clients.values() if self._is_overtaken(client)}
        for endpoint in self._endpoints():
            if len(self._by_key) >= self._max_topics:
                self.counts.excess_topics += 1
                continue
            self._by_key[endpoint.key] = endpoint
            namesake = self._by_name.setdefault((endpoint.name, endpoint.kind), endpoint)
            if _slot(namesake) in overtaken and _slot(endpoint) not in overtaken:  # it is of a client that lives
                self._by_name[endpoint.name, endpoint.kind] = endpoint
            try:
                self._payloads.check(endpoint)
            except WrongType as error:
                self._refused[endpoint.key] = error
                found.append(events.TopicRefused(endpoint, error))
            else:
                known.append(endpoint)
        self._known = tuple(known)
        is_changed = self._known != before or is_restarted
        if is_changed or not self.counts.negotiations:
            self.counts.negotiations += 1
            self.state_version += 1
            found.append(events.TopicsNegotiated(self._known, is_changed, gap_at=None))

    def _endpoints(self) -> Iterable[DeviceEndpoint]:
        for client in self._clients.values():
            if client.is_confirmed and not client.is_over:
                client.is_announced = True
                for each in client.objects.current_endpoints():
                    name, type_ = client.objects.name_and_type(each)
                    for kind in ENDPOINTS[each.kind]:
                        yield DeviceEndpoint(kind, endpoint_id(client.slot, each.id), name, type_)

    # -- answers and messages to the device ---------------------------------------------------------------------------

    def _answer(self, client: XrceClient, stream: int, answer: bytes) -> None:
        """Queue the answer to a request, on a stream like that of the request."""
        if stream >= RELIABLE:
            if len(client.waiting) < WAITING_MAX:
                client.waiting.append(answer)
        elif stream == NO_STREAM:
            self._put(client.message(NO_STREAM, answer))
        else:
            self._put(client.message(BEST_EFFORT, answer))

    def _put(self, message: bytes) -> None:
        self.outbox.put_answer(ANSWERS, message, depth=WAITING_MAX)

    def _put_acks(self, now_s: float) -> None:
        """Queue one ACKNACK for each stream that needs it. It replaces one that waits."""
        for session, key, stream in self._acks:
            client = self._clients.get((session, key))
            reliable = None if client is None else client.inputs.get(stream)
            if client is not None and reliable is not None and client.may_acknowledge(reliable):
                self.quality.missing += bool(reliable.missing()) and reliable.is_judged(reliable.next)
                message = client.message(NO_STREAM, client.acknack(reliable, now_s))
                self.outbox.put_answer((session, key, stream), message, depth=1)
        self._acks.clear()

    def _release(self, now_s: float) -> None:
        """Queue what the clients' history, their requests and the pace they want permit now."""
        for client in self._clients.values():
            is_released = bool(client.waiting or client.samples)
            while is_released:
                for each in client.due_messages(now_s):
                    self._put(each)
                is_released = bool(client.samples) and not client.waiting and self._release_sample(client, now_s)

    def _release_sample(self, client: XrceClient, now_s: float) -> bool:
        """Queue one message for a reader that wants it now. Return whether there was one."""
        for id_, waiting in list(client.samples.items()):
            reading = client.readings.get(id_)
            if reading is None or (reading.due_s() > now_s and not reading.is_over(now_s)):
                continue
            if reading.is_over(now_s):
                self.quality.unread += len(waiting)
                del client.samples[id_]
                continue
            output = client.output
            if reading.stream >= RELIABLE and not client.has_room:
                continue
            data = encode_data(reading.request, id_, waiting[0])
            bodies = client.bodies(data) if reading.stream >= RELIABLE else []
            is_tried = len(bodies) > output.proven
            if is_tried and (output.is_waiting or client.waiting):
                continue
            content = waiting.popleft()
            if not waiting:
                del client.samples[id_]
            reading.note_sent(len(content), now_s)
            if is_tried:
                output.begin_trial(bodies, now_s)
                client.tried_sample = id_, content
                self._put(client.tried(now_s))
                client.plan_heartbeat(now_s)
            elif bodies:
                client.waiting += bodies
            else:
                message = client.message(reading.stream, data)
                self.outbox.put_command(endpoint_id(client.slot, id_), message, depth=WAITING_MAX)
            return True
        return False

    def _note_tried(self, client: XrceClient, found: list[events.Event]) -> None:
        """Note the end of a trial. Report a dropped message: the client's history does not hold it, or it told nothing.

        Of a known history, longer ones are refused from now on, before they are queued.
        """
        if client.tried_sample is None or client.output.trial() is not None:
            return
        id_, content = client.tried_sample
        client.tried_sample = None
        endpoint = self._by_key.get(to_device_key(endpoint_id(client.slot, id_)))
        room_bytes = client.room_bytes(id_) - REQUEST_BYTES
        if endpoint is None:
            return
        error: HostlinkError
        if client.output.is_unanswered:
            error = DeviceGone(endpoint.name, UNANSWERED)
        elif len(content) > room_bytes:
            error = self._too_large(endpoint, len(content), room_bytes)
        else:
            return
        if kind_of(id_) == ObjectKind.REPLIER:
            found.append(events.ResponseRefused(endpoint, error, content[:SAMPLE_IDENTITY_BYTES]))

    def _put_sample(self, client: XrceClient, endpoint: DeviceEndpoint, content: bytes) -> None:
        """Queue a request or a response. None replaces another."""
        waiting = client.samples.setdefault(object_id(endpoint), deque())
        if len(waiting) >= CALLS_MAX:
            raise DeviceBusy(endpoint.name, len(waiting))
        waiting.append(content)
        self._release(self._now_s)

    def _sample_due_s(self, client: XrceClient) -> float:
        """Time at which the pace that a reader wants permits the next message."""
        readings = (client.readings.get(each) for each in client.samples)
        due = (each.due_s() for each in readings if each is not None)
        return min((each for each in due if each > self._now_s), default=math.inf)

    def _send_held(self, client: XrceClient, now_s: float) -> None:
        """Queue the velocities that waited for the one in flight, if it has arrived or was lost."""
        if client.held and now_s >= client.free_s(now_s):
            for each, (message, is_kept) in client.held.items():
                self.outbox.put_urgent(each, message, is_kept=is_kept)
            client.held.clear()

    def _repeat_zeros(self, client: XrceClient, now_s: float) -> None:
        for each, zero in list(client.zeros.items()):
            if zero.is_over(now_s):
                del client.zeros[each]
            elif now_s >= zero.due_s:
                zero.note_repeated(now_s)
                self.outbox.put_urgent(each, zero.message)

    def _encode(self, message: bytes) -> bytes:
        """Return the bytes of a message that is sent now: with its number, and with what repairs losses."""
        stream, session = message[1], message[0]
        key = message[4:8] if session < KEYLESS else b""
        client = self._clients.get((session, key))
        if client is not None and stream < RELIABLE:
            start = client.header_bytes
            if message[start] == Kind.DATA:
                message = self._accompanied(client, message[:start], message[start:])
            if stream != NO_STREAM:
                message = client.stamped(message)
        return self._framing.encode(message)

    def _accompanied(self, client: XrceClient, head: bytes, data: bytes) -> bytes:
        """Return a message with an ACKNACK and a HEARTBEAT before its data, if they are due and there is room."""
        now_s = self._now_s
        room_bytes = client.mtu - len(head) - len(data)
        parts: list[bytes] = []
        if room_bytes >= EXTRA_BYTES and (repair := client.repair(now_s)):
            parts.append(repair)
            room_bytes -= EXTRA_BYTES
        zeros = [each for each in client.zeros.values() if each.message == head + data]
        if not zeros:
            client.note_velocity_sent(now_s)
        for each in zeros:
            if each.left is None:
                each.due_s = now_s + max(REPEAT_S, 1.5 * client.round_trip_s)
        is_paced = client.is_paced(now_s)
        if (
            room_bytes >= EXTRA_BYTES
            and client.output.is_known
            and not client.is_reset_due
            and (zeros or is_paced or client.is_probe_due(now_s))
        ):
            parts.append(client.heartbeat(now_s))
            for each in zeros:
                each.mark = each.mark or client.mark
            if is_paced and not zeros:
                client.note_flying(client.mark, now_s)
        return head + join_submessages(*parts, data)

    # -- going on after a restart of the host -------------------------------------------------------------------------

    @property
    def is_recalled(self) -> bool:
        """Whether it has a `memory` and `kept_bytes`: always."""
        return True

    @property
    def memory_version(self) -> int:
        """Number that changes when `memory` is worth keeping: with the objects, and while numbers pass."""
        if not self.state_version:
            return 0
        return self.state_version << 24 | sum(each.passed(self._now_s) for each in self._clients.values()) & 0xFFFFFF

    def memory(self) -> str:
        """Return the state as text; empty if there is nothing to go on with."""
        state = self.state()
        return state.to_json() if state.clients else ""

    def state(self) -> SessionState:
        """Return what a later session needs to go on. It changed when `state_version` did.

        It has also what is resumed, and waits for its board.
        """
        clients = (each for each in self._clients.values() if not each.is_over)
        kept = (each for each in clients if each.is_confirmed or each.is_resumed)
        return SessionState(tuple(each.stored() for each in kept))

    def _resume(self, state: SessionState) -> None:
        """Restore the clients of a state. Nothing is passed on and sent until a client's Evidence is enough."""
        for stored in state.clients[:CLIENTS_MAX]:
            info = stored.info
            if info.mtu < MTU_MIN or not self._add_client(info, None):
                continue
            client = self._clients[info.session, _id_key(info)]
            client.is_confirmed, client.is_resumed = False, True
            client.repair_s = math.inf
            client.output = ReliableOutput(first=stored.number, is_known=False)
            for payload in stored.objects:
                new = decode_object(Submessage(Kind.CREATE, LITTLE, bytes(2) + payload))
                if new is not None:
                    client.objects.create(new, 0)
            publishes = any(each.kind != ObjectKind.DATAREADER for each in client.objects.endpoints())
            client.evidence, client.unfit = Evidence(stored, publishes=publishes), set(stored.unfit)
            for payload in stored.reads:
                wanted = decode_read(Submessage(Kind.READ_DATA, LITTLE, payload))
                if wanted is not None:
                    client.readings[wanted.object_id] = Reading(wanted, self._now_s)
                    client.reads[wanted.object_id] = payload

    def _weigh(
        self,
        client: XrceClient,
        evidence: Evidence,
        endpoint: DeviceEndpoint,
        payload: bytes,
        found: list[events.Event],
    ) -> None:
        """Take a message of a resumed client as evidence: it is of an object that it created, and of its type."""
        id_ = object_id(endpoint)
        before_bytes = REQUEST_BYTES + (SAMPLE_IDENTITY_BYTES if kind_of(id_) == ObjectKind.REPLIER else 0)
        try:
            self._payloads.check(endpoint)
            self._payloads.from_device(endpoint, payload[before_bytes:])
        except BadPayload:
            if id_ not in client.unfit:
                self._refute(client)
            return
        except WrongType:  # it was refused before, too
            return
        evidence.note_message(self._now_s - client.created_s)
        self._judge(client, found)

    def _judge(self, client: XrceClient, found: list[events.Event]) -> None:
        """Go on with a resumed client if it has shown that it is the one of the state."""
        evidence, now_s = client.evidence, self._now_s
        if client.is_confirmed or evidence is None or not evidence.is_enough(now_s):
            return
        client.is_confirmed = True
        evidence.doubted_until_s = now_s + DOUBT_S
        self.quality.resumed += 1
        self._announce(found)

    def _refute(self, client: XrceClient) -> None:
        """Drop a resumed client: another board is at its address, or it has begun anew.

        One that was driven is sent its last zeros, and removed afterwards.
        """
        client.is_over = True
        if client.is_confirmed:
            self.quality.resumed -= 1
            self._is_restarted = True
            self._announce_s, client.leaves_s = self._now_s, self._now_s + LEAVING_S
        else:
            del self._clients[client.session, client.id_key]
        self.quality.unknown += 1
        self.quality.refuted += 1
        self.state_version += 1


# -- ids --------------------------------------------------------------------------------------------------------------

_KIND_BITS: Final = 2


def endpoint_id(slot: int, object_id: int) -> int:
    """Return the id of an endpoint: two bits for the client, twelve for the object's number, two for its kind."""
    return slot << SLOT_SHIFT | object_id >> 4 << _KIND_BITS | kind_of(object_id) - ObjectKind.DATAWRITER


def object_id(endpoint: DeviceEndpoint) -> int:
    """Return the id of an endpoint's object."""
    number = endpoint.id & (1 << SLOT_SHIFT) - 1
    return number >> _KIND_BITS << 4 | (number & (1 << _KIND_BITS) - 1) + ObjectKind.DATAWRITER


def _slot(endpoint: DeviceEndpoint) -> int:
    return endpoint.id >> SLOT_SHIFT


def _id_key(info: ClientInfo) -> bytes:
    return info.key if info.session < KEYLESS else b""


def _heard_s(client: XrceClient) -> float:
    return client.heard_s


def _is_likewise(one: XrceClient, other: XrceClient) -> bool:
    """Whether two clients have an endpoint of one kind and name, as before and after a restart of a board."""
    names = {(each.kind, each.name) for each in one.objects.endpoints()}
    return any((each.kind, each.name) in names for each in other.objects.endpoints())


def _measured_s(client: XrceClient) -> float:
    return client.round_trip_s if client.round_trips else 0.0


def _identity(number: int) -> bytes:
    """Return the identity of a call: a writer, and the call's number."""
    return b"hostlink".ljust(20, b"\0") + number.to_bytes(4, "little")


def _announce_client(client: XrceClient, endpoints: list[DeviceEndpoint]) -> list[bytes]:
    """Return the messages that create a client and these endpoints, on no stream."""
    info = client.info
    creation = 0 if info.session < KEYLESS else KEYLESS
    found = [encode_message(creation, info.key, NO_STREAM, 0, encode_client(info))]
    for each in {each.id: each for each in endpoints}.values():
        id_ = object_id(each)
        found += [
            client.message(NO_STREAM, encode_submessage(Kind.CREATE, bytes(2) + one.payload, CREATED))
            for one in client.objects.with_parents(id_)
        ]
        if id_ in client.reads:
            found.append(client.message(NO_STREAM, encode_submessage(Kind.READ_DATA, client.reads[id_])))
    return found
