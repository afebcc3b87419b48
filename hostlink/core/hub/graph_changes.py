"""GraphChanges: log of changes of topics, services and robots, and the watchers that are notified of them."""

import asyncio
from collections.abc import Callable, Hashable
from enum import Enum

from hostlink.core.runtime.loop_time import loop_time_s

NOTIFY_AFTER_S = 0.05  # a device that connects changes twenty topics, which are one notification
SHARE = 0.1  # of the loop for all watchers: expensive ones are called less often
LATEST_S = 0.5  # longest delay, independent of their cost
MAX_KEPT = 1024  # changed names; a reader that missed more reads the whole graph


class GraphKind(Enum):
    """Kind of a name in the graph."""

    TOPIC = "topic"
    SERVICE = "service"
    ROBOT = "robot"


class GraphChanges:
    """Log of changes. Watchers are called soon after a change, once for several, each in a turn of its own."""

    def __init__(self, computed_s: Callable[[], float] = loop_time_s) -> None:
        """`computed_s` returns for how long this thread has computed so far: the difference is what a watcher costs."""
        self._computed_s = computed_s
        self.version = 0  # grows with each change
        self._kept: dict[tuple[GraphKind, str], int] = {}  # version of each name's last change, oldest first
        self._forgotten = 0  # version of the newest change that is not kept
        self._watchers: dict[Hashable, Callable[[], None]] = {}
        self._due: dict[Hashable, None] = {}  # watchers to call in this round
        self._is_expected = False
        self._spent_s = 0.0  # in the last round

    def watch(self, key: Hashable, on_change: Callable[[], None]) -> None:
        """Call `on_change` soon, and after every change, until `unwatch`; a key has one watcher."""
        self._watchers[key] = on_change
        self._expect()

    def unwatch(self, key: Hashable) -> None:
        """Remove the watcher of a key. Do nothing if it has none."""
        self._watchers.pop(key, None)

    def note(self, kind: GraphKind, name: str) -> None:
        """Note that something of this name was added, changed or removed."""
        self.version += 1
        self._kept.pop((kind, name), None)
        self._kept[kind, name] = self.version
        if len(self._kept) > MAX_KEPT:
            self._forgotten = self._kept.pop(next(iter(self._kept)))
        self._expect()

    def since(self, version: int) -> list[tuple[GraphKind, str]] | None:
        """Return the changes after a version, newest first; None if there were more than MAX_KEPT."""
        if version < self._forgotten:
            return None
        found = []
        for key in reversed(self._kept):
            if self._kept[key] <= version:
                break
            found.append(key)
        return found

    def _expect(self) -> None:
        if self._watchers and not self._is_expected:
            self._is_expected = True
            pause_s = min(LATEST_S, self._spent_s / SHARE)
            asyncio.get_running_loop().call_later(max(NOTIFY_AFTER_S, pause_s), self._notify)

    def _notify(self) -> None:
        self._is_expected, self._spent_s = False, 0.0
        is_calling = bool(self._due)
        self._due |= dict.fromkeys(self._watchers)
        if not is_calling:
            self._call_next()

    def _call_next(self) -> None:
        key = next(iter(self._due), None)
        if key is None:
            return
        del self._due[key]
        on_change = self._watchers.get(key)
        if self._due:
            asyncio.get_running_loop().call_soon(self._call_next)
        if on_change is not None:
            began_s = self._computed_s()
            on_change()
            self._spent_s += self._computed_s() - began_s
