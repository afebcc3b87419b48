"""GraphChanges: which watchers are called after a change, when, and with which changes."""

import asyncio
import time

import pytest

from hostlink.core.config import Config
from hostlink.core.hub.graph_changes import LATEST_S, MAX_KEPT, NOTIFY_AFTER_S, SHARE, GraphChanges, GraphKind
from hostlink.core.hub.hub import Hub
from tests.support.fake_device import CATALOG
from tests.support.virtual_loop import VirtualLoop, run_virtual, virtual


def loop() -> VirtualLoop:
    running = asyncio.get_running_loop()
    assert isinstance(running, VirtualLoop)
    return running


@virtual
async def test_each_watcher_is_called_in_a_turn_of_its_own_once_for_all_changes() -> None:
    changes, called, longest_s = GraphChanges(loop().time), [], 0.0

    def watcher(number: int) -> None:
        called.append(number)
        loop().burn(0.001)

    for number in range(20):
        changes.watch(number, lambda number=number: watcher(number))  # type: ignore[misc]
    for number in range(100):
        changes.note(GraphKind.TOPIC, f"/{number}")
    await asyncio.sleep(NOTIFY_AFTER_S)
    while len(called) < 20:
        before_s = loop().time()
        await asyncio.sleep(0)
        longest_s = max(longest_s, loop().time() - before_s)
    assert called == list(range(20))
    assert longest_s <= 0.0011


def test_watchers_that_cost_much_are_called_less_often_and_leave_most_of_the_loop() -> None:
    async def run(cost_s: float) -> float:
        changes, spent_s = GraphChanges(loop().time), 0.0

        def watcher() -> None:
            nonlocal spent_s
            spent_s += cost_s
            loop().burn(cost_s)

        changes.watch("watcher", watcher)
        while loop().time() < 10.0:
            changes.note(GraphKind.ROBOT, "r")
            await asyncio.sleep(0.01)
        return spent_s / 10.0

    assert run_virtual(run(0.04)) <= SHARE * 1.1
    assert run_virtual(run(0.001)) > 0.01  # each 50 ms
    assert run_virtual(run(1.0)) > 1 / (1 + LATEST_S) - 0.1  # no watcher waits without end


@virtual
async def test_watchers_of_a_slow_machine_are_called_no_later_in_virtual_time() -> None:
    changes, called_at_s = Hub(Config(), CATALOG).changes, []

    def watcher() -> None:
        called_at_s.append(loop().time())
        until_s = time.thread_time() + 10 * NOTIFY_AFTER_S * SHARE
        while time.thread_time() < until_s:
            pass

    changes.watch("watcher", watcher)
    await asyncio.sleep(NOTIFY_AFTER_S)
    changes.note(GraphKind.TOPIC, "/a")
    await asyncio.sleep(2 * LATEST_S)
    assert called_at_s == pytest.approx([NOTIFY_AFTER_S, 2 * NOTIFY_AFTER_S])


def test_changes_are_kept_by_name_newest_first_up_to_a_bound() -> None:
    changes = GraphChanges()
    before = changes.version
    changes.note(GraphKind.TOPIC, "/a")
    changes.note(GraphKind.SERVICE, "/a")
    changes.note(GraphKind.TOPIC, "/b")
    changes.note(GraphKind.TOPIC, "/a")
    assert changes.since(before) == [(GraphKind.TOPIC, "/a"), (GraphKind.TOPIC, "/b"), (GraphKind.SERVICE, "/a")]
    assert changes.since(changes.version) == []
    for number in range(MAX_KEPT):
        changes.note(GraphKind.TOPIC, f"/{number}")
    assert changes.since(before) is None
    assert len(changes.since(changes.version - 5) or []) == 5
