"""FoxgloveClient: one client that speaks Foxglove's WebSocket protocol. Answers requests without a socket.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import contextlib
import itertools
import math
import os
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar, assert_never

import msgspec
import structlog

from hostlink.components.gateway.bodies import size_bytes_of
from hostlink.components.gateway.clients import (
    ClientQueue,
    Operation,
    Outgoing,
    Spawn,
    dropped_text,
    put_json,
    velocity_of_payload,
)
from hostlink.components.gateway.foxglove_protocol import (
    MAX_ITEMS,
    ROS1,
    ROS1_SCHEMA,
    Advertise,
    ClientChannel,
    GetParameters,
    JsonRequest,
    ParameterSetting,
    Published,
    ServiceCall,
    SetParameters,
    Subscribe,
    Unadvertise,
    Unsubscribe,
    UnwatchGraph,
    UnwatchParameters,
    WantedChannel,
    WatchGraph,
    WatchParameters,
    decode_frame,
    decode_request,
    encode_message,
    encode_response,
    encode_time,
)
from hostlink.components.gateway.rosapi import Parameters
from hostlink.core.config import ParameterValue
from hostlink.core.host import (
    MAX_ADVERTISED,
    MAX_CALLS,
    GraphTopic,
    Host,
    Message,
    NodeGraph,
    Participant,
    Role,
    Share,
    Subscription,
    resolve,
)
from hostlink.core.messages.catalog import CLOCK, CLOCK_TYPE, decode_clock
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.core.messages.ros2_names import ros2_type
from hostlink.core.messages.serialisation import CDR
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.runtime.rate_limit import REFUSED_VELOCITIES_S, RateLimit
from hostlink.errors import BadPayload, BadRequest, HostlinkError, without_frames

Names = Mapping[str, tuple[str, ...]]

INTERVAL_S = 0.1  # between two times while no message is sent
STEP_S = 0.005  # between two times before messages: the app takes the newest time as a message's time of arrival
SLIGHT_NS = 1_000_000_000  # smaller steps back are not sent: the app takes them for a seek and drops messages

CHECK_INTERVAL_S = 0.5  # between comparisons of watched parameters

BATCH = 64  # channels or services in one message
CHANGES_INTERVAL_S = 0.05  # between two updates of the graph: a client may request all of it repeatedly
MAX_UNDEFINED = 8  # topics without a definition that are reported to a client at once


class FoxgloveChannel(NamedTuple):
    """A topic as it is advertised. A `type` of None has no definition here; its messages have another encoding."""

    id: int
    topic: str
    type_name: str
    type: MessageType | None
    encoding: str
    json: msgspec.Raw


class FoxgloveService(NamedTuple):
    """A service as it is advertised."""

    id: int
    name: str
    type: ServiceType
    json: msgspec.Raw


@dataclass(frozen=True, slots=True)
class Offers:
    """All channels and services by id. An id is never reused."""

    channels: Mapping[int, FoxgloveChannel]
    services: Mapping[int, FoxgloveService]
    undefined: tuple[tuple[str, str], ...]  # topics that no client can decode, and their types


@dataclass(frozen=True, slots=True)
class ConnectionGraph:
    """Nodes of the graph by what they publish, subscribe to and provide."""

    publishers: Names
    subscribers: Names
    providers: Names


class FoxgloveDirectory:
    """Channels, services and nodes of the graph, for all clients."""

    def __init__(self, host: Host) -> None:
        self.session_id = os.urandom(8).hex()  # tells a client that reconnects whether the daemon was restarted
        self._graph = host.graph
        self._participant = host.join_as_observer()
        self._numbers = itertools.count(1)
        self._channels: dict[Hashable, FoxgloveChannel] = {}
        self._services: dict[Hashable, FoxgloveService] = {}
        self._offers: Offers | None = None
        self._nodes: ConnectionGraph | None = None
        self._participant.watch_graph(self._forget)

    def offers(self) -> Offers:
        """Return the present channels and services: the same object until they may have changed."""
        if self._offers is None:
            self._offers = self._make_offers()
        return self._offers

    def connection_graph(self) -> ConnectionGraph:
        """Return the present nodes."""
        if self._nodes is None:
            self._nodes = self._make_nodes()
        return self._nodes

    def _forget(self) -> None:
        self._offers = self._nodes = None

    def _make_offers(self) -> Offers:
        graph = self._participant.graph()
        topics = [topic for topic in graph.topics if topic.type_name and (topic.is_published or topic.is_velocity)]
        channels: dict[Hashable, GraphTopic] = {
            (topic.name, topic.type_name if topic.type is None else topic.type.md5, topic.encoding): topic
            for topic in topics
            if topic.type is not None or topic.encoding == CDR
        }
        typed = ((each.name, self._graph.service_type(each.name)) for each in graph.services)
        services: dict[Hashable, tuple[str, ServiceType]] = {
            (name, type_.name, type_.md5): (name, type_) for name, type_ in typed if type_ is not None
        }
        self._channels = {
            key: self._channels.get(key) or _channel(next(self._numbers), topic) for key, topic in channels.items()
        }
        self._services = {
            key: self._services.get(key) or _service(next(self._numbers), *offer) for key, offer in services.items()
        }
        return Offers(
            {channel.id: channel for channel in self._channels.values()},
            {service.id: service for service in self._services.values()},
            tuple((topic.name, topic.type_name) for topic in topics if topic.type is None),
        )

    def _make_nodes(self) -> ConnectionGraph:
        return ConnectionGraph(*map(_sorted, self._graph.by_node()))


def _channel(number: int, topic: GraphTopic) -> FoxgloveChannel:
    advertised = {"id": number, "topic": topic.name, "encoding": topic.encoding}
    if topic.type is None:  # its messages are CDR; the client may know the schema by its name
        advertised |= {"schemaName": ros2_type(topic.type_name), "schema": ""}
    else:
        advertised |= {
            "schemaName": topic.type.name,
            "schema": topic.type.full_definition,
            "schemaEncoding": ROS1_SCHEMA,
        }
    json = msgspec.Raw(msgspec.json.encode(advertised))
    return FoxgloveChannel(number, topic.name, topic.type_name, topic.type, topic.encoding, json)


def _service(number: int, name: str, type_: ServiceType) -> FoxgloveService:
    advertised = {
        "id": number,
        "name": name,
        "type": type_.name,
        "request": _schema(f"{type_.name}_Request", type_.request),
        "response": _schema(f"{type_.name}_Response", type_.response),
        "requestSchema": type_.request.full_definition,  # for older clients
        "responseSchema": type_.response.full_definition,
    }
    return FoxgloveService(number, name, type_, msgspec.Raw(msgspec.json.encode(advertised)))


def _schema(name: str, type_: MessageType) -> dict[str, str]:
    return {"encoding": ROS1, "schemaName": name, "schemaEncoding": ROS1_SCHEMA, "schema": type_.full_definition}


def _sorted(nodes: Mapping[str, set[str]]) -> dict[str, tuple[str, ...]]:
    return {name: tuple(sorted(found)) for name, found in nodes.items() if found}


NO_GRAPH = ConnectionGraph({}, {}, {})


def graph_update(before: ConnectionGraph, now: ConnectionGraph) -> dict[str, Any] | None:
    """Return the JSON of the changes; None without changes."""
    topics_before = before.publishers.keys() | before.subscribers.keys()
    removed = topics_before - now.publishers.keys() - now.subscribers.keys()
    update = {
        "publishedTopics": _changes(before.publishers, now.publishers, removed, "publisherIds"),
        "subscribedTopics": _changes(before.subscribers, now.subscribers, removed, "subscriberIds"),
        "advertisedServices": _changes(before.providers, now.providers, set(before.providers), "providerIds"),
        "removedTopics": sorted(removed),
        "removedServices": sorted(before.providers.keys() - now.providers.keys()),
    }
    return {"op": "connectionGraphUpdate", **update} if any(update.values()) else None


def _changes(before: Names, now: Names, removed: set[str], ids: str) -> list[dict[str, Any]]:
    """Return names with changed nodes. A name that lost all nodes but still exists has an empty list."""
    changed = [{"name": name, ids: nodes} for name, nodes in now.items() if before.get(name) != nodes]
    return changed + [{"name": name, ids: []} for name in before if name not in now and name not in removed]


_QUEUED_AS = ""  # not a topic's name


class FoxgloveTime:
    """Time of the server, sent with messages as the protocol requires. /clock replaces it while it is published."""

    def __init__(self, participant: Participant, graph: NodeGraph, queue: ClientQueue) -> None:
        self._participant, self._graph, self._queue = participant, graph, queue
        self._clock: Subscription | None = None
        self._simulated_ns: int | None = None  # None: no message on /clock yet
        self._sent_ns = 0
        self._sent_s = 0.0
        self._due_s = 0.0

    def follow_graph(self) -> None:
        """Subscribe to /clock while it is published."""
        topic = self._graph.topic(CLOCK)
        is_published = topic is not None and topic.is_published and topic.type_name == CLOCK_TYPE
        if is_published and self._clock is None:
            with contextlib.suppress(BadRequest):  # at the limit of subscriptions, the daemon's time is used
                self._clock = self._participant.subscribe(CLOCK, self._receive, type_name=CLOCK_TYPE)
        elif not is_published and self._clock is not None:
            self._clock.close()
            self._clock = self._simulated_ns = None

    def outgoing(self, message: Message, subscription_id: int) -> Outgoing:
        """Encode a message. The time is sent before it if the client's newest time is older."""
        stamp_ns = message.stamp_ns if self._simulated_ns is None else self._simulated_ns
        before = self._next(stamp_ns, message.at_s) if self._is_due(stamp_ns, message.at_s) else b""
        return Outgoing(encode_message(subscription_id, stamp_ns, message.payload), is_binary=True, before=before)

    def flush(self, now_s: float) -> float:
        """Send the time if it is due and no message waits. Return when the next one is due."""
        if now_s >= self._due_s:
            self._put(time.time_ns() if self._simulated_ns is None else self._simulated_ns, now_s)
            self._due_s = now_s + INTERVAL_S
        return self._due_s

    def _receive(self, message: Message) -> None:
        now_ns = decode_clock(message.payload)
        if now_ns is not None:
            self._simulated_ns = now_ns
            if self._is_due(now_ns, message.at_s):
                self._put(now_ns, message.at_s)

    def _is_due(self, stamp_ns: int, at_s: float) -> bool:
        return at_s >= self._sent_s + STEP_S or abs(stamp_ns - self._sent_ns) >= SLIGHT_NS

    def _put(self, stamp_ns: int, now_s: float) -> None:
        if self._queue.waiting_messages == 0 or not self._sent_ns:
            frame = self._next(stamp_ns, now_s)
            if frame:
                self._queue.put_message(_QUEUED_AS, Outgoing(frame, is_binary=True))

    def _next(self, stamp_ns: int, now_s: float) -> bytes:
        """Return the time as a frame; empty if it is not sent."""
        if stamp_ns == self._sent_ns or 0 < self._sent_ns - stamp_ns < SLIGHT_NS:
            return b""
        self._sent_ns, self._sent_s = stamp_ns, now_s
        self._due_s = now_s + INTERVAL_S
        return encode_time(stamp_ns)


