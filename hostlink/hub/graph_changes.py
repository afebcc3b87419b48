"""GraphChanges: who wants to know that topics, services or robots have changed."""

import asyncio
from collections.abc import Callable, Hashable

NOTIFY_AFTER_S = 0.05  # a device that comes changes twenty topics; they are one change


class GraphChanges:
    """Watchers are called soon after a change, once for all changes until then."""

    def __init__(self) -> None:
        self._watchers: dict[Hashable, Callable[[], None]] = {}
        self._is_due = False

    def watch(self, key: Hashable, on_change: Callable[[], None]) -> None:
        """Call `on_change` soon, and after every change, until `unwatch`; a key has one watcher."""
        self._watchers[key] = on_change
        self.note()

    def unwatch(self, key: Hashable) -> None:
        """It may watch no more already."""
        self._watchers.pop(key, None)

    def note(self) -> None:
        """Something has changed."""
        if self._watchers and not self._is_due:
            self._is_due = True
            asyncio.get_running_loop().call_later(NOTIFY_AFTER_S, self._notify)

    def _notify(self) -> None:
        self._is_due = False
        for on_change in tuple(self._watchers.values()):
            on_change()
