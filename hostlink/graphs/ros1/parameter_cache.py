"""ParameterCache: parameters of the master that this node has subscribed to, and their updates. Pure."""

from collections import OrderedDict
from typing import Any

MAX_KEYS = 256  # devices may request any names


class ParameterCache:
    """Values by the key that was subscribed to; one that is not set is None. Of too many the oldest goes."""

    def __init__(self, max_keys: int = MAX_KEYS) -> None:
        self._values: OrderedDict[str, Any] = OrderedDict()
        self._max_keys = max_keys

    @property
    def keys(self) -> tuple[str, ...]:
        """All that are subscribed to."""
        return tuple(self._values)

    def put(self, key: str, value: Any) -> str | None:
        """The master has answered a subscription; returns the key that has to go, if there are too many."""
        self._values[key] = None if value == {} else value
        self._values.move_to_end(key)
        return self._values.popitem(last=False)[0] if len(self._values) > self._max_keys else None

    def clear(self) -> None:
        """The master has forgotten the subscriptions."""
        self._values.clear()

    def update(self, key: str, value: Any) -> None:
        """The master reports a change, of a key or of something below it; {} is a parameter that was deleted."""
        key = key.rstrip("/")
        for subscribed in self._values:
            if key == subscribed:
                self._values[subscribed] = None if value == {} else value
            elif key.startswith(f"{subscribed}/"):
                self._values[subscribed] = _with(self._values[subscribed], key[len(subscribed) + 1 :].split("/"), value)

    def find(self, name: str) -> tuple[bool, Any]:
        """(whether it is known, its value; None: it is not set)."""
        if name in self._values:
            return True, self._values[name]
        for subscribed, value in self._values.items():
            if name.startswith(f"{subscribed}/"):
                return True, _below(value, name[len(subscribed) + 1 :].split("/"))
        return False, None


def _with(tree: Any, path: list[str], value: Any) -> Any:
    """The tree with another value at that place."""
    branch = dict(tree) if isinstance(tree, dict) else {}
    if len(path) > 1:
        branch[path[0]] = _with(branch.get(path[0]), path[1:], value)
    elif value == {}:
        branch.pop(path[0], None)
    else:
        branch[path[0]] = value
    return branch


def _below(tree: Any, path: list[str]) -> Any:
    for part in path:
        tree = tree.get(part) if isinstance(tree, dict) else None
    return tree
