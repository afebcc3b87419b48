"""RosbridgeClient: one client that speaks rosbridge v2. JSON comes in, JSON and calls of the hub go out; no socket."""

import asyncio
import base64
import time
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import structlog

from hostlink.api.client_graph import ClientGraph
from hostlink.api.client_services import ClientServices
from hostlink.api.client_subscriptions import ClientSubscriptions
from hostlink.api.client_topics import ClientTopics
from hostlink.api.drive import Drive
from hostlink.api.fragments import MAX_PIECES, Fragments
from hostlink.api.inbox import Operation
from hostlink.api.outgoing import ClientQueue, put_json
from hostlink.api.rate_limit import REFUSED_VELOCITIES_S, RateLimit
from hostlink.api.request import Request
from hostlink.api.stamps import fill_stamps
from hostlink.api.velocities import velocity_of_request
from hostlink.errors import BadRequest, HostlinkError
from hostlink.hub.hub import Hub
from hostlink.hub.message import PROGRAM_PRIORITY
from hostlink.hub.node import Role
from hostlink.hub.participant import MAX_CALLS
from hostlink.logs import printable
from hostlink.messages.message_type import MessageType, ServiceType
from hostlink.robot.state import MAX_PRIORITY

log = structlog.get_logger()

MAX_UNKNOWN_OPS = 8  # that are logged; a client may send any number
_ONLY_READS = frozenset({"subscribe", "unsubscribe", "call_service", "set_level", "auth", "fragment", "watch_graph"})
_LEVELS = ("info", "warning", "error", "none")  # of `set_level`: from this one on the client receives `status`
_WARNING, _ERROR = 1, 2


