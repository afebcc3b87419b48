"""Output of a waiting command: nothing at first, then the seconds, and at the end nothing."""

import asyncio
import itertools

import pytest

from hostlink.cli.connecting import CHECKED_ITEMS, counted, waiting
from hostlink.errors import BadRequest
from tests.support.virtual_loop import run_virtual


def shown_while(seconds: float, *, fails: bool = False) -> list[str]:
    """Return the lines that a block of this duration shows."""
    lines: list[str] = []

    async def work() -> None:
        with waiting("waiting for /x", lines.append):
            await asyncio.sleep(seconds)
            if fails:
                raise BadRequest("no")

    if fails:
        with pytest.raises(BadRequest):
            run_virtual(work())
    else:
        run_virtual(work())
    return lines


def test_quick_block_shows_nothing() -> None:
    assert shown_while(1.9) == []


@pytest.mark.parametrize("fails", [False, True])
def test_slow_block_shows_its_seconds_and_clears_the_line(fails: bool) -> None:
    seconds = [f"waiting for /x ... {number} s; Ctrl-C ends" for number in (2, 3, 4)]
    assert shown_while(4.5, fails=fails) == [*seconds, ""]


def counts(items: int, *, second_s: float) -> list[str]:
    """Return the lines that are shown for items, when each reading of the clock is this much later."""
    lines: list[str] = []
    times_s = itertools.count(0.0, second_s)
    found = counted(range(items), "lines", show=lines.append, clock=lambda: next(times_s))
    assert list(found) == list(range(items))
    return lines


def test_items_are_counted_when_they_take_long() -> None:
    assert counts(4 * CHECKED_ITEMS, second_s=1.0) == ["256 lines ...", "512 lines ...", "768 lines ...", ""]


def test_quick_items_are_not_counted() -> None:
    assert counts(4 * CHECKED_ITEMS, second_s=0.001) == []
    assert counts(2, second_s=10.0) == ["0 lines ...", ""]
