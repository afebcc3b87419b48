"""Stopwatch leaves out the time in which other programs ran."""

import asyncio
import os
import time

import pytest

from tests.support import stopwatch
from tests.support.background import meanwhile
from tests.support.stopwatch import Stopwatch, kept_waiting_s


def test_stopwatch_counts_what_this_process_sleeps_and_computes() -> None:
    watch, began_s = Stopwatch(), time.process_time()
    while time.process_time() - began_s < 0.03:
        pass
    time.sleep(0.03)
    assert watch.seconds >= 0.055


def test_stopwatch_leaves_out_what_the_kernel_kept_a_process_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = {os.getpid(): 1.0, 77: 2.0}
    monkeypatch.setattr(stopwatch, "kept_waiting_s", kept.__getitem__)
    watch = Stopwatch(77)
    kept[os.getpid()] += 10.0
    kept[77] += 5.0
    assert -15.0 <= watch.seconds < -14.0
    kept[77] = 0.0  # the process has ended: its last sample counts
    assert -15.0 <= watch.seconds < -14.0


async def test_stopwatch_that_samples_knows_how_long_an_ended_process_waited(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = {os.getpid(): 1.0, 77: 2.0}
    monkeypatch.setattr(stopwatch, "kept_waiting_s", kept.__getitem__)
    watch = Stopwatch(77)
    async with meanwhile(watch.sampling()):
        kept[77] += 5.0
        await asyncio.sleep(3 * stopwatch.SAMPLE_INTERVAL_S)
        kept[77] = 0.0
    assert watch.kept_s == 5.0


def test_wait_of_a_process_that_has_ended_is_not_known() -> None:
    assert kept_waiting_s(2**22 + 1) == 0.0
