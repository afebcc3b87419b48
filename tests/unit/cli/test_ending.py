"""A signal that arrives before the daemon has started, and one after it."""

import asyncio
import contextlib
from collections.abc import Iterator

import pytest

from hostlink.cli import ending as module
from hostlink.cli.ending import Ending


@pytest.fixture(autouse=True)
def forced(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """Time limits that were set; the real one would end this process."""
    seconds: list[float] = []
    monkeypatch.setattr(module, "_force_after", lambda limit_s, _: seconds.append(limit_s))
    return iter([seconds])


async def wait_long(ending: Ending, *, is_started: bool) -> str:
    loop = asyncio.get_running_loop()
    with ending.at_start():
        if is_started:
            ending.note_started()
        loop.call_soon(ending.request, "SIGTERM")
        await asyncio.sleep(0.2 if is_started else 60.0)
        return "started"
    return "ended at its start"


@pytest.mark.parametrize(("is_started", "end"), [(False, "ended at its start"), (True, "started")])
def test_signal_ends_a_start_that_takes_long_and_lets_a_daemon_stop_its_robots(is_started: bool, end: str) -> None:
    async def run() -> tuple[str, str, int]:
        ending, task = Ending(), asyncio.current_task()
        assert task is not None
        return await wait_long(ending, is_started=is_started), ending.cause, task.cancelling()

    assert asyncio.run(run()) == (end, "SIGTERM", 0)


def test_cancellation_by_another_passes() -> None:
    async def run() -> None:
        with Ending().at_start():
            await asyncio.sleep(60.0)

    async def cancel() -> bool:
        async with asyncio.TaskGroup() as tasks:
            task = tasks.create_task(run())
            await asyncio.sleep(0)
            task.cancel()
        return task.cancelled()

    assert asyncio.run(cancel())


def test_forced_end_names_the_tasks_that_ignore_their_cancellation(monkeypatch: pytest.MonkeyPatch) -> None:
    causes: list[str] = []
    monkeypatch.setattr(module, "_force", causes.append)

    async def ignore() -> None:
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(60.0)
        module._force_late("the end lasted longer than 8 s", asyncio.get_running_loop())

    async def run() -> None:
        async with asyncio.TaskGroup() as tasks:
            task = tasks.create_task(ignore(), name="attack: work")
            await asyncio.sleep(0)
            task.cancel()

    asyncio.run(run())
    assert causes == ["the end lasted longer than 8 s; these tasks ignored it: attack: work"]
