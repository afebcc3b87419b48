"""How late a command is, by the sender's clock and the host's, which need not agree."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.robot.freshness import DRIFT, Freshness


def test_the_first_command_counts_as_the_quickest() -> None:
    assert Freshness().late_s(1e9, 5.0) == 0.0


def test_a_command_is_as_late_as_its_delay_exceeds_the_shortest() -> None:
    freshness = Freshness()
    freshness.late_s(100.0, 5.0)
    assert freshness.late_s(100.1, 5.7) == pytest.approx(0.6, abs=DRIFT)
    assert freshness.late_s(100.2, 5.2) == pytest.approx(0.0, abs=DRIFT)


def test_a_quicker_command_corrects_the_ones_after_it() -> None:
    freshness = Freshness()
    freshness.late_s(100.0, 5.4)
    assert freshness.late_s(100.1, 5.1) == 0.0
    assert freshness.late_s(100.2, 5.6) == pytest.approx(0.4, abs=DRIFT)


def test_a_route_that_became_slower_is_accepted_at_the_pace_of_a_drifting_clock() -> None:
    freshness = Freshness()
    freshness.late_s(0.0, 0.0)
    assert freshness.late_s(100.0, 101.0) == pytest.approx(1.0 - 101.0 * DRIFT)
    assert freshness.late_s(1000.0, 1001.0) == 0.0


@given(st.lists(st.tuples(st.floats(0, 1e6), st.floats(0, 10)), min_size=1, max_size=20))
def test_nothing_is_early(commands: list[tuple[float, float]]) -> None:
    freshness, now_s = Freshness(), 0.0
    for sent_s, wait_s in commands:
        now_s += wait_s
        assert freshness.late_s(sent_s, now_s) >= 0.0
