"""LogBudget: limit of log lines for each peer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.runtime.log_budget import (
    BURST_LINES,
    LOG_INTERVAL_S,
    MAX_KINDS,
    MAX_NAMED,
    RATE_HZ,
    Budget,
    LogBudget,
)


def spent(budget: LogBudget, peer: str) -> None:
    """Use up the peer's burst."""
    assert all(budget.allows(peer, 0.0) for _ in range(BURST_LINES))


def test_budget_allows_a_burst_then_the_rate() -> None:
    budget = LogBudget()
    spent(budget, "a")
    assert not budget.allows("a", 0.0)
    half_s = 1.5 / RATE_HZ
    assert [budget.allows("a", half_s), budget.allows("a", half_s)] == [True, False]
    assert budget.left_out == 2


def test_peers_do_not_share() -> None:
    budget = LogBudget()
    spent(budget, "a")
    assert budget.allows("b", 0.0)
    assert not budget.allows("a", 0.0)


def test_refused_lines_are_reported_once() -> None:
    budget = LogBudget()
    spent(budget, "a")
    for _ in range(3):
        budget.allows("a", 0.0)
    budget.allows("b", 0.0)
    assert budget.pop_left_out() == {"a": 3}
    assert budget.pop_left_out() == {}
    assert budget.left_out == 3


@pytest.mark.slow
def test_many_peers_are_bounded_and_every_refused_line_is_counted() -> None:
    budget = LogBudget()
    for number in range(MAX_NAMED + 10):
        spent(budget, f"noisy {number}")
        budget.allows(f"noisy {number}", 0.0)
        budget.allows(f"noisy {number}", 0.0)
    found = budget.pop_left_out()
    assert len(found) == MAX_NAMED + 1
    assert (found["noisy 0"], found[""]) == (2, 10 * 2)
    assert found.total() == budget.left_out == (MAX_NAMED + 10) * 2


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 0.2)), max_size=300))
def test_lines_of_a_peer_never_exceed_burst_and_rate(calls: list[tuple[str, float]]) -> None:
    budget = LogBudget()
    for peer in "abc":
        spent(budget, peer)
    now_s, allowed = 0.0, dict.fromkeys("abc", 0)
    for peer, pause_s in calls:
        now_s += pause_s
        allowed[peer] += budget.allows(peer, now_s)
    assert all(count <= RATE_HZ * now_s + 1e-6 for count in allowed.values())
    assert sum(allowed.values()) + budget.left_out == len(calls)


def test_repeated_line_is_due_at_once_and_then_once_an_interval_with_its_counts() -> None:
    budget = Budget()
    assert [budget.due("a", 0.0) for _ in range(5)] == [{"count": 1}, {}, {}, {}, {}]
    assert budget.due("b", 0.0, "crowd") == {"crowd": 1}
    assert budget.due("b", 1.0, "crowd") == budget.due("b", LOG_INTERVAL_S - 0.1, "key") == {}
    assert budget.due("b", LOG_INTERVAL_S, "key") == {"crowd": 1, "key": 2}
    assert budget.due("a", LOG_INTERVAL_S) == {"count": 5}


def test_kinds_of_repeated_lines_are_bounded() -> None:
    budget = Budget()
    lines = [budget.due(str(number), 0.0) for number in range(10 * MAX_KINDS)]
    assert sum(map(bool, lines)) == MAX_KINDS + 1
    assert budget.due("one more", LOG_INTERVAL_S) == {"count": 9 * MAX_KINDS}
