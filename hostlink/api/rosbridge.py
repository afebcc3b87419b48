"""RosbridgeClient: one client that speaks rosbridge v2. JSON comes in, JSON and calls of the hub go out; no socket."""

import asyncio
import math
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import msgspec
import structlog

from hostlink.api.cbor import encode_cbor, encode_cbor_raw
from hostlink.api.client_queue import ClientQueue
from hostlink.api.client_services import ClientServices
from hostlink.api.drive import Drive
from hostlink.api.throttle import Throttle
from hostlink.errors import BadPayload, BadRequest, HostlinkError
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.robots import MAX_PRIORITY, PROGRAM_PRIORITY
from hostlink.hub.services import DEFAULT_TIMEOUT_S
from hostlink.hub.subscriptions import Unsubscribe
from hostlink.logs import printable

log = structlog.get_logger()

MAX_SUBSCRIPTIONS = 256
MAX_CALLS = 32  # of services, under way at once
_BINARY = {"cbor": encode_cbor, "cbor-raw": encode_cbor_raw}
_LEVELS = ("info", "warning", "error", "none")  # of `set_level`: from this one on the client wants `status`


class _Subscription:
    """One topic string of one client; several ids may share it, the most eager of them counts."""

    def __init__(self, topic: str, name: str) -> None:
        self.topic = topic
        self.prefix = msgspec.json.encode({"op": "publish", "topic": name})[:-1] + b',"msg":'
        self.compression = "none"
        self.wishes: dict[object, tuple[float, int]] = {}
        self.throttle = Throttle(interval_s=0.0, queue_length=0)
        self.unsubscribe: Unsubscribe | None = None

    def wish(self, key: object, interval_s: float, queue_length: int) -> None:
        self.wishes[key] = (interval_s, queue_length)
        self._merge()

    def unwish(self, key: object) -> None:
        self.wishes.pop(key, None)
        if self.wishes:
            self._merge()

    def _merge(self) -> None:
        interval_s = min(interval for interval, _ in self.wishes.values())
        queue_length = min(length for _, length in self.wishes.values())
        self.throttle = Throttle(interval_s=interval_s, queue_length=queue_length)