class FoxgloveSubscriptions:
    """Subscriptions by the ids that the client chose, one for each channel. Payloads are sent unchanged."""

    def __init__(self, participant: Participant, queue: ClientQueue, time: FoxgloveTime) -> None:
        self._participant, self._queue, self._time = participant, queue, time
        self._subscriptions: dict[int, tuple[FoxgloveChannel, Subscription]] = {}
        self._of_channel: dict[int, int] = {}  # subscription id by channel id

    def subscribe(self, wanted: WantedChannel, channel: FoxgloveChannel | None) -> None:
        """Send the messages of a channel from now on, the latched one first.

        Raises:
            BadRequest: the channel is unknown, it or the id is in use, or there are too many subscriptions.
            WrongType: the topic has a different type now.
        """
        if channel is None:
            raise BadRequest(f"subscribe: there is no channel {wanted.channel_id}")
        if wanted.id in self._subscriptions:
            raise BadRequest(f"subscribe: the id {wanted.id} is in use")
        if channel.id in self._of_channel:
            raise BadRequest(f"subscribe: {channel.topic} is subscribed already")

        def receive(message: Message) -> None:
            is_same = message.type is channel.type and message.type_name == channel.type_name
            if is_same and message.encoding == channel.encoding:
                self._queue.put_message(channel.topic, self._time.outgoing(message, wanted.id), message.at_s)

        subscription = self._participant.subscribe(channel.topic, receive, type_name=channel.type_name)
        self._subscriptions[wanted.id] = (channel, subscription)
        self._of_channel[channel.id] = wanted.id

    def unsubscribe(self, number: int) -> None:
        """End a subscription. An unknown id is ignored."""
        if number in self._subscriptions:
            channel, subscription = self._subscriptions.pop(number)
            del self._of_channel[channel.id]
            self._queue.forget(channel.topic)
            subscription.close()

    def remove_channels(self, channel_ids: Iterable[int]) -> None:
        """End the subscriptions of removed channels."""
        for number in [self._of_channel[each] for each in channel_ids if each in self._of_channel]:
            self.unsubscribe(number)


