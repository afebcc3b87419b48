"""RosApi: the services by which rosbridge's clients read the graph, answered from the hub."""

import socket
import time
from collections.abc import Awaitable, Callable, Mapping, MutableMapping, Sequence
from typing import Any

import msgspec

from hostlink.core.config import ParameterScalar, ParameterValue
from hostlink.core.host import Host, KnownTopic, resolve, to_parameter
from hostlink.core.messages.catalog import to_time
from hostlink.core.messages.fields import BUILT_IN, FLOATS, SCALAR, Constant, Field, bool_value
from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.errors import BadRequest, UnknownTopic

MAX_PARAMETERS = 1024
MAX_VALUE_CHARACTERS = 4096  # of JSON; no device accepts more
_Value = ParameterScalar | list[ParameterScalar]


class Parameters:
    """Parameters by full name (`/robot_0/gain`). The settings may have relative names."""

    def __init__(self, settings: MutableMapping[str, ParameterValue]) -> None:
        self._settings = settings

    def names(self) -> list[str]:
        """Return all names."""
        return sorted(map(resolve, self._settings))

    def values(self) -> dict[str, ParameterValue]:
        """Return all values by name, without trees."""
        return {resolve(setting): value for setting, value in self._settings.items()}

    def has(self, name: str) -> bool:
        """Whether there is a parameter of this name, or one below it."""
        return bool(self._below(name))

    def get(self, name: str, default: str) -> str:
        """Return the value as JSON: an object if parameters are below the name. `default` is JSON or a text."""
        found = self._below(name)
        if not found:
            return _as_json(default)
        return msgspec.json.encode(self._tree(resolve(name).rstrip("/"), found)).decode()

    def put(self, name: str, text: str) -> None:
        """Replace the parameter and all below it by this JSON.

        Raises:
            HostlinkError: a device could not be answered with the value.
        """
        if len(text) > MAX_VALUE_CHARACTERS:
            raise BadRequest(f"set_param: value is longer than {MAX_VALUE_CHARACTERS} characters")
        leaves: dict[str, ParameterValue] = {}
        try:
            _flatten(resolve(name), msgspec.json.decode(text), leaves)
        except (msgspec.DecodeError, msgspec.ValidationError, RecursionError) as error:
            wanted = "a number, a text, true or false, a list of them, or an object of those"
            raise BadRequest(f"set_param: value must be JSON of {wanted}: {error}") from None
        for full, value in leaves.items():
            to_parameter(full, value)
        replaced = self._below(name)
        if len(self._settings) - len(replaced) + len(leaves) > MAX_PARAMETERS:
            raise BadRequest(f"set_param: more than {MAX_PARAMETERS} parameters")
        for setting in replaced.values():
            del self._settings[setting]
        self._settings.update({replaced.get(full, full): value for full, value in leaves.items()})

    def delete(self, name: str) -> None:
        """Delete the parameter and all below it. Raise UnknownTopic if there is none."""
        found = self._below(name)
        if not found:
            raise UnknownTopic("parameter", name, tuple(self.names()))
        for setting in found.values():
            del self._settings[setting]

    def _below(self, name: str) -> dict[str, str]:
        """Return the names in the settings, by full name, of the parameter and of those below it."""
        wanted = resolve(name).rstrip("/")
        full_names = {resolve(setting): setting for setting in self._settings}
        return {full: own for full, own in full_names.items() if full == wanted or full.startswith(f"{wanted}/")}

    def _tree(self, name: str, found: dict[str, str]) -> object:
        if name in found:
            return self._settings[found[name]]
        tree: dict[str, Any] = {}
        for full, setting in sorted(found.items()):
            *branches, leaf = full.removeprefix(f"{name}/").split("/")
            place = tree
            for branch in branches:
                if not isinstance(place.get(branch), dict):
                    place[branch] = {}
                place = place[branch]
            place[leaf] = self._settings[setting]
        return tree


def _as_json(default: str) -> str:
    try:
        msgspec.json.decode(default or "null")
    except (msgspec.DecodeError, RecursionError):
        return msgspec.json.encode(default).decode()
    return default or "null"


def _flatten(name: str, value: Any, leaves: dict[str, ParameterValue]) -> None:
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            _flatten(f"{name.rstrip('/')}/{key}", inner, leaves)
    else:
        leaves[name] = msgspec.convert(value, _Value)


