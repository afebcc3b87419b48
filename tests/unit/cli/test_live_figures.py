"""Times at which top shows figures, and the snapshots that they are of."""

import itertools
from typing import Any

import pytest

from hostlink.cli.figures import LiveFigures
from hostlink.client import Event


def links(frames: int) -> Event:
    link = {
        "number": 1, "peer": "10.0.0.2:5000", "silent_s": 0.1, "seconds": 4.0, "topics": [], "diagnosis": [],
        "frames_from_device": frames, "frames_to_device": 0, "bytes_from_device": 0, "skipped_bytes": 0,
    }  # fmt: skip
    return Event("links", {"links": [link], "ended": [], "ports": []})


def robots(name: str = "robot_0") -> Event:
    return Event("robots", {"robots": [{"name": name, "link": 1}]})


def shown(live: LiveFigures, seconds: int) -> list[tuple[int, dict[str, Any]]]:
    """Return the figures that are shown at each tick, while a device sends 20 frames a second."""
    found = []
    for tick in range(10 * seconds + 1):
        found.append((tick, live.update(robots(f"robot_{tick}"), tick / 10)))
        if tick % 10 == 0:
            found.append((tick, live.update(links(2 * tick), tick / 10)))
    return [(tick, figures) for tick, figures in found if figures is not None]


def test_the_first_figures_come_with_the_second_sample() -> None:
    live = LiveFigures(1.0)
    assert live.update(robots(), 0.0) is None
    assert live.update(links(0), 0.01) is None
    first = live.update(links(20), 1.01)
    assert first["links"][0]["frames_from_device_s"] == 20.0
    assert first["links"][0]["robots"] == ["robot_0"]


@pytest.mark.parametrize("interval_s", [1, 5])
def test_figures_are_due_once_an_interval_and_rates_are_of_an_interval(interval_s: int) -> None:
    found = shown(LiveFigures(interval_s), 21)
    gaps = {later - earlier for (earlier, _), (later, _) in itertools.pairwise(found)}
    assert gaps == {10 * interval_s}
    assert {figures["links"][0]["frames_from_device_s"] for _, figures in found} == {20.0}


def test_a_short_interval_shows_the_newest_robots_and_rates_of_a_second() -> None:
    found = shown(LiveFigures(0.2), 5)
    assert [tick for tick, _ in found] == list(range(10, 51, 2))
    assert [figures["robots"][0]["name"] for _, figures in found][1:] == [f"robot_{tick}" for tick in range(12, 51, 2)]
    assert {figures["links"][0]["frames_from_device_s"] for _, figures in found} == {20.0}


def test_other_events_are_left_to_others() -> None:
    live = LiveFigures(0.2)
    assert live.update(Event("clients", {"clients": []}), 0.0) is None
    assert live.update(Event("log", {"msg": "warm"}), 1.0) is None
