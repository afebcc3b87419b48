"""Rate limit of log lines about refusals."""

from hostlink.graphs.refusal_log import INTERVAL_S, RefusalLog


def test_first_refusal_of_each_kind_is_a_line_at_once() -> None:
    log = RefusalLog()
    assert [log.count(kind, 0.0) for kind in ("locked", "late", "locked", "late")] == [1, 1, 0, 0]


def test_refusals_of_an_interval_are_one_line_with_their_number() -> None:
    log = RefusalLog()
    lines = [log.count("locked", number * 0.5) for number in range(int(2 * INTERVAL_S / 0.5) + 1)]
    assert [count for count in lines if count] == [1, INTERVAL_S / 0.5, INTERVAL_S / 0.5]
