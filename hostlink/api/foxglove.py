"""FoxgloveClient: one client that speaks Foxglove's WebSocket protocol. Requests come in, frames go out; no socket.

https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md
"""

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Sequence
from typing import Any, TypeVar, assert_never

import structlog

from hostlink.api.foxglove_directory import Channel, ConnectionGraph, FoxgloveDirectory, Offers, Service
from hostlink.api.foxglove_frames import ROS1, Published, ServiceCall, decode_frame
from hostlink.api.foxglove_graph import NO_GRAPH, graph_update
from hostlink.api.foxglove_parameters import FoxgloveParameters
from hostlink.api.foxglove_requests import (
    Advertise,
    GetParameters,
    JsonRequest,
    SetParameters,
    Subscribe,
    Unadvertise,
    Unsubscribe,
    UnwatchGraph,
    UnwatchParameters,
    WatchGraph,
    WatchParameters,
    decode_request,
)
from hostlink.api.foxglove_services import FoxgloveServices
from hostlink.api.foxglove_subscriptions import FoxgloveSubscriptions
from hostlink.api.foxglove_time import FoxgloveTime
from hostlink.api.foxglove_topics import FoxgloveTopics
from hostlink.api.inbox import Operation
from hostlink.api.outgoing import ClientQueue, put_json
from hostlink.api.parameters import Parameters
from hostlink.api.rate_limit import REFUSED_VELOCITIES_S, RateLimit
from hostlink.api.velocities import velocity_of_payload
from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.hub import Hub
from hostlink.hub.node import Role
from hostlink.hub.participant import MAX_CALLS

log = structlog.get_logger()

BATCH = 64  # channels or services in one message
CHANGES_INTERVAL_S = 0.05  # of the graph, at least: a client may request all of it again and again
MAX_UNDEFINED = 8  # topics without a definition that are named to a client at once
_WARNING, _ERROR = 1, 2  # levels of a status
_READING = ("services", "parameters", "parametersSubscribe", "connectionGraph", "time")
_Item = TypeVar("_Item")
_NOTHING = Offers({}, {}, ())
_Received = JsonRequest | Published | ServiceCall | BadRequest


