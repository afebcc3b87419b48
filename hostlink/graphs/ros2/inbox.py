"""Inbox: what rclpy's thread receives, for one reader in the event loop. Bounded: the oldest goes, and is counted."""

import asyncio
import threading
from collections import deque
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Inbox(Generic[Item]):
    """`put` is called in any thread; iterate with `async for` in the loop in which it was made."""

    def __init__(self, depth: int) -> None:
        self.dropped = 0
        self._loop = asyncio.get_running_loop()
        self._items: deque[Item] = deque(maxlen=depth)
        self._news = asyncio.Event()
        self._lock = threading.Lock()
        self._is_waking = False  # the loop's own queue has no bound, so it holds one call of each inbox

    def put(self, item: Item) -> None:
        """Add an item, unless the loop has ended."""
        with self._lock:
            self.dropped += len(self._items) == self._items.maxlen
            self._items.append(item)
            if self._is_waking or self._loop.is_closed():
                return
            self._is_waking = True
        self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        with self._lock:
            self._is_waking = False
        self._news.set()

    def __aiter__(self) -> "Inbox[Item]":
        return self

    async def __anext__(self) -> Item:
        while True:
            with self._lock:
                if self._items:
                    return self._items.popleft()
                self._news.clear()
            await self._news.wait()
