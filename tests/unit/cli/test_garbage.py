"""Garbage collection of the daemon: its times, and the objects that it looks at."""

import asyncio
import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from hostlink.cli import garbage
from hostlink.cli.garbage import CHECK_INTERVAL_S, ENOUGH, REST_S, WHOLE_INTERVAL_S, WORTH, collect_while_idle
from tests.support.virtual_loop import run_virtual

USED = 400_000  # objects that are in use


class Collector:
    """The garbage collector of a process: counts the objects that it looks at."""

    def __init__(self) -> None:
        self.garbage = self.frozen_garbage = self.frozen = 0
        self.alive = USED
        self.looked_at = list[int]()  # by each collection
        self.count = ENOUGH

    def get_count(self) -> tuple[int, int, int]:
        return 0, 0, self.count

    def collect(self) -> int:
        self.looked_at.append(self.alive - self.frozen)
        found, self.garbage = self.garbage, 0
        return found

    def freeze(self) -> None:
        self.frozen, self.frozen_garbage = self.alive, self.frozen_garbage + self.garbage
        self.garbage = 0

    def unfreeze(self) -> None:
        self.garbage += self.frozen_garbage
        self.frozen = self.frozen_garbage = 0


async def run(seconds: float, may_move: Callable[[float], bool]) -> None:
    robots: Any = SimpleNamespace(may_move=may_move)
    async with asyncio.timeout(seconds + CHECK_INTERVAL_S / 2):
        await collect_while_idle(robots)


def collected(
    monkeypatch: pytest.MonkeyPatch,
    collector: Collector,
    seconds: float,
    may_move: Callable[[float], bool] = lambda _: False,
) -> int:
    """Run for so long; returns the number of collections."""
    monkeypatch.setattr(garbage, "gc", collector)
    with pytest.raises(TimeoutError):
        run_virtual(run(seconds, may_move))
    return len(collector.looked_at)


def test_robots_that_leave_no_garbage_are_looked_at_once_in_an_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    collector = Collector()
    seconds = 3 * WHOLE_INTERVAL_S
    assert collected(monkeypatch, collector, seconds) == seconds / CHECK_INTERVAL_S
    assert collector.looked_at.count(USED) == 3
    assert sum(collector.looked_at) == 3 * USED


def test_garbage_of_connections_is_collected_each_second(monkeypatch: pytest.MonkeyPatch) -> None:
    class Storm(Collector):
        def collect(self) -> int:
            found = super().collect()
            self.garbage += WORTH  # until the next collection
            return found

    collector = Storm()
    collector.garbage = WORTH
    collected(monkeypatch, collector, 30.0)
    assert collector.garbage + collector.frozen_garbage == WORTH
    assert collector.looked_at == [USED] * 30


def test_objects_are_not_looked_at_after_a_collection_that_freed_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python collects by itself, too, also while a robot moves."""
    collector = Collector()
    collector.garbage = WORTH
    collected(monkeypatch, collector, CHECK_INTERVAL_S)
    assert collector.frozen == USED


def test_garbage_of_objects_that_were_in_use_is_collected_after_an_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    collector = Collector()
    collected(monkeypatch, collector, 5.0)
    collector.frozen_garbage = WORTH // 2
    collected(monkeypatch, collector, WHOLE_INTERVAL_S)
    assert (collector.garbage, collector.frozen_garbage) == (0, 0)


def test_garbage_of_the_last_connections_is_collected_in_a_daemon_that_does_nothing_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Busy(Collector):
        def get_count(self) -> tuple[int, int, int]:
            return 0, 0, ENOUGH if len(self.looked_at) < 5 else 0

    collector = Busy()
    collector.frozen_garbage = WORTH // 2  # found by the first collection; the fifth leaves some more
    monkeypatch.setattr(collector, "freeze", lambda: setattr(collector, "frozen_garbage", WORTH // 2))
    collected(monkeypatch, collector, 3 * WHOLE_INTERVAL_S)
    assert len(collector.looked_at) == 5 + 1  # the last one looks at all objects, and no other follows
    assert collector.garbage == 0


def test_no_collection_runs_while_a_robot_moves_or_too_few_objects_are_new(monkeypatch: pytest.MonkeyPatch) -> None:
    assert collected(monkeypatch, Collector(), 30.0, lambda _: True) == 0
    collector = Collector()
    collector.count = ENOUGH - 1
    assert collected(monkeypatch, collector, 30.0) == 0


def test_between_two_drives_only_new_objects_are_looked_at_and_after_a_rest_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A stop may come at any time, and names that come and go free much each second."""
    collector, checks = Collector(), itertools.count(1)
    monkeypatch.setattr(collector, "collect", lambda: Collector.collect(collector) + WORTH)
    driving = 26  # the check at which a robot moves for the last time
    collected(monkeypatch, collector, driving + REST_S, lambda _: (check := next(checks)) <= driving and check % 5 == 1)
    assert collector.looked_at[0] == collector.looked_at[-1] == USED
    assert set(collector.looked_at[1:-1]) == {0}
    assert len(collector.looked_at) > driving / 2
