"""What `except*` around a task group hides, and time-outs that end before their time."""

import asyncio


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