class FoxgloveServices:
    """Service calls of one client, serialised as in ROS 1. A failed call is answered with its reason."""

    def __init__(self, participant: Participant, queue: ClientQueue, spawn: Spawn, share: Share) -> None:
        """Create the calls of one client. `share`: budget of all clients' calls."""
        self.calls = 0
        self._share = share
        self._participant, self._queue, self._spawn = participant, queue, spawn

    def call(self, call: ServiceCall, service: FoxgloveService | None) -> None:
        """Call a service and send its response."""
        if self.calls >= MAX_CALLS:
            self._fail(call, f"more than {MAX_CALLS} calls are pending")
        elif service is None:
            self._fail(call, f"there is no service {call.service_id}")
        elif call.encoding != ROS1:
            self._fail(call, f"{service.name}: a request must have the encoding {ROS1}, not {call.encoding[:64]!r}")
        else:
            self.calls += 1
            self._spawn(self._finish(call, service))

    async def _finish(self, call: ServiceCall, service: FoxgloveService) -> None:
        try:
            with self._share.holding(len(call.payload), "pending calls"):
                response = await self._participant.call(service.name, _decode(call, service))
            payload = service.type.response.encode(response)
            self._queue.put_result(Outgoing(encode_response(call._replace(payload=payload)), is_binary=True))
        except HostlinkError as error:
            self._fail(call, str(error))
        finally:
            self.calls -= 1

    def _fail(self, call: ServiceCall, reason: str) -> None:
        failure = {"op": "serviceCallFailure", "serviceId": call.service_id, "callId": call.call_id}
        put_json(self._queue, failure | {"message": reason})


