"""Work in the background of a test."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Coroutine


@contextlib.asynccontextmanager
async def meanwhile(work: Coroutine[object, object, object]) -> AsyncIterator[None]:
    """Do it for the length of the block; an error of it ends the block."""
    async with asyncio.TaskGroup() as tasks:
        task = tasks.create_task(work)
        try:
            yield
        finally:
            task.cancel()


@contextlib.asynccontextmanager
async def cancelling() -> AsyncIterator[asyncio.TaskGroup]:
    """A group of tasks. At the end of the block, all tasks of the loop are cancelled: they may wait without end."""
    async with asyncio.TaskGroup() as tasks:
        try:
            yield tasks
        finally:
            for task in asyncio.all_tasks() - {asyncio.current_task()}:
                task.cancel()
