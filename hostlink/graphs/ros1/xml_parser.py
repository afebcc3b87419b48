"""XmlParser: parses large bodies beside the event loop, so that no stop waits for them."""

import asyncio
from collections.abc import Callable
from typing import TypeVar

Parsed = TypeVar("Parsed")

THREAD_BYTES = 16 * 1024  # a body of so much takes a millisecond


class XmlParser:
    """One large body at a time: a second thread would only take the interpreter from the loop."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()

    async def parse(self, decode: Callable[[bytes], Parsed], body: bytes) -> Parsed:
        """What `decode` returns; raises what it raises."""
        if len(body) <= THREAD_BYTES:
            return decode(body)
        async with self._turn:
            return await asyncio.to_thread(decode, body)
