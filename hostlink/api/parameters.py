"""Parameters: rosapi's calls on the parameters that devices request. A name may be that of a tree."""

from typing import Any

import msgspec

from hostlink.config import ParameterScalar, ParameterValue
from hostlink.errors import BadRequest, UnknownTopic
from hostlink.hub.parameters import to_parameter
from hostlink.hub.topic_graph import resolve

MAX_PARAMETERS = 1024
MAX_VALUE_CHARACTERS = 4096  # of JSON; no device accepts more
_Value = ParameterScalar | list[ParameterScalar]


class Parameters:
    """Parameters by full name (`/robot_0/gain`). The settings may have relative names."""

    def __init__(self, settings: dict[str, ParameterValue]) -> None:
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
