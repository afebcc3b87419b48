"""Text of metrics: families that are made in parts, so that the event loop serves others between them."""

import asyncio
from collections.abc import Iterator

import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, Metric
from prometheus_client.registry import Collector

from hostlink.components.gateway import metrics
from hostlink.components.gateway.metrics import text_of

ROBOTS = 50


def family(name: str, *robots: int) -> Metric:
    """Return a family with a sample for each robot."""
    found = CounterMetricFamily(name, f"Events of {name}", labels=["robot"])
    for robot in robots:
        found.add_metric([f"robot_{robot}"], robot)
    return found


class Whole(Collector):
    """The families in one part each."""

    def collect(self) -> Iterator[Metric]:
        yield family("poses", *range(ROBOTS))
        yield family("stops", *range(ROBOTS))


def parts() -> Iterator[Metric]:
    """Yield the same families, with one robot in each part."""
    for robot in range(ROBOTS):
        yield family("poses", robot)
        yield family("stops", robot)


def test_families_in_parts_have_the_text_of_whole_ones() -> None:
    registry = CollectorRegistry()
    registry.register(Whole())
    assert asyncio.run(text_of(parts())) == generate_latest(registry)


def test_others_have_their_turn_between_two_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a thousand robots, one request held the loop up for 0.7 s: longer than the lease of a command."""
    monkeypatch.setattr(metrics, "SLICE_S", 0.0)
    turns = 0

    async def count() -> None:
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async def test() -> None:
        async with asyncio.TaskGroup() as tasks:
            counting = tasks.create_task(count())
            await text_of(parts())
            counting.cancel()

    asyncio.run(test())
    assert turns >= 2 * ROBOTS
