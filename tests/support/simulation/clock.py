"""WorldLoop: virtual time of a daemon's event loop, and of the world outside, which no busy or hung daemon delays."""

import asyncio
import heapq
import itertools
from collections.abc import Callable, Coroutine
from typing import Any

from tests.support.virtual_loop import Deadlock, VirtualLoop

MOST_TURNS = 20_000  # of the loop at one time: it would never end


class NumberedTask(asyncio.Task[Any]):
    """A task whose hash is its number, so that a set of tasks has the same order in each run."""

    _numbers = itertools.count()

    def __init__(self, *given: Any, **named: Any) -> None:
        self._number = next(NumberedTask._numbers)
        super().__init__(*given, **named)

    def __hash__(self) -> int:
        return self._number


class WorldLoop(VirtualLoop):
    """Event loop of the daemon. `at` plans what happens in the world, which has its own exact time, `world_s`.

    While the daemon computes (`burn`), the world continues: what has happened meanwhile happens at its own time, before
    the daemon's next turn. Each turn with work costs `turn_s`.
    """

    def __init__(self, turn_s: float = 0.0) -> None:
        super().__init__()
        self.world_s = 0.0
        self.turn_s = turn_s
        self._planned: list[tuple[float, int, Callable[..., object], tuple[Any, ...]]] = []
        self._order = itertools.count()
        self._turns, self._turned_s = 0, 0.0  # of the loop at the same time
        NumberedTask._numbers = itertools.count()
        self.set_task_factory(_make_task)

    def at(self, when_s: float, act: Callable[..., object], *given: Any) -> None:
        """Call it at this time of the world, or now if that has passed."""
        heapq.heappush(self._planned, (max(when_s, self.world_s), next(self._order), act, given))

    def after(self, wait_s: float, act: Callable[..., object], *given: Any) -> None:
        """Call it after so many seconds of the world."""
        self.at(self.world_s + wait_s, act, *given)

    def select(self, timeout: float | None) -> list[object]:
        """Let the world happen until the daemon has something to do."""
        self._turns = 0 if self._now_s > self._turned_s else self._turns + 1
        self._turned_s = self._now_s
        if self._turns > MOST_TURNS:
            self._turns = 0
            raise Deadlock(f"{MOST_TURNS} turns of the loop at {self._now_s:g} s\n{self._waiting()}")
        if timeout == 0:
            self._now_s += self.turn_s
        until_s = float("inf") if timeout is None else self._now_s + timeout
        while self._planned and self._planned[0][0] <= max(self._now_s, 0.0 if self._ready else until_s):
            when_s, _, act, given = heapq.heappop(self._planned)
            self.world_s, self._now_s = when_s, max(self._now_s, when_s)
            act(*given)
        if self._ready or until_s <= self._now_s:
            self.world_s = self._now_s
            return []
        if timeout is None:
            raise Deadlock(f"deadlock at {self._now_s:g} s: nothing is ready, planned or timed\n{self._waiting()}")
        super().select(until_s - self._now_s)
        self.world_s = self._now_s
        return []


def _make_task(loop: asyncio.AbstractEventLoop, work: Coroutine[Any, Any, Any], **named: Any) -> asyncio.Task[Any]:
    return NumberedTask(work, loop=loop, **named)
