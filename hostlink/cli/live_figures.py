"""The figures of `hostlink top` as the daemon's events come: which two looks make rates, and when they are due."""

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from hostlink.cli.figures import Sample, figures
from hostlink.client import Event, Host

EARLY_S = 0.05  # events come by tenths of a second: what is half of one early is in time


async def live_figures(host: Host, interval_s: float) -> AsyncIterator[dict[str, Any]]:
    """Figures, again and again; the first as soon as there are two looks.

    Raises:
        HostlinkError: the connection is lost.
    """
    live = LiveFigures(interval_s)
    async for event in host.watch():
        shown = live.update(event, asyncio.get_running_loop().time())
        if shown is not None:
            yield shown


class LiveFigures:
    """The newest sample of links and robots, and the one of an interval before, from which rates are made. Pure."""

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s - EARLY_S
        self._robots: list[dict[str, Any]] = []
        self._before: Sample | None = None
        self._newest: Sample | None = None
        self._shown_at_s = float("-inf")

    def update(self, event: Event, now_s: float) -> dict[str, Any] | None:
        """Figures when they are due."""
        if event.name == "robots":
            self._robots = event.data["robots"]
        elif event.name == "links":
            self._add(Sample(now_s, event.data, self._robots))
        if self._before is None or self._newest is None or now_s < self._shown_at_s + self._interval_s:
            return None
        self._shown_at_s = now_s
        return figures(self._before, self._newest._replace(robots=self._robots))

    def _add(self, sample: Sample) -> None:
        """Rates are of the interval, or of the time between two looks where that is longer."""
        if self._newest is not None and (
            self._before is None or self._newest.at_s >= self._before.at_s + self._interval_s
        ):
            self._before = self._newest
        self._newest = sample
