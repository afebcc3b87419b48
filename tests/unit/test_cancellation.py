"""A cancellation that meets a child's error."""

import asyncio
import sys

import pytest

from hostlink.cancellation import raise_if_cancelled


async def fail() -> None:
    raise ConnectionResetError("the child's")


async def work(*, looks_for_cancellation: bool) -> str:
    try:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(fail())
            await asyncio.sleep(10)
    except* OSError:
        if looks_for_cancellation:
            raise_if_cancelled()
    return "went on"


@pytest.mark.parametrize("is_cancelled", [False, True])
async def test_a_cancellation_beside_an_error_ends_the_task(*, is_cancelled: bool) -> None:
    task = asyncio.get_running_loop().create_task(work(looks_for_cancellation=True))
    await asyncio.sleep(0)  # the group waits, its child has not begun
    if is_cancelled:
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    else:
        assert await task == "went on"


async def test_without_it_the_task_goes_on_before_python_3_13() -> None:
    """What asyncio does: this test says why the function exists."""
    task = asyncio.get_running_loop().create_task(work(looks_for_cancellation=False))
    await asyncio.sleep(0)
    task.cancel()
    (outcome,) = await asyncio.gather(task, return_exceptions=True)  # noqa: TID251 - not a task of the project's
    assert isinstance(outcome, asyncio.CancelledError) if sys.version_info >= (3, 13) else outcome == "went on"