_TIMES = ("time", "duration")
_TIME_FIELDS = (Field("secs", "int32"), Field("nsecs", "int32"))
_EXAMPLES = {"string": "", "bool": "False", "float32": "0.0", "float64": "0.0"}  # defaults as Python prints them


def describe(type_: MessageType) -> list[dict[str, Any]]:
    """Return the TypeDefs of a type and of all types in it: the root first, depth first, each once."""
    typedefs: dict[str, dict[str, Any]] = {}
    _add(type_, typedefs)
    return list(typedefs.values())


def _add(type_: MessageType, typedefs: dict[str, dict[str, Any]]) -> None:
    typedefs[type_.name] = _typedef(type_.name, type_.fields, sorted(type_.constants))
    for field in type_.fields:
        if field.type in typedefs:
            continue
        if field.type in _TIMES:
            typedefs[field.type] = _typedef(field.type, _TIME_FIELDS, ())
        elif field.type in type_.nested:
            _add(type_.nested[field.type], typedefs)


def _typedef(name: str, fields: Sequence[Field], constants: Sequence[Constant]) -> dict[str, Any]:
    return {
        "type": name,
        "fieldnames": [field.name for field in fields],
        "fieldtypes": [field.type for field in fields],
        "fieldarraylen": [field.array_length for field in fields],
        "examples": [_example(field.type, field.array_length) for field in fields],
        "constnames": [constant.name for constant in constants],
        "constvalues": [_value(constant) for constant in constants],
    }


def _example(type_name: str, array_length: int) -> str:
    if array_length != SCALAR:
        return "[]"
    if type_name in _TIMES or type_name not in BUILT_IN:
        return "{}"
    return _EXAMPLES.get(type_name, "0")


def _value(constant: Constant) -> str:
    """Format a constant as Python prints the one of the generated class."""
    if constant.type in FLOATS:
        return str(float(constant.text))
    if constant.type == "bool":
        return str(bool_value(constant.text))
    return constant.text if constant.type == "string" else str(int(constant.text))


Request = Mapping[str, Any]
Response = dict[str, Any]

_WRITERS = frozenset({"set_param", "delete_param"})
# Of services whose type has another name than they.
_TYPE_NAMES = {"action_servers": "GetActionServers", "get_ros_version": "GetROSVersion"}


