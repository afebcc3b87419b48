"""The daemon's core in the simulated world keeps its promises, and a seed repeats a run to the last line of its log."""

import os
import subprocess
import sys

import pytest

from tests.support.simulation.run import play

SECONDS = 3.0


@pytest.mark.parametrize("seed", range(20))
def test_promises_are_kept_in_a_simulated_world(seed: int) -> None:
    found = play(seed, SECONDS)
    assert not found.broken, found


def test_same_seed_gives_the_same_log() -> None:
    first, second = play(9, SECONDS), play(9, SECONDS)
    assert first.log.encode() == second.log.encode()
    assert " Written(" in first.log
    assert first.log != play(10, SECONDS).log


def test_same_seed_gives_the_same_log_in_processes_with_other_hashes() -> None:
    command = [sys.executable, "-m", "tests.support.simulation", "14", "--seconds", str(SECONDS)]
    logs = [
        subprocess.run(command, env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True).stdout
        for seed in ("1", "2")
    ]
    assert logs[0] == logs[1]
    assert b" Written(" in logs[0]
