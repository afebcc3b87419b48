"""Mailbox: bounded queue of one reader, as an asynchronous iterator. The oldest item is dropped and counted."""

import asyncio
from typing import Generic, TypeVar

from hostlink.errors import HostlinkError

MAX_ITEMS = 256

Item = TypeVar("Item")


class Mailbox(Generic[Item]):
    """Iterate over it with `async for`; `dropped` counts what the reader was too slow for."""

    def __init__(self, name: str = "") -> None:
        """`name`: of the content, for people."""
        self.name = name
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
        item = await self._queue.get()
        if isinstance(item, HostlinkError):
            raise item
        return item
