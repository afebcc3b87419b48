"""Waiting for something that another task does, whose duration is not known."""

import asyncio
from collections.abc import Callable

TIMEOUT_S = 5.0
POLL_S = 0.005


async def expect(is_so: Callable[[], object], *, timeout_s: float = TIMEOUT_S) -> None:
    """Return as soon as `is_so()` is true; TimeoutError when it never is. An error of it counts as not yet."""
    async with asyncio.timeout(timeout_s):
        while True:
            try:
                if is_so():
                    return
            except LookupError:
                pass
            except Exception as error:
                if type(error).__module__ != "hostlink.errors":
                    raise
            await asyncio.sleep(POLL_S)