class RosbridgeClient:
    """One participant, and the language that its program speaks."""

    def __init__(
        self,
        name: str,
        hub: Hub,
        queue: ClientQueue,
        *,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
        role: Role = Role.DRIVE,
        group: str = "",
    ) -> None:
        """`spawn` runs a service call as a child of the client's connection; `group`: the graph for which it stands."""
        self.participant = hub.join(name, role=role, group=group, on_end=queue.close)
        self._topics = ClientTopics(self.participant)
        services = ClientServices(self.participant, hub.catalog, queue, self._warn)
        subscriptions = ClientSubscriptions(self.participant, queue, self._warn)
        self._hub = hub
        self._queue = queue
        self._spawn = spawn
        self._calls = 0
        self._status_from: int | None = None  # of _LEVELS; None: the client has not said
        self._refused_velocities = RateLimit(REFUSED_VELOCITIES_S)
        self._unknown_ops: set[str] = set()
        self._fragments = Fragments(hub.config.api.max_message_bytes, hub.budget["fragments"])
        self._drive = Drive(self.participant, hub.robots, queue, spawn=spawn)
        self._operations: dict[str, Callable[[Request], None]] = {
            "advertise": self._topics.advertise,
            "unadvertise": self._topics.unadvertise,
            "publish": self._publish,
            "subscribe": subscriptions.subscribe,
            "unsubscribe": subscriptions.unsubscribe,
            "call_service": self._call_service,
            "advertise_service": services.advertise,
            "unadvertise_service": services.unadvertise,
            "service_response": services.respond,
            "set_level": self._set_level,
            "watch_graph": ClientGraph(self.participant, hub.robots, queue).watch,
            "auth": _accept,
            "fragment": self._add_fragment,
            "drive": self._drive.receive,
            "send_action_goal": self._refuse_goal,
            **dict.fromkeys(("cancel_action_goal", "advertise_action", "unadvertise_action"), _refuse_action),
            **dict.fromkeys(("action_feedback", "action_result"), _refuse_action),
        }

    def receive(self, text: str | bytes, came_s: float | None = None) -> None:
        """Do what one message of the client's says; what is wrong with it becomes a status, and is never raised."""
        self.do(self.read(text, asyncio.get_running_loop().time() if came_s is None else came_s))

    def read(self, data: str | bytes, came_s: float) -> Operation[Request | BadRequest]:
        """Decode a message; `do` tells the client what is wrong with it."""
        try:
            request = Request.read(data)
        except BadRequest as error:
            return Operation(error, came_s)
        request.came_s = came_s
        velocity_of, is_zero = velocity_of_request(request, self._hub.topics)
        return Operation(request, came_s, velocity_of, is_zero)

    def do(self, operation: Operation[Request | BadRequest]) -> None:
        """Do what a message says; what is wrong with it becomes a status, and is never raised."""
        if isinstance(operation.content, BadRequest):
            self._put_error(operation.content)
            return
        request = operation.content
        request.replaced = [each for each in operation.replaced if isinstance(each, Request)]
        self._do(request)

    def _do(self, request: Request) -> None:
        try:
            operation = self._operations.get(request.op)
            if operation is None:
                self._log_unknown(request.op)
                raise BadRequest(f"unknown op {printable(request.op)!r}")
            self.participant.check(Role.READ if request.op in _ONLY_READS else Role.DRIVE, request.op)
            operation(request)
        except HostlinkError as error:
            self._put_error(error, request)

    def flush(self, now_s: float) -> float | None:
        """Send what subscriptions held back until now; returns when the next is due."""
        return self.participant.flush(now_s)

    @property
    def is_crowded(self) -> bool:
        """Whether many calls are under way."""
        return self._calls > MAX_CALLS // 2

    def close(self) -> None:
        """The client has left: all that it has goes with it."""
        self.participant.leave()
        self._fragments.close()

    # -- operations ---------------------------------------------------------------------------------------------------

    def _publish(self, request: Request) -> None:
        topic, type_name = request.text("topic"), request.text_or("type", "")
        message = request.table("msg")
        priority = request.whole("priority", PROGRAM_PRIORITY, MAX_PRIORITY)
        self._topics.publish(request)
        try:
            type_ = self.participant.message_type(topic, type_name)
        except HostlinkError:
            self.participant.note_publishing(topic)
            raise
        payload = _raw_payload(request, type_) or type_.encode(fill_stamps(type_, message, time.time_ns()))
        self.participant.publish(topic, payload, priority=priority, at_s=request.came_s)

    def _call_service(self, request: Request) -> None:
        if self._calls >= MAX_CALLS:
            self._answer(request, f"more than {MAX_CALLS} calls under way", is_right=False)
            return
        request.id  # noqa: B018 - one that cannot be answered is refused before anything is called
        self._calls += 1
        self._spawn(self._finish_call(request))

    async def _finish_call(self, request: Request) -> None:
        try:
            with self._hub.budget["calls"].holding(request.size_bytes, "calls that are under way"):
                name = request.text("service")
                timeout_s = request.number_or("timeout", 0.0) or None
                arguments = _arguments(request, self._hub.services.type_of(name))
                values = await self.participant.call(name, arguments, timeout_s=timeout_s)
            self._answer(request, values, is_right=True)
        except HostlinkError as error:
            self._answer(request, str(error), is_right=False)
        finally:
            self._calls -= 1

    def _add_fragment(self, request: Request) -> None:
        data = request.fields.get("data")
        if request.id is None or not isinstance(data, str):
            raise BadRequest("fragment: id and data must be there")
        number, total = request.whole("num", -1, MAX_PIECES), request.whole("total", -1, MAX_PIECES)
        now_s = asyncio.get_running_loop().time()
        whole = self._fragments.add(request.id, number=number, total=total, data=data, now_s=now_s)
        if whole is not None:
            self.receive(whole, request.came_s)

    def _refuse_goal(self, request: Request) -> None:
        """rosserial has no actions: a goal is refused at once, so that nobody waits."""
        answer = {"op": "action_result", "action": request.text("action"), "values": "no actions here", "status": 6}
        self._put(request, answer | {"result": False})

    def _set_level(self, request: Request) -> None:
        level = request.text("level")
        if level not in _LEVELS:
            raise BadRequest(f"set_level: level must be one of {', '.join(_LEVELS)}")
        self._status_from = _LEVELS.index(level)

    # -- to the client ------------------------------------------------------------------------------------------------

    def _answer(self, request: Request, values: Mapping[str, object] | str, *, is_right: bool) -> None:
        service = request.fields.get("service")
        name = service if isinstance(service, str) else ""
        self._put(request, {"op": "service_response", "service": name, "values": values, "result": is_right})

    def _put(self, request: Request, answer: dict[str, object]) -> None:
        """Queue an answer with the id of its request."""
        put_json(self._queue, answer | ({"id": request.id} if "id" in request.fields else {}))

    def _warn(self, text: str) -> None:
        log.debug("client.refused", client=self.participant.name, reason=text)
        if self._status_from is not None and self._status_from <= _WARNING:
            put_json(self._queue, {"op": "status", "level": "warning", "msg": text})

    def _put_error(self, error: HostlinkError, request: Request | None = None) -> None:
        """A client that has not said which status it wants gets those of its refused velocities, now and then.

        rosbridge's document has "error" as the default, but its own clients log an exception for each status.
        """
        log.debug("client.refused", client=self.participant.name, reason=str(error))
        if not (self._is_shown_velocity(request) if self._status_from is None else self._status_from <= _ERROR):
            return
        status = {"op": "status", "level": "error", "msg": str(error), "kind": error.kind}
        request_id = None if request is None else request.fields.get("id")
        if isinstance(request_id, str | int | float):
            status["id"] = str(request_id)
        put_json(self._queue, status)

    def _is_shown_velocity(self, request: Request | None) -> bool:
        """Whether a refusal is that of a published velocity, and the client was told of none on this topic lately."""
        name = request.fields.get("topic") if request is not None and request.op == "publish" else None
        topic = self._hub.topics.find_or_none(name) if isinstance(name, str) else None
        if topic is None or not topic.is_gated:
            return False
        return self._refused_velocities.allows(topic.name, asyncio.get_running_loop().time())

    def _log_unknown(self, op: str) -> None:
        if op not in self._unknown_ops and len(self._unknown_ops) < MAX_UNKNOWN_OPS:
            self._unknown_ops.add(op)
            log.warning("client.unknown_op", op=printable(op))


def _accept(request: Request) -> None:
    """Old clients authenticate; nothing here requires it."""


def _refuse_action(request: Request) -> None:
    raise BadRequest(f"{request.op}: no actions here")


def _raw_payload(request: Request, type_: MessageType) -> bytes:
    """The serialised message in base64, as `cbor-raw` has it; empty: the request has its fields instead.

    Raises:
        BadRequest: it is no base64.
        BadPayload: it is no message of the type.
    """
    raw = request.fields.get("raw")
    if raw is None:
        return b""
    try:
        payload = base64.b64decode(raw, validate=True)
    except (TypeError, ValueError):  # binascii.Error is one
        raise BadRequest("publish: raw must be base64") from None
    type_.decode(payload)
    return payload


def _arguments(request: Request, type_: ServiceType | None) -> Mapping[str, object]:
    """The arguments of a service call: an object, or a list that goes to the request's fields in their order."""
    arguments = request.fields.get("args") or {}
    if isinstance(arguments, list) and type_ is not None:
        return {field.name: value for field, value in zip(type_.request.fields, arguments, strict=False)}
    if not isinstance(arguments, dict):
        raise BadRequest("call_service: args must be an object, or a list for a service whose type has a definition")
    return arguments