def _decode(call: ServiceCall, service: FoxgloveService) -> dict[str, object]:
    """Decode the fields of a request.

    Raises:
        BadRequest: the payload is not exactly one request.
    """
    try:
        return service.type.request.decode(call.payload)
    except HostlinkError as error:
        raise BadRequest(f"{service.name}: {error}") from None


class FoxgloveParameters:
    """Parameters that a client reads, sets and watches, by full names. Floats carry a type: JSON keeps none."""

    def __init__(self, parameters: Parameters, queue: ClientQueue, share: Share) -> None:
        """Create the view of one client. `share`: budget of the names that all clients watch."""
        self._parameters, self._queue, self._share = parameters, queue, share
        self._watched: dict[str, ParameterValue | None] = {}  # values sent last; None: the parameter does not exist
        self._due_s = 0.0

    def send(self, names: list[str], request_id: str | None) -> None:
        """Send the existing parameters of these names; without names all."""
        values = self._parameters.values()
        known = {name: values[name] for name in map(resolve, names) if name in values} if names else values
        self._put(known, request_id)

    def set(self, setting: ParameterSetting) -> None:
        """Set a parameter, or remove it.

        Raises:
            BadRequest, WrongType: a device could not be answered with the value.
            UnknownTopic: the parameter to be removed does not exist.
        """
        if setting.value is msgspec.UNSET:
            self._parameters.delete(setting.name)
        else:
            self._parameters.put(setting.name, msgspec.json.encode(_value(setting)).decode())

    def watch(self, names: list[str]) -> None:
        """Send parameters whenever they change; without names all present ones.

        Raises:
            BadRequest: they are too many.
        """
        values = self._parameters.values()
        wanted = list(map(resolve, names)) or list(values)
        if len(self._watched.keys() | set(wanted)) > MAX_ITEMS:
            raise BadRequest(f"more than {MAX_ITEMS} parameters watched")
        more_bytes = sum(map(size_bytes_of, set(wanted) - self._watched.keys()))
        if not self._share.take(more_bytes):
            raise BadRequest(f"the names that all clients watch have more than {self._share.max_bytes} bytes")
        self._watched = {name: values.get(name) for name in wanted} | self._watched

    def unwatch(self, names: list[str]) -> None:
        """Stop sending changes of parameters; without names of all."""
        for name in map(resolve, names or list(self._watched)):
            if name in self._watched:
                del self._watched[name]
                self._share.give(size_bytes_of(name))

    def flush(self, now_s: float) -> float | None:
        """Send changed parameters. Return when to compare again."""
        if not self._watched:
            return None
        if now_s >= self._due_s:
            self._due_s = now_s + CHECK_INTERVAL_S
            self._send_changes()
        return self._due_s

    def _send_changes(self) -> None:
        values = self._parameters.values()
        changed = {name: values.get(name) for name, before in self._watched.items() if values.get(name) != before}
        if changed:
            self._watched |= changed
            self._put(changed, None)

    def _put(self, values: Mapping[str, ParameterValue | None], request_id: str | None) -> None:
        answer = {"op": "parameterValues", "parameters": [_view(*each) for each in values.items()]}
        put_json(self._queue, answer | ({} if request_id is None else {"id": request_id}))


