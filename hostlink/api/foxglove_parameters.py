"""FoxgloveParameters: the parameters that devices request, as one client of Foxglove's protocol reads and sets them."""

import math
from collections.abc import Mapping
from typing import Any

import msgspec

from hostlink.api.foxglove_requests import MAX_ITEMS, ParameterSetting
from hostlink.api.outgoing import ClientQueue, put_json
from hostlink.api.parameters import Parameters
from hostlink.config import ParameterValue
from hostlink.errors import BadRequest
from hostlink.hub.byte_budget import Share
from hostlink.hub.topic_graph import resolve

CHECK_INTERVAL_S = 0.5  # at which watched parameters are compared, whoever changed them


class FoxgloveParameters:
    """Names are full ones. A float is marked as one, because JSON in a browser does not keep it."""

    def __init__(self, parameters: Parameters, queue: ClientQueue, share: Share) -> None:
        """`share`: of the names that all clients watch."""
        self._parameters, self._queue, self._share = parameters, queue, share
        self._watched: dict[str, ParameterValue | None] = {}  # what was sent last; None: there is none
        self._due_s = 0.0

    def send(self, names: list[str], request_id: str | None) -> None:
        """Send these, as far as they are there; without a name all."""
        values = self._parameters.values()
        known = {name: values[name] for name in map(resolve, names) if name in values} if names else values
        self._put(known, request_id)

    def set(self, setting: ParameterSetting) -> None:
        """Set one, or remove it.

        Raises:
            BadRequest, WrongType: no device could be answered with the value.
            UnknownTopic: it is to be removed, and is not there.
        """
        if setting.value is msgspec.UNSET:
            self._parameters.delete(setting.name)
        else:
            self._parameters.put(setting.name, msgspec.json.encode(_value(setting)).decode())

    def watch(self, names: list[str]) -> None:
        """Send these whenever they change; without a name all that there are.

        Raises:
            BadRequest: they are too many.
        """
        values = self._parameters.values()
        wanted = list(map(resolve, names)) or list(values)
        if len(self._watched.keys() | set(wanted)) > MAX_ITEMS:
            raise BadRequest(f"more than {MAX_ITEMS} parameters watched")
        more_bytes = sum(map(_size, set(wanted) - self._watched.keys()))
        if not self._share.take(more_bytes):
            raise BadRequest(f"the names that all clients watch have more than {self._share.max_bytes} bytes")
        self._watched = {name: values.get(name) for name in wanted} | self._watched

    def unwatch(self, names: list[str]) -> None:
        """Send them no more; without a name none."""
        for name in map(resolve, names or list(self._watched)):
            if name in self._watched:
                del self._watched[name]
                self._share.give(_size(name))

    def flush(self, now_s: float) -> float | None:
        """Send what has changed; returns when to compare again."""
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


def _size(name: str) -> int:
    return len(name.encode("utf-8", "surrogatepass"))


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
    """As its type has it.

    Raises:
        BadRequest: the type is not offered, or the value is none of it.
    """
    if setting.type is None:
        return setting.value
    if setting.type not in ("float64", "float64_array"):
        raise BadRequest(f"parameter {setting.name}: the type {setting.type!r} is not offered")
    is_array = setting.type == "float64_array"
    try:
        floats = msgspec.convert(setting.value if is_array else [setting.value], list[float])
    except (msgspec.ValidationError, OverflowError) as error:
        raise BadRequest(f"parameter {setting.name}: {error}") from None
    if not all(map(math.isfinite, floats)):
        raise BadRequest(f"parameter {setting.name}: must be finite")
    return floats if is_array else floats[0]
