"""Costly watchers of the graph: the daemon measures them by the CPU time of its thread."""

import asyncio

import pytest

from hostlink.core import running as module
from hostlink.core.hub.graph_changes import LATEST_S, GraphKind
from tests.support.daemon import daemon
from tests.support.waiting import expect


async def test_daemon_calls_watchers_less_often_that_cost_much_of_its_processor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    computed_s = 0.0
    monkeypatch.setattr(module, "thread_time", lambda: computed_s)
    called: list[float] = []

    def watch() -> None:
        nonlocal computed_s
        computed_s += LATEST_S
        called.append(asyncio.get_running_loop().time())

    async with daemon() as host:
        host.hub.changes.watch("watcher", watch)
        await expect(lambda: called)
        host.hub.changes.note(GraphKind.TOPIC, "/a")
        await expect(lambda: len(called) == 2)
    assert called[1] - called[0] >= LATEST_S
