"""25 s of chaos against a real daemon, with a new seed each time: tests/support/chaos, tools/chaos_daemon.py.

HOSTLINK_CHAOS_SEED=7 plays the steps of that seed again. HOSTLINK_CHAOS_S=600 plays for longer, as `make soak` does.
"""

import os
import secrets
import sys

import pytest

from tests.support.chaos.limits import Limits
from tests.support.chaos.report import describe
from tests.support.chaos.run import Wanted, run

SECONDS = float(os.environ.get("HOSTLINK_CHAOS_S", "25"))  # start, end and what waits take ten more
IMPOSSIBLE = Limits(p99_s=1e-6, memory_mib=1.0)


def draw_seed() -> int:
    """Return the seed of the environment, 1 in CI, else a new one."""
    is_ci = os.environ.get("HYPOTHESIS_PROFILE") == "ci"
    return int(os.environ.get("HOSTLINK_CHAOS_SEED") or (1 if is_ci else secrets.randbelow(1_000_000)))


@pytest.mark.long
@pytest.mark.alone
@pytest.mark.timeout(SECONDS + 120)
async def test_robot_under_chaos_stops_and_the_daemon_lives() -> None:
    outcome = await run(Wanted(seed=draw_seed(), seconds=SECONDS), print)
    sys.stdout.write(describe(outcome))
    assert not outcome.violations, describe(outcome) + "\n" + outcome.log_tail
    assert outcome.steps > SECONDS / 3
    assert outcome.figures["commands"] > 5 * SECONDS
    assert outcome.figures["ends"] > SECONDS / 12


async def test_a_broken_promise_ends_the_run_and_is_printed_with_its_seed() -> None:
    outcome = await run(Wanted(seed=1, seconds=10.0, limits=IMPOSSIBLE), print)
    assert "memory, MiB" in {violation.promise for violation in outcome.violations}
    assert outcome.steps == 0
    text = describe(outcome)
    assert "FAILED seed 1, step -1: memory, MiB" in text
    assert "again: python tools/chaos_daemon.py --seed 1 --seconds 10 --limit-p99-s 1e-06 --limit-memory-mib 1" in text
