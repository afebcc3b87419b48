"""MasterParameters: the parameters of the master, for devices that request them."""

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

from hostlink.config import ParameterValue
from hostlink.graphs.ros1.names import Names
from hostlink.graphs.ros1.parameter_cache import ParameterCache
from hostlink.graphs.ros1.parts import Parts
from hostlink.graphs.ros1.xml_rpc import Refused, Unreachable
from hostlink.logs import printable

SIM_TIME = "/use_sim_time"
PATIENCE_S = 0.5  # a device waits for a second, and does nothing else


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