def _view(name: str, value: ParameterValue | None) -> dict[str, Any]:
    view: dict[str, Any] = {"name": name}
    if value is not None:
        view["value"] = value
    if isinstance(value, float):
        view["type"] = "float64"
    elif isinstance(value, list) and any(isinstance(item, float) for item in value):
        view["type"] = "float64_array"
    return view


def _value(setting: ParameterSetting) -> object:
    """Return the value as its type has it.

    Raises:
        BadRequest: the type is unknown, or the value does not fit it.
    """
    if setting.type is None:
        return setting.value
    if setting.type not in ("float64", "float64_array"):
        raise BadRequest(f"parameter {setting.name}: unknown type {setting.type!r}; use float64, float64_array or none")
    is_array = setting.type == "float64_array"
    try:
        floats = msgspec.convert(setting.value if is_array else [setting.value], list[float])
    except (msgspec.ValidationError, OverflowError) as error:
        raise BadRequest(f"parameter {setting.name}: {error}") from None
    if not all(map(math.isfinite, floats)):
        raise BadRequest(f"parameter {setting.name}: the value must be finite")
    return floats if is_array else floats[0]


log = structlog.get_logger()

_WARNING, _ERROR = 1, 2  # levels of a status
_READING = ("services", "parameters", "parametersSubscribe", "connectionGraph", "time")
_Item = TypeVar("_Item")
_NOTHING = Offers({}, {}, ())
_Received = JsonRequest | Published | ServiceCall | BadRequest


