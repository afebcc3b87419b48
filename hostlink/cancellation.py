"""What `except*` around a task group hides."""

import asyncio


def raise_if_cancelled() -> None:
    """Call it where `except*` has caught an error of a task group: a cancellation at the same time is not in the group.

    Raises:
        asyncio.CancelledError: this task is being cancelled.
    """
    task = asyncio.current_task()
    if task is not None and task.cancelling():
        raise asyncio.CancelledError