class RosApi:
    """The /rosapi/ services. `offer` provides them all."""

    def __init__(self, host: Host) -> None:
        self._graph, self._messages = host.graph, host.messages
        self._participant = host.join_as_daemon()
        self._parameters = Parameters(host.parameters)

    def offer(self) -> None:
        """Register every service under /rosapi/."""
        answers: dict[str, Callable[[Request], Response]] = {
            "topics": self._topics,
            "topics_and_raw_types": self._topics_and_raw_types,
            "topics_for_type": self._topics_for_type,
            "topic_type": self._topic_type,
            "message_details": self._message_details,
            "service_request_details": lambda of: {"typedefs": describe(self._service(of).request)},
            "service_response_details": lambda of: {"typedefs": describe(self._service(of).response)},
            "services": lambda _: {"services": self._service_names()},
            "services_for_type": self._services_for_type,
            "service_type": self._service_type,
            "service_node": lambda of: {"node": self._graph.provider(_text(of, "service"))},
            "service_host": self._service_host,
            "service_providers": self._service_providers,
            "nodes": self._nodes,
            "node_details": self._node_details,
            "publishers": self._publishers,
            "subscribers": self._subscribers,
            "action_servers": lambda _: {"action_servers": []},
            "get_param": self._get_param,
            "set_param": self._set_param,
            "has_param": lambda of: {"exists": self._parameters.has(_text(of, "name"))},
            "search_param": self._search_param,
            "delete_param": self._delete_param,
            "get_param_names": lambda _: {"names": self._parameters.names()},
            "get_time": lambda _: {"time": to_time(time.time_ns())},
            "get_ros_version": lambda _: {"version": 1, "distro": "noetic"},  # of the types
        }
        for name, answer in answers.items():
            type_name = _TYPE_NAMES.get(name) or "".join(map(str.capitalize, name.split("_")))
            is_reading = name not in _WRITERS
            self._participant.provide(f"/rosapi/{name}", f"rosapi/{type_name}", _waiting(answer), is_reading=is_reading)

    # -- topics and types ---------------------------------------------------------------------------------------------

    def _known_topics(self) -> list[KnownTopic]:
        """Return the topics whose type is known. A topic that has only subscribers may have none."""
        return [topic for topic in self._graph.topics() if topic.type_name]

    def _topics(self, _: Request) -> Response:
        topics = self._known_topics()
        return {"topics": [topic.name for topic in topics], "types": [topic.type_name for topic in topics]}

    def _topics_and_raw_types(self, request: Request) -> Response:
        texts = [topic.type.full_definition if topic.type else "" for topic in self._known_topics()]
        return {**self._topics(request), "typedefs_full_text": texts}

    def _topics_for_type(self, request: Request) -> Response:
        wanted = _plain(_text(request, "type"))
        return {"topics": [topic.name for topic in self._known_topics() if topic.type_name == wanted]}

    def _topic_type(self, request: Request) -> Response:
        topic = self._graph.topic(_text(request, "topic"))
        return {"type": "" if topic is None else topic.type_name}

    def _message_details(self, request: Request) -> Response:
        name = _text(request, "type")
        found = self._messages.message(name)
        if found is None:
            raise UnknownTopic("message type", name)
        return {"typedefs": describe(found)}

    def _service(self, request: Request) -> ServiceType:
        name = _text(request, "type")
        found = self._messages.service(name)
        if found is None:
            raise UnknownTopic("service type", name)
        return found

    # -- services -----------------------------------------------------------------------------------------------------

    def _service_names(self) -> list[str]:
        return [name for name, _ in self._graph.services()]

    def _services_for_type(self, request: Request) -> Response:
        wanted = _plain(_text(request, "type"))
        return {"services": [name for name, type_name in self._graph.services() if _plain(type_name) == wanted]}

    def _service_type(self, request: Request) -> Response:
        return {"type": dict(self._graph.services()).get(resolve(_text(request, "service")), "")}

    def _service_host(self, request: Request) -> Response:
        is_known = self._graph.provider(_text(request, "service"))
        return {"host": socket.gethostname() if is_known else ""}

    def _service_providers(self, request: Request) -> Response:
        """Return the providers of a service, or of every service of a type: rosbridge's versions differ."""
        wanted = _text(request, "service")
        names = [name for name, type_name in self._graph.services() if wanted == type_name or resolve(wanted) == name]
        return {"providers": sorted({self._graph.provider(name) for name in names})}

    # -- nodes: hostlink itself, every device, every client -----------------------------------------------------------

    def _nodes(self, _: Request) -> Response:
        return {"nodes": sorted(self._graph.nodes())}

    def _node_details(self, request: Request) -> Response:
        node = _text(request, "node")
        publishers, subscribers, providers = self._graph.by_node()
        return {
            "publishing": [name for name, nodes in publishers.items() if node in nodes],
            "subscribing": [name for name, nodes in subscribers.items() if node in nodes],
            "services": [name for name, nodes in providers.items() if node in nodes],
        }

    def _publishers(self, request: Request) -> Response:
        return {"publishers": sorted(self._graph.publishers(_text(request, "topic")))}

    def _subscribers(self, request: Request) -> Response:
        return {"subscribers": sorted(self._graph.subscribers(_text(request, "topic")))}

    # -- parameters ---------------------------------------------------------------------------------------------------

    def _get_param(self, request: Request) -> Response:
        default = request.get("default")
        return {"value": self._parameters.get(_text(request, "name"), default if isinstance(default, str) else "")}

    def _set_param(self, request: Request) -> Response:
        self._parameters.put(_text(request, "name"), _text(request, "value"))
        return {}

    def _search_param(self, request: Request) -> Response:
        """Search a parameter. The root is the only namespace."""
        name = _text(request, "name")
        return {"global_name": resolve(name) if self._parameters.has(name) else ""}

    def _delete_param(self, request: Request) -> Response:
        self._parameters.delete(_text(request, "name"))
        return {}


def _waiting(answer: Callable[[Request], Response]) -> Callable[[Request], Awaitable[Response]]:
    async def wait(request: Request) -> Response:
        return answer(request)

    return wait


def _text(request: Request, key: str) -> str:
    value = request.get(key)
    if not isinstance(value, str) or not value:
        raise BadRequest(f"{key} must be a text")
    return value


def _plain(type_name: str) -> str:
    """Convert "pkg/msg/Type" to "pkg/Type"."""
    parts = type_name.split("/")
    return f"{parts[0]}/{parts[-1]}" if len(parts) > 1 else type_name