class _Advertised(NamedTuple):
    """A channel that the client advertises."""

    topic: str
    type_name: str


class FoxgloveClient:
    """One participant and its Foxglove requests."""

    def __init__(
        self,
        name: str,
        host: Host,
        directory: FoxgloveDirectory,
        queue: ClientQueue,
        *,
        spawn: Spawn,
        role: Role = Role.DRIVE,
    ) -> None:
        """Join the graph. `spawn` runs a service call."""
        self.participant = host.join(name, role=role, on_end=queue.close)
        self._node_graph, self._directory, self._queue = host.graph, directory, queue
        self._queue.on_dropped, self._dropped = self._tell_dropped, Budget()
        self._time = FoxgloveTime(self.participant, host.graph, queue)
        self._subscriptions = FoxgloveSubscriptions(self.participant, queue, self._time)
        self._advertised: dict[int, _Advertised] = {}  # by the client's ids, of which several may have one topic
        self._services = FoxgloveServices(self.participant, queue, spawn, host.share("calls"))
        self._parameters = FoxgloveParameters(Parameters(host.parameters), queue, host.share("watches"))
        self._offers = _NOTHING
        self._graph: ConnectionGraph | None = None  # sent last; None: not watched
        self._is_stale = False
        self._changes_due_s = 0.0
        self._refused: dict[int, str] = {}  # reason of the last refusal, by channel id
        self._refused_velocities = RateLimit(REFUSED_VELOCITIES_S)
        capabilities = [*(["clientPublish"] if self.participant.role >= Role.DRIVE else []), *_READING]
        info = {"op": "serverInfo", "name": "hostlink", "capabilities": capabilities, "supportedEncodings": [ROS1]}
        put_json(self._queue, info | {"metadata": {}, "sessionId": self._directory.session_id})
        put_json(self._queue, {"op": "advertise", "channels": []})
        self._send_offers()
        self.participant.watch_graph(self._note_change)

    def receive(self, data: str | bytes) -> None:
        """Execute one message of the client. An error becomes a status and is never raised."""
        self.do(self.read(data, loop_time_s()))

    def take(self, data: bytes, came_s: float) -> bool:  # noqa: ARG002 - its velocities are binary messages
        """Return False: no text message of the protocol is a velocity."""
        return False

    def read(self, data: str | bytes, came_s: float) -> Operation[_Received]:
        """Decode a message. An error is returned as the content, and sent to the client by `do`."""
        try:
            content = decode_request(data) if isinstance(data, str) else decode_frame(data)
        except BadRequest as error:
            return Operation(without_frames(error), came_s)
        if not isinstance(content, Published) or (channel := self._advertised.get(content.channel_id)) is None:
            return Operation(content, came_s)
        velocity_of, is_zero = velocity_of_payload(self._node_graph.velocity_topic(channel.topic), content.payload)
        return Operation(content, came_s, velocity_of, is_zero)

    def do(self, operation: Operation[_Received]) -> None:
        """Execute a decoded message. An error becomes a status and is never raised."""
        try:
            match operation.content:
                case BadRequest() as refused:  # raising it again would form a reference cycle
                    self._put_status(_ERROR, str(refused))
                case Published() as published:
                    self._publish(published, operation.came_s)
                case ServiceCall() as call:
                    self._services.call(call, self._offers.services.get(call.service_id))
                case request:
                    self._do(request)
        except HostlinkError as error:
            self._put_status(_ERROR, str(error))

    def flush(self, now_s: float) -> float | None:
        """Send what has changed. Return when more may be due."""
        due_s = [self.participant.flush(now_s), self._parameters.flush(now_s), self._time.flush(now_s)]
        if self._is_stale:
            self._time.follow_graph()
            due_s.append(self._send_changes(now_s))
        return min((at_s for at_s in due_s if at_s is not None), default=None)

    @property
    def calls(self) -> int:
        """Number of pending service calls."""
        return self._services.calls

    def close(self) -> None:
        """End the participant and release everything that it has."""
        self.participant.leave()
        self._parameters.unwatch([])

    # -- requests -----------------------------------------------------------------------------------------------------

    def _do(self, request: JsonRequest) -> None:
        match request:
            case Subscribe():
                channels = self._offers.channels
                self._each(
                    request.subscriptions,
                    lambda wanted: self._subscriptions.subscribe(wanted, channels.get(wanted.channel_id)),
                )
            case Unsubscribe():
                self._each(request.subscription_ids, self._subscriptions.unsubscribe)
            case Advertise():
                self._each(request.channels, self._advertise)
            case Unadvertise():
                self._each(request.channel_ids, self._unadvertise)
            case GetParameters():
                self._parameters.send(request.names, request.id)
            case SetParameters():
                self._set_parameters(request)
            case WatchParameters():
                self._parameters.watch(request.names)
                self._queue.wake()
            case UnwatchParameters():
                self._parameters.unwatch(request.names)
            case WatchGraph():
                self._graph = NO_GRAPH
                self._note_change()
            case UnwatchGraph():
                self._graph = None
            case _:
                assert_never(request)

    def _each(self, items: Iterable[_Item], act: Callable[[_Item], None]) -> None:
        """Apply a function to each item. All refusals are reported in one status."""
        refused = []
        for item in items:
            try:
                act(item)
            except HostlinkError as error:
                refused.append(str(error))
        if refused:
            more = f" (and {len(refused) - 1} more)" if len(refused) > 1 else ""
            raise BadRequest(refused[0] + more)

    def _set_parameters(self, request: SetParameters) -> None:
        self.participant.check(Role.DRIVE, "setParameters")
        try:
            self._each(request.parameters, self._parameters.set)
        finally:
            self._parameters.send([each.name for each in request.parameters], request.id)

    def _advertise(self, channel: ClientChannel) -> None:
        """Advertise a channel of the client.

        Raises:
            BadRequest: the id is in use, the encoding or type is unknown, or there are too many channels.
            WrongType: the topic is in use with another type.
        """
        if channel.id in self._advertised:
            raise BadRequest(f"advertise: the id {channel.id} is in use")
        if channel.encoding != ROS1:
            raise BadRequest(f"advertise: {channel.topic} must have the encoding {ROS1}, not {channel.encoding!r}")
        if len(self._advertised) >= MAX_ADVERTISED:
            raise BadRequest(f"more than {MAX_ADVERTISED} channels advertised")
        self.participant.advertise(channel.topic, channel.schema_name)
        self._advertised[channel.id] = _Advertised(resolve(channel.topic), channel.schema_name)

    def _unadvertise(self, channel_id: int) -> None:
        """Withdraw a channel, and its topic with the last channel of the topic. An unknown one is ignored."""
        gone = self._advertised.pop(channel_id, None)
        if gone is not None:
            self._remove_status(channel_id, gone.topic)
            if all(other.topic != gone.topic for other in self._advertised.values()):
                self.participant.unadvertise(gone.topic)

    def _publish(self, published: Published, came_s: float) -> None:
        """Publish a payload, which must be exactly one message. A velocity drives the robot.

        A refusal is shown until a message is accepted again; those of velocities at a limited rate.
        """
        number = published.channel_id
        if number not in self._advertised:
            raise BadRequest(f"publish: the channel {number} is not advertised")
        topic, type_name = self._advertised[number]
        try:
            _check(self.participant.message_type(topic, type_name), published.payload)
            self.participant.publish(topic, published.payload, at_s=came_s)
        except HostlinkError as error:
            is_velocity = self._node_graph.velocity_topic(topic) is not None
            is_new = self._refused.get(number) != str(error)
            if is_new and (not is_velocity or self._refused_velocities.allows((topic, error.kind), loop_time_s())):
                self._refused[number] = str(error)
                self._put_status(_ERROR, str(error), topic)
        else:
            self._remove_status(number, topic)

    def _remove_status(self, channel_id: int, topic: str) -> None:
        if self._refused.pop(channel_id, None) is not None:
            put_json(self._queue, {"op": "removeStatus", "statusIds": [topic]})

    # -- changes ------------------------------------------------------------------------------------------------------

    def _note_change(self) -> None:
        self._is_stale = True
        self._queue.wake()

    def _send_changes(self, now_s: float) -> float | None:
        """Send the newest state if the queue has room. Return when to try again."""
        if not self._queue.has_room:
            return now_s + CHANGES_INTERVAL_S
        if now_s < self._changes_due_s:
            return self._changes_due_s
        self._is_stale, self._changes_due_s = False, now_s + CHANGES_INTERVAL_S
        self._send_offers()
        if self._graph is not None:
            before, self._graph = self._graph, self._directory.connection_graph()
            update = graph_update(before, self._graph)
            if update is not None:
                put_json(self._queue, update)
        return None

    def _send_offers(self) -> None:
        before, now = self._offers, self._directory.offers()
        if now is before:
            return
        self._offers = now
        gone = sorted(before.channels.keys() - now.channels.keys())
        self._subscriptions.remove_channels(gone)
        if gone:
            put_json(self._queue, {"op": "unadvertise", "channelIds": gone})
        self._put_offers(
            "advertise", "channels", [each for each in now.channels.values() if each.id not in before.channels]
        )
        gone = sorted(before.services.keys() - now.services.keys())
        if gone:
            put_json(self._queue, {"op": "unadvertiseServices", "serviceIds": gone})
        new = [each for each in now.services.values() if each.id not in before.services]
        self._put_offers("advertiseServices", "services", new)
        for topic, type_name in sorted(set(now.undefined) - set(before.undefined))[:MAX_UNDEFINED]:
            text = f"{topic}: {type_name} has no definition; put its .msg into a folder named in message_folders"
            self._put_status(_WARNING, text, topic)

    def _put_offers(self, op: str, key: str, offers: Sequence[FoxgloveChannel | FoxgloveService]) -> None:
        for start in range(0, len(offers), BATCH):
            put_json(self._queue, {"op": op, key: [offer.json for offer in offers[start : start + BATCH]]})

    def _tell_dropped(self, topic: str) -> None:
        """Tell the client at once, and then every ten seconds, what it has lost because it reads too slowly."""
        if counts := self._dropped.due("dropped", loop_time_s(), topic):
            self._put_status(_WARNING, dropped_text(counts), "hostlink: dropped")

    def _put_status(self, level: int, text: str, status_id: str | None = None) -> None:
        """Send a status. It replaces the previous one of the same id."""
        log.debug("client.refused", client=self.participant.name, reason=text)
        status = {"op": "status", "level": level, "message": text}
        put_json(self._queue, status | ({} if status_id is None else {"id": status_id}))


def _check(type_: MessageType, payload: bytes) -> None:
    """Check that a payload is one message of the type: a device would read beyond its end.

    Raises:
        BadPayload: it is not.
    """
    if type_.fixed_bytes is None:
        type_.decode(payload)
    elif len(payload) != type_.fixed_bytes:
        raise BadPayload(type_.name, f"{len(payload)} bytes instead of {type_.fixed_bytes}")
