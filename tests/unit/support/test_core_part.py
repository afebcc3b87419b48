"""A process that has a part of a core runs no more than that, by a quota or by signals."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support import core_part
from tests.support.core_part import StoppedPart, can_limit, children_of, part_of_a_core

SECONDS = 1.0
BUSY = (sys.executable, "-c", "while True: pass")


@pytest.fixture
def busy() -> Iterator[subprocess.Popen[bytes]]:
    """A process that uses all that it is given."""
    with subprocess.Popen(BUSY) as child:
        yield child
        child.kill()


def ran_s(pid: int) -> float:
    return int(Path(f"/proc/{pid}/schedstat").read_text().split()[0]) / 1e9


def ran_share(pid: int) -> float:
    """Return the share of a core that the process had in a second."""
    before_s, began_s = ran_s(pid), time.monotonic()
    time.sleep(SECONDS)
    return (ran_s(pid) - before_s) / (time.monotonic() - began_s)


@pytest.mark.skipif(not can_limit(), reason="no control group can be written")
def test_a_process_with_a_quota_runs_no_more_than_that(busy: subprocess.Popen[bytes]) -> None:
    with part_of_a_core(0.2, busy.pid):
        assert ran_share(busy.pid) < 0.3


def test_a_process_that_is_stopped_in_turn_runs_no_more_than_that(
    busy: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(core_part, "can_limit", lambda: False)
    with part_of_a_core(0.2, busy.pid) as part:
        assert isinstance(part, StoppedPart)
        assert ran_share(busy.pid) < 0.4
        assert part.stopped_s > SECONDS / 2
    state = Path(f"/proc/{busy.pid}/stat").read_text().rpartition(")")[2].split()[0]
    assert state != "T"  # the process continues afterwards


def test_children_of_a_process_are_found(busy: subprocess.Popen[bytes]) -> None:
    assert busy.pid in children_of(int(Path("/proc/self/stat").read_text().split()[0]))
