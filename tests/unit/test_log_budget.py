"""LogBudget: limit of log lines for each peer."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.log_budget import MAX_PEERS, LogBudget


def test_budget_allows_a_burst_then_the_rate() -> None:
    budget = LogBudget(burst_lines=5, rate_hz=2.0)
    assert [budget.allows("a", 0.0) for _ in range(7)] == [True] * 5 + [False] * 2
    assert [budget.allows("a", 0.5), budget.allows("a", 0.5)] == [True, False]
    assert budget.left_out == 3


def test_peers_do_not_share() -> None:
    budget = LogBudget(burst_lines=1, rate_hz=0.0)
    assert budget.allows("a", 0.0)
    assert budget.allows("b", 0.0)
    assert not budget.allows("a", 9.0)


def test_refused_lines_are_reported_once() -> None:
    budget = LogBudget(burst_lines=1, rate_hz=0.0)
    for _ in range(4):
        budget.allows("a", 0.0)
    budget.allows("b", 0.0)
    assert budget.pop_left_out() == {"a": 3}
    assert budget.pop_left_out() == {}
    assert budget.left_out == 3


def test_many_peers_are_bounded_and_every_refused_line_is_counted() -> None:
    budget = LogBudget(burst_lines=1, rate_hz=0.0)
    for number in range(MAX_PEERS + 10):
        for _ in range(3):
            budget.allows(f"peer {number}", 0.0)
    assert len(budget._buckets) == MAX_PEERS
    reported = budget.pop_left_out()
    assert reported[""] == 10 * 2
    assert sum(reported.values()) == budget.left_out == (MAX_PEERS + 10) * 2


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 5)), max_size=300))
def test_lines_of_a_peer_never_exceed_burst_and_rate(calls: list[tuple[str, float]]) -> None:
    budget = LogBudget(burst_lines=10, rate_hz=3.0)
    now_s, allowed = 0.0, dict.fromkeys("abc", 0)
    for peer, pause_s in calls:
        now_s += pause_s
        allowed[peer] += budget.allows(peer, now_s)
    assert all(count <= 10 + 3.0 * now_s + 1e-6 for count in allowed.values())
    assert sum(allowed.values()) + budget.left_out == len(calls)