class FoxgloveClient:
    """One participant, and the language that its program speaks."""

    def __init__(
        self,
        name: str,
        hub: Hub,
        directory: FoxgloveDirectory,
        queue: ClientQueue,
        *,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
        role: Role = Role.DRIVE,
    ) -> None:
        """`spawn` runs a service call as a child of the client's connection."""
        self.participant = hub.join(name, role=role, on_end=queue.close)
        self._hub, self._directory, self._queue = hub, directory, queue
        self._time = FoxgloveTime(self.participant, hub.topics, queue)
        self._subscriptions = FoxgloveSubscriptions(self.participant, queue, self._time)
        self._topics = FoxgloveTopics(self.participant)
        self._services = FoxgloveServices(self.participant, queue, spawn, hub.budget["calls"])
        self._parameters = FoxgloveParameters(Parameters(hub.parameters), queue, hub.budget["watches"])
        self._offers = _NOTHING
        self._graph: ConnectionGraph | None = None  # that was sent last; None: it is not watched
        self._is_stale = False
        self._changes_due_s = 0.0
        self._refused: dict[int, str] = {}  # why a channel's message was, until one is accepted again or it is gone
        self._refused_velocities = RateLimit(REFUSED_VELOCITIES_S)
        self._begin()

    def _begin(self) -> None:
        capabilities = [*(["clientPublish"] if self.participant.role >= Role.DRIVE else []), *_READING]
        info = {"op": "serverInfo", "name": "hostlink", "capabilities": capabilities, "supportedEncodings": [ROS1]}
        put_json(self._queue, info | {"metadata": {}, "sessionId": self._directory.session_id})
        put_json(self._queue, {"op": "advertise", "channels": []})
        self._send_offers()
        self.participant.watch_graph(self._note_change)

    def receive(self, data: str | bytes) -> None:
        """Do what one message of the client's requests; what is wrong with it becomes a status, and is never raised."""
        self.do(self.read(data, _now_s()))

    def read(self, data: str | bytes, came_s: float) -> Operation[_Received]:
        """Decode a message; `do` tells the client what is wrong with it."""
        try:
            content = decode_request(data) if isinstance(data, str) else decode_frame(data)
        except BadRequest as error:
            return Operation(error, came_s)
        if not isinstance(content, Published) or (topic := self._topics.find(content.channel_id)) is None:
            return Operation(content, came_s)
        velocity_of, is_zero = velocity_of_payload(topic, content.payload, self._hub.topics)
        return Operation(content, came_s, velocity_of, is_zero)

    def do(self, operation: Operation[_Received]) -> None:
        """Do what a message requests; what is wrong with it becomes a status, and is never raised."""
        try:
            match operation.content:
                case BadRequest() as error:
                    raise error
                case Published() as published:
                    self._publish(published, operation.came_s)
                case ServiceCall() as call:
                    self._services.call(call, self._offers.services.get(call.service_id))
                case request:
                    self._do(request)
        except HostlinkError as error:
            self._put_status(_ERROR, str(error))

    def flush(self, now_s: float) -> float | None:
        """Send what has changed; returns when there may be more to send."""
        due_s = [self.participant.flush(now_s), self._parameters.flush(now_s), self._time.flush(now_s)]
        if self._is_stale:
            self._time.follow_graph()
            due_s.append(self._send_changes(now_s))
        return min((at_s for at_s in due_s if at_s is not None), default=None)

    @property
    def is_crowded(self) -> bool:
        """Whether many calls are under way."""
        return self._services.calls > MAX_CALLS // 2

    def close(self) -> None:
        """The client has left: all that it has goes with it."""
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
                self._each(request.channels, self._topics.advertise)
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
        """Act on each; those that are refused have one status together."""
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

    def _publish(self, published: Published, came_s: float) -> None:
        """A refusal is shown until a message is accepted again; that of a velocity at a limited rate."""
        topic = self._topics.topic(published.channel_id)
        try:
            self._topics.publish(published, came_s)
        except HostlinkError as error:
            is_new = self._refused.get(published.channel_id) != str(error)
            if is_new and (not self._is_velocity(topic) or self._refused_velocities.allows(topic, _now_s())):
                self._refused[published.channel_id] = str(error)
                self._put_status(_ERROR, str(error), topic)
        else:
            self._remove_status(published.channel_id, topic)

    def _is_velocity(self, topic: str) -> bool:
        known = self._hub.topics.find_or_none(topic)
        return known is not None and known.is_gated

    def _unadvertise(self, channel_id: int) -> None:
        if channel_id in self._refused:
            self._remove_status(channel_id, self._topics.topic(channel_id))
        self._topics.unadvertise(channel_id)

    def _remove_status(self, channel_id: int, topic: str) -> None:
        if self._refused.pop(channel_id, None) is not None:
            put_json(self._queue, {"op": "removeStatus", "statusIds": [topic]})

    # -- changes ------------------------------------------------------------------------------------------------------

    def _note_change(self) -> None:
        self._is_stale = True
        self._queue.wake()

    def _send_changes(self, now_s: float) -> float | None:
        """Send the newest state, unless the client has yet to read; returns when to try again."""
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
        self._advertise(
            "advertise", "channels", [each for each in now.channels.values() if each.id not in before.channels]
        )
        gone = sorted(before.services.keys() - now.services.keys())
        if gone:
            put_json(self._queue, {"op": "unadvertiseServices", "serviceIds": gone})
        new = [each for each in now.services.values() if each.id not in before.services]
        self._advertise("advertiseServices", "services", new)
        for topic, type_name in sorted(set(now.undefined) - set(before.undefined))[:MAX_UNDEFINED]:
            text = f"{topic}: {type_name} has no definition; put its .msg into a folder named in message_folders"
            self._put_status(_WARNING, text, topic)

    def _advertise(self, op: str, key: str, offers: Sequence[Channel | Service]) -> None:
        for start in range(0, len(offers), BATCH):
            put_json(self._queue, {"op": op, key: [offer.json for offer in offers[start : start + BATCH]]})

    def _put_status(self, level: int, text: str, status_id: str | None = None) -> None:
        """A status with an id replaces the one before of this id."""
        log.debug("client.refused", client=self.participant.name, reason=text)
        status = {"op": "status", "level": level, "message": text}
        put_json(self._queue, status | ({} if status_id is None else {"id": status_id}))


def _now_s() -> float:
    return asyncio.get_running_loop().time()
