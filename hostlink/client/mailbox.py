"""Mailbox: bounded queue of one reader, as an asynchronous iterator. The oldest item is dropped and counted."""

import asyncio
from collections.abc import Callable
from typing import Generic, TypeVar

from hostlink.errors import HostlinkError

MAX_ITEMS = 256

Item = TypeVar("Item")


class Mailbox(Generic[Item]):
    """Iterate over it with `async for`; `dropped` counts what the reader was too slow for."""

    def __init__(self, name: str = "", on_read: Callable[[], None] = lambda: None) -> None:
        """`name`: of the content, for people. `on_read` is called when the reader asks, and when it gets an item."""
        self.name = name
        self._on_read = on_read
        self.dropped = 0
        self._queue: asyncio.Queue[Item | HostlinkError] = asyncio.Queue(MAX_ITEMS)

    def put(self, item: Item | HostlinkError) -> None:
        """Add an item, or the error that ends the iteration."""
        if self._queue.full():
            self._queue.get_nowait()
            self.dropped += 1
        self._queue.put_nowait(item)

    def pop_all(self) -> list[Item]:
        """Return the items that have arrived, without waiting.

        Raises:
            HostlinkError: the error that ends the iteration is among it.
        """
        self._on_read()
        found: list[Item] = []
        while not self._queue.empty():
            item = self._queue.get_nowait()
            if isinstance(item, HostlinkError):
                raise item
            found.append(item)
        return found

    def __repr__(self) -> str:
        return f"<Mailbox of {self.name or 'messages'}: {self._queue.qsize()} waiting, {self.dropped} dropped>"

    def __aiter__(self) -> "Mailbox[Item]":
        return self

    async def __anext__(self) -> Item:
        self._on_read()
        item = await self._queue.get()
        self._on_read()
        if isinstance(item, HostlinkError):
            raise item
        return item
