"""Waiting for what another task does, without knowing how long it takes; a wait that fails reports what it last saw."""

import ast
import asyncio
import inspect
import linecache
from collections.abc import Awaitable, Callable
from types import CodeType, FunctionType
from typing import TypeGuard

from _pytest.assertion.rewrite import rewrite_asserts

TIMEOUT_S = 90.0  # for what only a defect prevents: a busy machine must not reach it
POLL_S = 0.005


async def expect(is_so: Callable[[], object], *, timeout_s: float = TIMEOUT_S) -> None:
    """Return as soon as `is_so()` is true. A LookupError or an error of hostlink counts as not yet.

    Raises:
        AssertionError: it was not true in time; with the condition, its last value and its last error.
    """
    if not await is_true_within(is_so, timeout_s):
        raise AssertionError(f"not within {timeout_s:g} s: {described(is_so)}")


async def expect_never(is_so: Callable[[], object], *, for_s: float) -> None:
    """Return after `for_s` in which `is_so()` was never true.

    Raises:
        AssertionError: it was true; with the condition.
    """
    if await is_true_within(is_so, for_s):
        raise AssertionError(f"within {for_s:g} s: {_text(is_so)}")


async def is_soon(measure: Callable[[], Awaitable[float]], limit: float) -> bool:
    """Whether one of a few measurements stays below the limit: other tests may use the processor at the same time."""
    for _ in range(3):
        if await measure() < limit:
            return True
    return False


def described(is_so: Callable[[], object]) -> str:
    """The condition's source, and what it is now: its error, its value, or the parts of its comparison."""
    text = _text(is_so)
    try:
        value = is_so()
    except Exception as error:  # noqa: BLE001 - it is reported
        return f"{text}\n  last error: {type(error).__name__}: {error}"
    return f"{text}\n  last value: {_parts(is_so, text) or repr(value)}"


async def is_true_within(is_so: Callable[[], object], timeout_s: float) -> bool:
    """Return whether `is_so()` becomes true within `timeout_s` seconds."""
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + timeout_s
    while not _is_true(is_so):
        if loop.time() >= deadline_s:
            return False
        await asyncio.sleep(POLL_S)
    return True


def _is_true(is_so: Callable[[], object]) -> bool:
    try:
        return bool(is_so())
    except LookupError:
        return False
    except Exception as error:
        if type(error).__module__ != "hostlink.errors":
            raise
        return False


def _text(is_so: Callable[[], object]) -> str:
    return _source(is_so.__code__) if _is_lambda(is_so) else getattr(is_so, "__qualname__", repr(is_so))


def _is_lambda(is_so: Callable[[], object]) -> TypeGuard[FunctionType]:
    return inspect.isfunction(is_so) and is_so.__name__ == "<lambda>"


def _source(code: CodeType) -> str:
    """Return the source text after `lambda:`, from the positions of its instructions."""
    first, last = (1 << 31, 0), (0, 0)
    for begin, end, column, end_column in code.co_positions():
        if begin and end and column and end_column:  # the first instruction has no columns
            first, last = min(first, (begin, column)), max(last, (end, end_column))
    lines = [linecache.getline(code.co_filename, number).encode() for number in range(first[0], last[0] + 1)]
    lines[-1] = lines[-1][: last[1]]
    lines[0] = lines[0][first[1] :]
    return " ".join(line.decode().strip() for line in lines)


def _parts(is_so: Callable[[], object], text: str) -> str:
    """The values in the condition, as pytest shows those of an assertion; empty where they cannot be read."""
    if not _is_lambda(is_so):
        return ""
    try:
        tree = ast.parse(f"assert ({text})")
    except SyntaxError:  # the file has changed since it was imported
        return ""
    rewrite_asserts(tree, b"")
    known = inspect.getclosurevars(is_so)
    try:
        exec(compile(tree, "<condition>", "exec"), {**known.builtins, **known.globals, **known.nonlocals})  # noqa: S102
    except AssertionError as error:
        return str(error).removeprefix("assert ")
    except Exception:  # noqa: BLE001 - a name of an inner lambda: the plain value is reported
        return ""
    return ""
