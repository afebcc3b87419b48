"""Minutes of the simulated world: 80 seeds, the first of the 1,000 that `make soak` plays."""

import pytest

from tests.support.simulation.run import play

SEEDS, BLOCK = 80, 8


@pytest.mark.long
@pytest.mark.parametrize("first", range(0, SEEDS, BLOCK))
def test_promises_are_kept_for_a_simulated_minute(first: int) -> None:
    broken = [found for seed in range(first, first + BLOCK) if (found := play(seed)).broken]
    assert not broken, "\n".join(map(str, broken))
