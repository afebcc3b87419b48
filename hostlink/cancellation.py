"""Cancellation hidden by `except*`, and timeouts that can be ended early or set very often."""

import asyncio
import contextlib
from collections.abc import AsyncIterator


def raise_if_cancelled() -> None:
    """Raise the cancellation that an `except*` block hides. Call it after the block.

    Never call it in the block: before Python 3.11.4 the exception would leave the block in an exception group.

    Raises:
        asyncio.CancelledError: this task is being cancelled.
    """
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def expire(timeout: asyncio.Timeout) -> None:
    """Expire a timeout now, unless it has expired already."""
    if not timeout.expired():
        timeout.reschedule(asyncio.get_running_loop().time())


class Patience:
    """Time limit for each of many waits in a block. One timer checks the latest wait."""

    def __init__(self, timeout: asyncio.Timeout, limit_s: float) -> None:
        self._timeout, self._limit_s = timeout, limit_s
        self._loop = asyncio.get_running_loop()
        self._since_s: float | None = None
        self._timer: asyncio.TimerHandle | None = None

    def begin(self, now_s: float) -> None:
        """Start a wait. Without `end` within the limit the block is cancelled and raises TimeoutError."""
        self._since_s = now_s
        if self._timer is None:
            self._timer = self._loop.call_at(now_s + self._limit_s, self._look)

    def end(self) -> None:
        """End the wait."""
        self._since_s = None

    def _look(self) -> None:
        self._timer = None
        if self._since_s is None:
            return
        due_s = self._since_s + self._limit_s
        if due_s <= self._loop.time():
            expire(self._timeout)
        else:
            self._timer = self._loop.call_at(due_s, self._look)

    def close(self) -> None:
        """Cancel the timer."""
        if self._timer is not None:
            self._timer.cancel()


@contextlib.asynccontextmanager
async def patience(limit_s: float) -> AsyncIterator[Patience]:
    """Run a block in which no wait may last longer than `limit_s`.

    Raises:
        TimeoutError: a wait lasted longer.
    """
    async with asyncio.timeout(None) as timeout:
        made = Patience(timeout, limit_s)
        try:
            yield made
        finally:
            made.close()
