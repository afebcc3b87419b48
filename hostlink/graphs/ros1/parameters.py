"""MasterParameters: the parameters of the master, for devices that request them."""

import asyncio
import contextlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from hostlink.config import ParameterValue
from hostlink.graphs.ros1.names import Names
from hostlink.graphs.ros1.parts import Parts
from hostlink.graphs.ros1.xml_rpc import Refused, Unreachable
from hostlink.logs import printable

SIM_TIME = "/use_sim_time"
PATIENCE_S = 0.5  # a device waits for a second, and does nothing else
MAX_KEYS = 256  # devices may request any names
MAX_ITEMS = 1024  # values below one key; rosserial's own parameters are a few numbers
MAX_CHARS = 65536  # of texts, keys included, below one key
MAX_PARTS = 64  # of the name of a parameter
_TOO_LARGE = object()  # somebody has set what no device can receive; it is not kept


class ParameterCache:
    """Parameters of the master that this node has subscribed to, and their updates.

    Values by the key that was subscribed to; one that is not set is None. Of too many the oldest goes.

    Whoever reaches the slave API can send updates, so what is below one key has a bound. Over it the key reads as not
    set, and parameters below it as unknown: each can be subscribed to by itself.
    """

    def __init__(self) -> None:
        self._values: OrderedDict[str, Any] = OrderedDict()

    @property
    def keys(self) -> tuple[str, ...]:
        """All that are subscribed to."""
        return tuple(self._values)

    def put(self, key: str, value: Any) -> str | None:
        """The master has answered a subscription; returns the key that has to go, if there are too many."""
        self._values[key] = _kept(value)
        self._values.move_to_end(key)
        return self._values.popitem(last=False)[0] if len(self._values) > MAX_KEYS else None

    def clear(self) -> None:
        """The master has forgotten the subscriptions."""
        self._values.clear()

    def update(self, key: str, value: Any) -> None:
        """The master reports a change, of a key or of something below it; {} is a parameter that was deleted."""
        key = key.rstrip("/")
        for subscribed in self._values:
            if key == subscribed:
                self._values[subscribed] = _kept(value)
            elif key.startswith(f"{subscribed}/") and self._values[subscribed] is not _TOO_LARGE:
                path = key[len(subscribed) + 1 :].split("/", MAX_PARTS)
                is_deep = len(path) > MAX_PARTS
                before = self._values[subscribed]
                self._values[subscribed] = _TOO_LARGE if is_deep else _kept(_with(before, path, value))

    def find(self, name: str) -> tuple[bool, Any]:
        """(whether it is known, its value; None: it is not set)."""
        if name in self._values:
            value = self._values[name]
            return True, None if value is _TOO_LARGE else value
        for subscribed, value in self._values.items():
            if name.startswith(f"{subscribed}/") and value is not _TOO_LARGE:
                return True, _below(value, name[len(subscribed) + 1 :].split("/"))
        return False, None


def _kept(value: Any) -> Any:
    return None if value == {} else value if _is_small(value) else _TOO_LARGE


def _is_small(value: Any) -> bool:
    """Whether it is within the bounds; it may be nested as deep as it likes."""
    items, chars, waiting = 0, 0, [value]
    while waiting and items + len(waiting) <= MAX_ITEMS and chars <= MAX_CHARS:
        each = waiting.pop()
        items += 1
        if isinstance(each, dict):
            chars += sum(map(len, each))
            waiting += each.values()
        elif isinstance(each, list):
            waiting += each
        elif isinstance(each, str | bytes):
            chars += len(each)
    return not waiting and chars <= MAX_CHARS


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


class MasterParameters:
    """What has been requested once is subscribed to, and answered at once from then on, also without the master."""

    def __init__(self, parts: Parts, names: Names, on_change: Callable[[], None]) -> None:
        self._parts, self._names, self._on_change = parts, names, on_change
        self._cache = ParameterCache()

    @property
    def is_sim_time(self) -> bool:
        """Whether the time is that of /clock; `rosparam set /use_sim_time 1` means it, too."""
        value = self._cache.find(SIM_TIME)[1]
        return isinstance(value, int) and bool(value)

    async def get(self, name: str) -> ParameterValue | None:
        """The parameter that a device names so; None: there is none, or none that a device can receive."""
        key = self._names.resolve(name)
        is_known, value = self._cache.find(key)
        if not is_known:
            try:
                async with asyncio.timeout(PATIENCE_S):
                    value = await self._subscribe(key)
            except (TimeoutError, Unreachable, Refused):
                return None
        usable = _usable(value)
        if usable is None and value is not None:
            kind = type(value).__name__
            self._parts.log_once("ros1.parameter_unusable", name=printable(key), kind=kind)
        return usable

    def update(self, key: str, value: Any) -> None:
        """The master reports a change."""
        self._cache.update(key, value)
        self._on_change()

    async def renew(self) -> None:
        """Subscribe again to all that was, and to what every node needs; another master knows nothing of it.

        Raises:
            Unreachable: the master does not answer.
        """
        for key in dict.fromkeys((SIM_TIME, self._names.node, *self._cache.keys)):
            await self._subscribe(key)
        self._on_change()

    async def end(self) -> None:
        """Subscribe to none any more: the master would keep the node for them.

        Raises:
            Unreachable: the master does not answer.
        """
        for key in self._cache.keys:
            with contextlib.suppress(Refused):
                await self._parts.master.call("unsubscribeParam", self._parts.uri, key)

    async def _subscribe(self, key: str) -> Any:
        value = await self._parts.master.call("subscribeParam", self._parts.uri, key)
        oldest = self._cache.put(key, value)
        if oldest is not None:
            await self._parts.master.call("unsubscribeParam", self._parts.uri, oldest)
        return self._cache.find(key)[1]


def _usable(value: Any) -> ParameterValue | None:
    """What rosserial has a form for: numbers, texts, lists of one of them."""
    items = value if isinstance(value, list) else [value]
    return value if all(isinstance(item, bool | int | float | str) for item in items) else None
