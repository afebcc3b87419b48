"""Tasks for the length of a block, cancellation hidden by `except*`, and timeouts that can be ended early."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Coroutine
from typing import Any, TypeVar

Result = TypeVar("Result")


@contextlib.asynccontextmanager
async def meanwhile(*work: tuple[str, Coroutine[Any, Any, object]]) -> AsyncIterator[None]:
    """Run coroutines, each with the name of its task, for the length of the block; then cancel them.

    An error of one cancels the others and the block, and is raised in an exception group.
    """
    async with asyncio.TaskGroup() as tasks:
        running = [tasks.create_task(coroutine, name=name) for name, coroutine in work]
        try:
            yield
        finally:
            for task in running:
                task.cancel()


def first_error(error: BaseException) -> BaseException:
    """Return the first error in nested exception groups: the cause, from which the others follow."""
    return first_error(error.exceptions[0]) if isinstance(error, BaseExceptionGroup) else error


def raise_if_cancelled() -> None:
    """Raise the cancellation that an `except*` block hides, or that a library has dropped. Call it after the block.

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
