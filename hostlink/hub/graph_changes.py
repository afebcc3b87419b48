"""GraphChanges: what has changed in the graph, and who wants to know that topics, services or robots have changed."""

import asyncio
import time
from collections.abc import Callable, Hashable
from enum import Enum

NOTIFY_AFTER_S = 0.05  # a device that comes changes twenty topics; they are one change
SHARE = 0.1  # of the loop, for all watchers: what costs more is called less often
LATEST_S = 0.5  # however much they cost
MAX_KEPT = 1024  # names that have changed; who has not read more than that begins anew


class GraphKind(Enum):
    """Of what has a name in the graph."""

    TOPIC = "topic"
    SERVICE = "service"
    ROBOT = "robot"


class GraphChanges:
    """Watchers are called soon after a change, once for all changes until then, each in a turn of its own."""

    def __init__(self, computed_s: Callable[[], float] = time.thread_time) -> None:
        """`computed_s`: how long this thread has computed; that it waited for a core is no watcher's fault."""
        self._computed_s = computed_s
        self.version = 0  # grows with each change
        self._kept: dict[tuple[GraphKind, str], int] = {}  # the version in which each changed last, oldest first
        self._forgotten = 0  # the version of the newest change that is not kept
        self._watchers: dict[Hashable, Callable[[], None]] = {}
        self._due: dict[Hashable, None] = {}  # watchers that are to be called in this round
        self._is_expected = False
        self._spent_s = 0.0  # in the last round

    def watch(self, key: Hashable, on_change: Callable[[], None]) -> None:
        """Call `on_change` soon, and after every change, until `unwatch`; a key has one watcher."""
        self._watchers[key] = on_change
        self._expect()

    def unwatch(self, key: Hashable) -> None:
        """End the watching of a key; one that watches nothing is no error."""
        self._watchers.pop(key, None)

    def note(self, kind: GraphKind, name: str) -> None:
        """Something of this name has changed, has come or has gone."""
        self.version += 1
        self._kept.pop((kind, name), None)
        self._kept[kind, name] = self.version
        if len(self._kept) > MAX_KEPT:
            self._forgotten = self._kept.pop(next(iter(self._kept)))
        self._expect()

    def since(self, version: int) -> list[tuple[GraphKind, str]] | None:
        """What has changed after this version; None: too much."""
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
