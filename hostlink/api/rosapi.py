"""rosapi: the services by which rosbridge's clients look at the graph, answered from the hub as it is now."""

import time
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec

from hostlink.errors import BadRequest, UnknownTopic
from hostlink.hub.hub import Hub
from hostlink.hub.services import DeviceService, Provider
from hostlink.hub.subscriptions import resolve
from hostlink.messages.message_type import MessageType

Request = Mapping[str, Any]
Response = dict[str, Any]

KEY = "rosapi"
_NS_PER_S = 1_000_000_000


class RosApi:
    """One method a service, by its name; `offer` makes them all callable."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub

    def offer(self) -> None:
        """Register every service under /rosapi/."""
        answers: dict[str, tuple[str, Callable[[Request], Response]]] = {
            "topics": ("Topics", self._topics),
            "topics_and_raw_types": ("TopicsAndRawTypes", self._topics_and_raw_types),
            "topics_for_type": ("TopicsForType", self._topics_for_type),
            "topic_type": ("TopicType", self._topic_type),
            "services": ("Services", self._services),
            "services_for_type": ("ServicesForType", self._services_for_type),
            "service_type": ("ServiceType", self._service_type),
            "message_details": ("MessageDetails", lambda request: self._details(self._message(request))),
            "service_request_details": (
                "ServiceRequestDetails",
                lambda request: self._details(self._service(request).request),
            ),
            "service_response_details": (
                "ServiceResponseDetails",
                lambda request: self._details(self._service(request).response),
            ),
            "nodes": ("Nodes", self._nodes),
            "node_details": ("NodeDetails", self._node_details),
            "publishers": ("Publishers", self._publishers),
            "subscribers": ("Subscribers", self._subscribers),
            "get_param": ("GetParam", self._get_param),
            "set_param": ("SetParam", self._set_param),
            "has_param": ("HasParam", self._has_param),
            "delete_param": ("DeleteParam", self._delete_param),
            "get_param_names": ("GetParamNames", self._get_param_names),
            "action_servers": ("GetActionServers", lambda _: {"action_servers": []}),
            "get_time": ("GetTime", self._get_time),
        }
        for name, (type_name, answer) in answers.items():
            self._hub.services.provide(Provider(f"/rosapi/{name}", f"rosapi/{type_name}", KEY, _waiting(answer)))

    # -- topics and types ---------------------------------------------------------------------------------------------

    def _topics(self, _: Request) -> Response:
        topics = self._hub.topics.all()
        return {"topics": [topic.name for topic in topics], "types": [topic.type_name for topic in topics]}

    def _topics_and_raw_types(self, request: Request) -> Response:
        texts = [topic.type.full_definition if topic.type else "" for topic in self._hub.topics.all()]
        return {**self._topics(request), "typedefs_full_text": texts}

    def _topics_for_type(self, request: Request) -> Response:
        wanted = _text(request, "type")
        return {"topics": [topic.name for topic in self._hub.topics.all() if topic.type_name == wanted]}

    def _topic_type(self, request: Request) -> Response:
        topic = self._hub.topics.find_or_none(_text(request, "topic"))
        return {"type": "" if topic is None else topic.type_name}

    def _details(self, type_: MessageType) -> Response:
        typedefs: dict[str, Response] = {}
        _add_typedef(type_, typedefs)
        return {"typedefs": list(typedefs.values())}

    def _message(self, request: Request) -> MessageType:
        name = _text(request, "type")
        found = self._hub.catalog.message(name)
        if found is None:
            raise UnknownTopic("message type", name)
        return found

    # -- services -----------------------------------------------------------------------------------------------------

    def _services(self, _: Request) -> Response:
        return {"services": [name for name, _ in self._hub.services.all()]}

    def _services_for_type(self, request: Request) -> Response:
        wanted = _text(request, "type")
        return {"services": [name for name, type_name in self._hub.services.all() if type_name == wanted]}

    def _service_type(self, request: Request) -> Response:
        return {"type": dict(self._hub.services.all()).get(resolve(_text(request, "service")), "")}

    def _service(self, request: Request) -> Any:
        name = _text(request, "type")
        found = self._hub.catalog.service(name)
        if found is None:
            raise UnknownTopic("service type", name)
        return found

    # -- nodes: hostlink itself, every device, every client -----------------------------------------------------------

    def _nodes(self, _: Request) -> Response:
        keys = {key for topic in self._hub.topics.all() for key in (*topic.publishers, *topic.devices)}
        return {"nodes": sorted({"/hostlink", *(self._node(key) for key in keys)})}

    def _node_details(self, request: Request) -> Response:
        node = _text(request, "node")
        topics = self._hub.topics.all()
        offered = [name for name, _ in self._hub.services.all()]
        return {
            "publishing": [topic.name for topic in topics if node in map(self._node, topic.publishers)],
            "subscribing": [topic.name for topic in topics if node in map(self._node, topic.devices)],
            "services": [name for name in offered if node == self._node(self._offerer(name))],
        }

    def _publishers(self, request: Request) -> Response:
        topic = self._hub.topics.find(_text(request, "topic"))
        return {"publishers": sorted(map(self._node, topic.publishers))}

    def _subscribers(self, request: Request) -> Response:
        topic = self._hub.topics.find(_text(request, "topic"))
        return {"subscribers": sorted(map(self._node, topic.devices))}

    def _offerer(self, name: str) -> object:
        found = self._hub.services.find(name)
        return found.key if isinstance(found, DeviceService | Provider) else None

    def _node(self, key: object) -> str:
        """A robot by its name, another device by its link, a client by its number."""
        if key in ("hostlink", KEY):
            return "/hostlink"
        robot = next((robot.name for robot in self._hub.robots.all() if robot.link is key), None)
        return f"/{robot or str(key).split(' (', maxsplit=1)[0].replace(' ', '_')}"

    # -- parameters and time ------------------------------------------------------------------------------------------

    def _get_param(self, request: Request) -> Response:
        default = request.get("default") or "null"
        name = self._param_name(request)
        value = self._hub.parameters.get(name) if name else None
        return {"value": default if value is None else msgspec.json.encode(value).decode()}

    def _set_param(self, request: Request) -> Response:
        name = self._param_name(request) or _text(request, "name")
        try:
            self._hub.parameters[name] = msgspec.json.decode(_text(request, "value"), type=_Parameter)
        except msgspec.DecodeError as error:
            raise BadRequest(
                f"set_param: value must be JSON of a number, a text, a truth or a list of them: {error}"
            ) from error
        return {}

    def _has_param(self, request: Request) -> Response:
        return {"exists": self._param_name(request) is not None}

    def _delete_param(self, request: Request) -> Response:
        name = self._param_name(request)
        if name is None:
            raise UnknownTopic("parameter", _text(request, "name"), tuple(self._hub.parameters))
        del self._hub.parameters[name]
        return {}

    def _get_param_names(self, _: Request) -> Response:
        return {"names": sorted(resolve(name) for name in self._hub.parameters)}

    def _param_name(self, request: Request) -> str | None:
        """As the setting spells it."""
        wanted = resolve(_text(request, "name"))
        return next((name for name in self._hub.parameters if resolve(name) == wanted), None)

    def _get_time(self, _: Request) -> Response:
        secs, nsecs = divmod(time.time_ns(), _NS_PER_S)
        return {"time": {"secs": secs, "nsecs": nsecs}}


_Parameter = bool | int | float | str | list[bool | int | float | str]


def _waiting(answer: Callable[[Request], Response]) -> Callable[[Request], Awaitable[Response]]:
    async def wait(request: Request) -> Response:
        return answer(request)

    return wait


def _text(request: Request, key: str) -> str:
    value = request.get(key)
    if not isinstance(value, str) or not value:
        raise BadRequest(f"{key} must be a text")
    return value


def _add_typedef(type_: MessageType, typedefs: dict[str, Response]) -> None:
    """The root first, then each nested type once."""
    if type_.name in typedefs:
        return
    typedefs[type_.name] = {
        "type": type_.name,
        "fieldnames": [field.name for field in type_.fields],
        "fieldtypes": [field.type for field in type_.fields],
        "fieldarraylen": [field.array_length for field in type_.fields],
        "examples": [_example(field.type, field.array_length) for field in type_.fields],
        "constnames": [constant.name for constant in type_.constants],
        "constvalues": [constant.text for constant in type_.constants],
    }
    for nested in type_.nested.values():
        _add_typedef(nested, typedefs)


def _example(type_name: str, array_length: int) -> str:
    if array_length >= 0:
        return "[]"
    if "/" in type_name:
        return "{}"
    return {"string": "", "bool": "false", "float32": "0.0", "float64": "0.0"}.get(type_name, "0")
