"""Token buckets of the API's clients."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.runtime.rate_limit import MAX_KEYS, RateLimit


def test_rate_limit_allows_a_burst_of_one_second() -> None:
    limit = RateLimit(10)
    assert [limit.allows("a", 5.0) for _ in range(11)] == [True] * 10 + [False]
    assert not limit.allows("a", 5.05)
    assert limit.allows("a", 5.1 + 1e-9)
    assert limit.refused == 2


def test_rate_limit_is_separate_for_each_key() -> None:
    limit = RateLimit(1)
    assert [limit.allows("a", 0.0), limit.allows("a", 0.0), limit.allows("b", 0.0)] == [True, False, True]


def test_rate_limit_keeps_a_bounded_number_of_keys() -> None:
    limit = RateLimit(1)
    for number in range(3 * MAX_KEYS):
        limit.allows(number, 0.0)
    assert len(limit._buckets) == MAX_KEYS


@given(st.floats(1, 1000), st.lists(st.floats(0, 0.5), max_size=200))
def test_rate_limit_never_allows_more_than_rate_and_burst(per_s: float, pauses_s: list[float]) -> None:
    limit, now_s, passed = RateLimit(per_s), 0.0, 0
    for pause_s in pauses_s:
        now_s += pause_s
        passed += limit.allows("a", now_s)
    assert passed <= per_s * now_s + per_s + 1e-6
