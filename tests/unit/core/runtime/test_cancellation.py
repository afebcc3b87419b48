"""Cancellation at the same time as a child's error."""

import ast
import asyncio
import sys
from pathlib import Path

import pytest

from hostlink.core.runtime.cancellation import raise_if_cancelled

ROOT = Path(__file__).parents[4]


async def fail() -> None:
    raise ConnectionResetError("the child's")


async def work(*, checks_for_cancellation: bool) -> str:
    try:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(fail())
            await asyncio.sleep(10)
    except* OSError:
        pass
    if checks_for_cancellation:
        raise_if_cancelled()
    return "went on"


@pytest.mark.parametrize("is_cancelled", [False, True])
async def test_cancellation_during_a_child_error_ends_the_task(*, is_cancelled: bool) -> None:
    task = asyncio.get_running_loop().create_task(work(checks_for_cancellation=True))
    await asyncio.sleep(0)  # the group waits, and its child has not started
    if is_cancelled:
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    else:
        assert await task == "went on"


async def test_task_continues_without_raise_if_cancelled_before_python_3_13() -> None:
    """Check asyncio's behaviour, which is why the function exists."""
    task = asyncio.get_running_loop().create_task(work(checks_for_cancellation=False))
    await asyncio.sleep(0)
    task.cancel()
    (outcome,) = await asyncio.gather(task, return_exceptions=True)  # noqa: TID251 - not a task of the project's
    assert isinstance(outcome, asyncio.CancelledError) if sys.version_info >= (3, 13) else outcome == "went on"


def raised_in_except_star(tree: ast.AST) -> list[int]:
    """Return the lines on which an `except*` block raises by itself, or calls a function that does."""
    blocks = [block for node in ast.walk(tree) if isinstance(node, ast.TryStar) for block in node.handlers]
    return [
        node.lineno
        for block in blocks
        for node in ast.walk(block)
        if isinstance(node, ast.Raise) or (isinstance(node, ast.Name) and node.id == raise_if_cancelled.__name__)
    ]


def test_except_star_blocks_raise_nothing() -> None:
    """Before Python 3.11.4 the exception would leave the block in an exception group."""
    code = [path for folder in ("hostlink", "tests", "tools") for path in (ROOT / folder).rglob("*.py")]
    with_blocks = {path: text for path in code if "except*" in (text := path.read_text())}
    assert ROOT / "hostlink/core/link/serving.py" in with_blocks
    assert {str(path): raised_in_except_star(ast.parse(text)) for path, text in with_blocks.items()} == {
        str(path): [] for path in with_blocks
    }
    wrong = "try:\n  f()\nexcept* OSError:\n  raise_if_cancelled()\n  raise KeyError\nraise_if_cancelled()"
    assert raised_in_except_star(ast.parse(wrong)) == [5, 4]
