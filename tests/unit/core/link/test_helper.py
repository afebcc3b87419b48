"""Helper: the second task of a link, while its device is behind."""

import asyncio
import contextvars
from contextlib import nullcontext

import pytest

from hostlink.core.link.serving import Helper
from tests.support.virtual_loop import run_virtual, virtual


class Works:
    """Work for a helper, and what was started."""

    def __init__(self) -> None:
        self.started: list[str] = []

    async def short(self) -> None:
        self.started.append("short")

    async def endless(self) -> None:
        self.started.append("endless")
        await asyncio.Event().wait()

    async def broken(self) -> None:
        raise ConnectionResetError


@virtual
async def test_one_task_works_at_a_time() -> None:
    helper, works, context = Helper("test", lambda _: False), Works(), contextvars.copy_context()
    async with asyncio.TaskGroup() as tasks:
        helper.enter(tasks)
        helper.start(works.endless, context)
        helper.start(works.short, context)
        await asyncio.sleep(1.0)
        helper.enter(None)
        helper.start(works.short, context)
    assert works.started == ["endless"]


@virtual
async def test_task_that_starts_in_the_turn_in_which_one_ended_is_cancelled_at_the_end() -> None:
    helper, works, context = Helper("test", lambda _: False), Works(), contextvars.copy_context()
    async with asyncio.TaskGroup() as tasks:
        helper.enter(tasks)
        helper.start(works.short, context)
        asyncio.get_running_loop().call_soon(helper.start, works.endless, context)
        await asyncio.sleep(1.0)
        helper.enter(None)
    assert works.started == ["short", "endless"]


@pytest.mark.parametrize("is_over", [True, False])
def test_error_of_the_connection_counts_until_the_reason_of_the_end_is_known(*, is_over: bool) -> None:
    async def run() -> None:
        helper, works = Helper("test", lambda _: is_over), Works()
        async with asyncio.TaskGroup() as tasks:
            helper.enter(tasks)
            helper.start(works.broken, contextvars.copy_context())
            await asyncio.sleep(1.0)

    with nullcontext() if is_over else pytest.raises(ExceptionGroup):
        run_virtual(run())
