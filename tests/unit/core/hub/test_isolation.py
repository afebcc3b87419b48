"""Isolation: a crash is counted, logged and kept from those around it."""

import asyncio
import inspect
from functools import partial
from typing import Any

import pytest
from structlog.testing import capture_logs

from hostlink.core.hub import isolation
from hostlink.core.hub.isolation import Isolation
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.virtual_loop import inside


def test_crash_is_counted_and_logged_and_not_raised() -> None:
    made = Isolation()
    with capture_logs() as logs, made.around("robot", robot="robot_0"):
        raise ZeroDivisionError
    assert made.crashes == {"robot": 1}
    assert [(each["event"], each["robot"], each["log_level"]) for each in logs] == [
        ("robot.crashed", "robot_0", "error")
    ]


def test_crash_is_raised_again_where_tests_want_it() -> None:
    made = Isolation(reraises=True)
    with capture_logs(), pytest.raises(ZeroDivisionError), made.around("robot"):
        raise ZeroDivisionError
    assert made.crashes == {"robot": 1}


def test_crash_whose_traceback_cannot_be_logged_is_logged_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[dict[str, Any]] = []

    class Log:
        def error(self, event: str, **facts: Any) -> None:
            if "exc_info" in facts:
                raise MemoryError
            lines.append({"event": event, **facts})

    monkeypatch.setattr(isolation, "log", Log())
    Isolation().crashed("link", ValueError("x"), link=3)
    assert lines == [{"event": "link.crashed", "cause": "ValueError('x')", "link": 3}]


@inside(in_hub, reraises=False)
async def test_task_that_crashes_ends_nothing_else(made: MemoryHub) -> None:
    async def crash() -> None:
        raise ZeroDivisionError

    async def work() -> None:
        await asyncio.sleep(1.0)
        done.append("done")

    done: list[str] = []
    made.hub.spawn(work(), name="work")
    made.hub.spawn(crash(), name="broken")
    await asyncio.sleep(2.0)
    assert done == ["done"]
    assert made.hub.isolation.crashes == {"task": 1}
    assert [each["task"] for each in made.logged("task.crashed")] == ["broken"]


def test_work_that_is_spawned_in_the_last_turn_of_the_hub_is_closed() -> None:
    async def never() -> None:
        raise AssertionError("the hub has ended")

    work = never()

    async def test(made: MemoryHub) -> None:
        asyncio.get_running_loop().call_soon(partial(made.hub.spawn, work, name="too late"))

    in_hub(test)
    assert inspect.getcoroutinestate(work) == inspect.CORO_CLOSED


def test_work_that_is_spawned_while_the_hub_ends_is_not_begun() -> None:
    """A link that ends with the hub may spawn work: its board leaves a robot."""
    began: list[str] = []

    async def late() -> None:
        began.append("late")

    async def until_the_end(made: MemoryHub) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            made.hub.spawn(work, name="late")

    async def test(made: MemoryHub) -> None:
        made.hub.spawn(until_the_end(made), name="last")
        await asyncio.sleep(0.1)

    work = late()
    in_hub(test)
    assert began == []
    assert inspect.getcoroutinestate(work) == inspect.CORO_CLOSED
