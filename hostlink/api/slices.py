"""Slices: work on the views of a large fleet, a few in a turn of the event loop; devices and commands go in between."""

import asyncio
from collections.abc import Callable, Iterator
from typing import TypeVar

from hostlink.hub.hub import Hub

View = TypeVar("View")

SLICE_S = 0.0002  # of one turn of the loop: eight robots, or one link with very many topics


class Slices:
    """The turns of one encoder; `spent_s` is what its work has cost."""

    def __init__(self, hub: Hub) -> None:
        self.spent_s = 0.0
        self._turns = hub.turns()

    async def run(self, views: Iterator[View], work: Callable[[View], None]) -> None:
        """Make the views and do the work for each, in a turn as many as fill SLICE_S."""
        now_s = asyncio.get_running_loop().time
        is_done = False

        def work_on_some() -> None:
            nonlocal is_done
            began_s = now_s()
            for view in views:
                work(view)
                if now_s() - began_s >= SLICE_S:
                    break
            else:
                is_done = True
            self.spent_s += now_s() - began_s

        while not is_done:
            await self._turns.run(work_on_some, is_flooding=True)
