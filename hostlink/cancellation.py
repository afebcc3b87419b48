"""Cancellation hidden by `except*`, and timeouts that can be ended early."""

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

Result = TypeVar("Result")


def raise_if_cancelled() -> None:
    """Raise the cancellation that an `except*` block hides. Call it after the block.

    Never call it in the block: before Python 3.11.4 the exception would leave the block in an exception group.

    Raises:
        asyncio.CancelledError: this task is being cancelled.
    """
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


async def within(timeout_s: float | None, work: Awaitable[Result], timeouts: set[asyncio.Timeout]) -> Result:
    """Await work that may last `timeout_s`. Its timeout is in `timeouts` meanwhile, so that `expire` ends it early.

    Raises:
        TimeoutError: the timeout has expired.
    """
    async with asyncio.timeout(timeout_s) as timeout:
        timeouts.add(timeout)
        try:
            return await work
        finally:
            timeouts.discard(timeout)


def expire(timeout: asyncio.Timeout) -> None:
    """Expire a timeout now, unless it has expired already."""
    if not timeout.expired():
        timeout.reschedule(asyncio.get_running_loop().time())