class RosbridgeClient:
    """What one client has advertised, subscribed and called; `close` takes all of it back."""

    def __init__(
        self,
        name: str,
        hub: Hub,
        queue: ClientQueue,
        *,
        spawn: Callable[[Coroutine[Any, Any, None]], object],
    ) -> None:
        """`spawn` runs a service call as a child of the client's connection."""
        self.name = name
        self._hub = hub
        self._queue = queue
        self._spawn = spawn
        self._calls = 0
        self._status_from = _LEVELS.index("none")
        self._subscriptions: dict[str, _Subscription] = {}
        self._services = ClientServices(name, hub.services, queue)
        self._operations: dict[str, Callable[[dict[str, Any]], None]] = {
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "publish": self._publish,
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "call_service": self._call_service,
            "advertise_service": self._advertise_service,
            "unadvertise_service": self._unadvertise_service,
            "service_response": self._services_respond,
            "set_level": self._set_level,
            "drive": Drive(name, hub.robots, queue).receive,
            "auth": _accept,
            "send_action_goal": self._refuse_action,
        }

    def receive(self, text: str | bytes) -> None:
        """Take one message of the client's; what is wrong with it is told as a status, never raised."""
        request: dict[str, Any] = {}
        try:
            request = _read(text)
            operation = self._operations.get(_text(request, "op"))
            if operation is None:
                log.warning("client.unknown_op", op=printable(str(request["op"])))
                raise BadRequest(f"unknown op {request['op']!r}")
            operation(request)
        except HostlinkError as error:
            self._tell_status("error", str(error), request.get("id"))

    def flush(self, now_s: float) -> float | None:
        """Queue what throttled subscriptions held back until now; returns when the next is due."""
        due: list[float] = []
        for subscription in self._subscriptions.values():
            while (message := subscription.throttle.take(now_s)) is not None:
                self._queue_message(subscription, message)
            if (at_s := subscription.throttle.due_s()) is not None:
                due.append(at_s)
        return min(due, default=None)

    def close(self) -> None:
        """The client is gone: everything that it held ends, and what it drove stops."""
        for subscription in self._subscriptions.values():
            if subscription.unsubscribe is not None:
                subscription.unsubscribe()
        self._subscriptions.clear()
        self._services.close()
        self._hub.leave(self.name)

    # -- operations ---------------------------------------------------------------------------------------------------

    def _advertise(self, request: dict[str, Any]) -> None:
        type_name = _text(request, "type")
        if self._hub.catalog.message(type_name) is None:
            raise BadRequest(f"unknown type {type_name}; put its .msg into a folder named in message_folders")
        self._hub.topics.advertise(_text(request, "topic"), self.name, type_name=type_name)

    def _unadvertise(self, request: dict[str, Any]) -> None:
        self._hub.topics.unadvertise(_text(request, "topic"), self.name)

    def _publish(self, request: dict[str, Any]) -> None:
        message = request.get("msg", {})
        if not isinstance(message, dict):
            raise BadRequest("publish: msg must be an object")
        priority = request.get("priority", PROGRAM_PRIORITY)
        if not isinstance(priority, int) or not 0 <= priority <= MAX_PRIORITY:
            raise BadRequest(f"publish: priority must be a number from 0 to {MAX_PRIORITY}")
        self._hub.publish(
            _text(request, "topic"), message, source=self.name, type_name=_type_name(request), priority=priority
        )

    def _subscribe(self, request: dict[str, Any]) -> None:
        name = _text(request, "topic")
        interval_s = _number(request, "throttle_rate") / 1000
        queue_length = int(_number(request, "queue_length"))
        subscription = self._subscriptions.get(name)
        if subscription is None:
            if len(self._subscriptions) >= MAX_SUBSCRIPTIONS:
                raise BadRequest(f"more than {MAX_SUBSCRIPTIONS} subscriptions")
            new = _Subscription(name, name)
            new.unsubscribe = self._hub.topics.subscribe(
                name, lambda message: self._deliver(new, message), type_name=_type_name(request)
            )
            subscription = self._subscriptions[name] = new
        compression = request.get("compression") or "none"
        subscription.compression = compression if compression in _BINARY else "none"  # png: nobody needs it any more
        subscription.wish(request.get("id"), interval_s, min(queue_length, MAX_SUBSCRIPTIONS))

    def _unsubscribe(self, request: dict[str, Any]) -> None:
        name = _text(request, "topic")
        subscription = self._subscriptions.get(name)
        if subscription is None:
            return
        if "id" in request:
            subscription.unwish(request["id"])
        if "id" not in request or not subscription.wishes:
            del self._subscriptions[name]
            self._queue.forget(name)
            if subscription.unsubscribe is not None:
                subscription.unsubscribe()

    def _call_service(self, request: dict[str, Any]) -> None:
        if self._calls >= MAX_CALLS:
            self._answer(request, f"more than {MAX_CALLS} calls under way", is_right=False)
            return
        self._calls += 1
        self._spawn(self._finish_call(request))

    async def _finish_call(self, request: dict[str, Any]) -> None:
        try:
            name = _text(request, "service")
            timeout_s = _number(request, "timeout", DEFAULT_TIMEOUT_S)
            values = await self._hub.services.call(name, _arguments(request), timeout_s=timeout_s)
            self._answer(request, values, is_right=True)
        except HostlinkError as error:
            self._answer(request, str(error), is_right=False)
        finally:
            self._calls -= 1

    def _advertise_service(self, request: dict[str, Any]) -> None:
        self._services.advertise(_text(request, "service"), _text(request, "type"))

    def _unadvertise_service(self, request: dict[str, Any]) -> None:
        self._services.unadvertise(_text(request, "service"))

    def _services_respond(self, request: dict[str, Any]) -> None:
        self._services.respond(request)

    def _refuse_action(self, request: dict[str, Any]) -> None:
        """rosserial has no actions: who asks for one is told so, instead of waiting."""
        answer = {"op": "action_result", "action": request.get("action"), "values": "no actions here", "result": False}
        self._queue.put_result(msgspec.json.encode(answer | ({"id": request["id"]} if "id" in request else {})))

    def _set_level(self, request: dict[str, Any]) -> None:
        level = _text(request, "level")
        if level not in _LEVELS:
            raise BadRequest(f"set_level: level must be one of {', '.join(_LEVELS)}")
        self._status_from = _LEVELS.index(level)

    # -- to the client ------------------------------------------------------------------------------------------------

    def _deliver(self, subscription: _Subscription, message: Message) -> None:
        now_s = asyncio.get_running_loop().time()
        ready = subscription.throttle.offer(message, now_s)
        if ready is not None:
            self._queue_message(subscription, ready)
        elif subscription.throttle.due_s() is not None:
            self._queue.nudge()

    def _queue_message(self, subscription: _Subscription, message: Message) -> None:
        encode = _BINARY.get(subscription.compression)
        try:
            if encode is None:
                self._queue.put_message(subscription.topic, subscription.prefix + message.json + b"}")
            else:
                self._queue.put_message(subscription.topic, encode(subscription.topic, message), is_binary=True)
        except BadPayload as error:
            self._tell_status("warning", str(error), None)

    def _answer(self, request: dict[str, Any], values: Mapping[str, object] | str, *, is_right: bool) -> None:
        answer = {"op": "service_response", "service": request.get("service"), "values": values, "result": is_right}
        if "id" in request:
            answer["id"] = request["id"]
        self._queue.put_result(msgspec.json.encode(answer))

    def _tell_status(self, level: str, text: str, request_id: object) -> None:
        """rosbridge's own clients log an exception for a status that they did not ask for."""
        log.debug("client.refused", client=self.name, reason=text)
        if _LEVELS.index(level) >= self._status_from:
            status = {"op": "status", "level": level, "msg": text}
            if request_id is not None:
                status["id"] = str(request_id)
            self._queue.put_result(msgspec.json.encode(status))


def _accept(request: dict[str, Any]) -> None:
    """Old clients authenticate; nothing here asks for it."""


def _read(text: str | bytes) -> dict[str, Any]:
    try:
        request = msgspec.json.decode(text)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadRequest(f"no JSON: {error}") from error
    except RecursionError:
        raise BadRequest("no JSON that anybody means: nested too deeply") from None
    if not isinstance(request, dict) or "op" not in request:
        raise BadRequest('a message is a JSON object with an "op"')
    return request


def _text(request: dict[str, Any], key: str) -> str:
    value = request.get(key)
    if not isinstance(value, str) or not value:
        raise BadRequest(f"{request.get('op')}: {key} must be a text")
    return value


def _type_name(request: dict[str, Any]) -> str:
    """The type that a request names; clients leave it out, or empty, when the topic is known."""
    return _text(request, "type") if request.get("type") else ""


def _number(request: dict[str, Any], key: str, default: float = 0.0) -> float:
    value = request.get(key)
    if value is None:
        return default
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value) or value < 0:
        raise BadRequest(f"{request.get('op')}: {key} must be a number, not negative")
    return float(value)


def _arguments(request: dict[str, Any]) -> dict[str, object]:
    """The arguments of a service call: an object; or a list, which only a service without arguments may have empty."""
    arguments = request.get("args") or {}
    if not isinstance(arguments, dict):
        raise BadRequest("call_service: args must be an object")
    return arguments
