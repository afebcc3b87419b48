"""What `except*` around a task group hides, and time-outs that end before their time, or are set very often."""

import asyncio
import contextlib
from collections.abc import AsyncIterator


def raise_if_cancelled() -> None:
    """Call it behind an `except*` that caught an error of a task group: a cancellation at the same time is not in it.

    Never call it in the block: before Python 3.11.4, what is raised there leaves it in an exception group.

    Raises:
        asyncio.CancelledError: this task is being cancelled.
    """
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError


def expire(timeout: asyncio.Timeout) -> None:
    """Let a block under a time-out end now; it may be ending already, in this turn of the loop."""
    if not timeout.expired():
        timeout.reschedule(asyncio.get_running_loop().time())


class Patience:
    """A time limit for each of very many waits in a block: one timer looks whether the latest lasts too long."""

    def __init__(self, timeout: asyncio.Timeout, limit_s: float) -> None:
        self._timeout, self._limit_s = timeout, limit_s
        self._loop = asyncio.get_running_loop()
        self._since_s: float | None = None
        self._timer: asyncio.TimerHandle | None = None

    def begin(self, now_s: float) -> None:
        """A wait begins; without an `end` in time the block is cancelled, and raises TimeoutError."""
        self._since_s = now_s
        if self._timer is None:
            self._timer = self._loop.call_at(now_s + self._limit_s, self._look)

    def end(self) -> None:
        """It is over."""
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
        """Look no more."""
        if self._timer is not None:
            self._timer.cancel()


@contextlib.asynccontextmanager
async def patience(limit_s: float) -> AsyncIterator[Patience]:
    """A block in which no wait may last longer.

    Raises:
        TimeoutError: one did.
    """
    async with asyncio.timeout(None) as timeout:
        made = Patience(timeout, limit_s)
        try:
            yield made
        finally:
            made.close()
