"""Repeated failures are logged once, refusals at a limited rate, and the number of lines is bounded."""

from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from hostlink.mirror import log_once
from hostlink.mirror.log_once import INTERVAL_S, MAX_LINES, LogOnce, RefusalLog


@given(st.lists(st.tuples(st.sampled_from(["a", "b"]), st.integers(0, 3).map(str))))
def test_each_line_is_written_once_at_its_first_time(wanted: list[tuple[str, str]]) -> None:
    logged = LogOnce()
    with capture_logs() as lines:
        for event, name in wanted:
            logged(event, name=name)
    assert [(line["event"], line["name"]) for line in lines] == list(dict.fromkeys(wanted))


def test_lines_over_the_bound_are_counted_and_not_written() -> None:
    logged = LogOnce()
    with capture_logs() as lines:
        for number in range(MAX_LINES + 5):
            logged("x", name=str(number))
    assert len(lines) == MAX_LINES
    assert logged.counts["unlogged"] == 5


def test_a_fact_that_makes_no_other_line_is_shown_once() -> None:
    logged = LogOnce(by=("name",))
    with capture_logs() as lines:
        for reason in ("first", "second"):
            logged("x", name="a", reason=reason)
        logged("x", name="b", reason="third")
    assert [line["reason"] for line in lines] == ["first", "third"]


def test_levels_and_texts_of_peers() -> None:
    logged = LogOnce(at_info=["calm"])
    with capture_logs() as lines:
        logged("calm", name="a")
        logged("bad", name="\x1b[31m" + "x" * 1000)
    assert [line["log_level"] for line in lines] == ["info", "warning"]
    assert "\x1b" not in lines[1]["name"]
    assert len(lines[1]["name"]) <= log_once.MAX_CHARS + 1


def test_first_refusal_of_each_kind_is_a_line_at_once() -> None:
    log = RefusalLog()
    assert [log.count(kind, 0.0) for kind in ("locked", "late", "locked", "late")] == [1, 1, 0, 0]


def test_refusals_of_an_interval_are_one_line_with_their_number() -> None:
    log = RefusalLog()
    lines = [log.count("locked", number * 0.5) for number in range(int(2 * INTERVAL_S / 0.5) + 1)]
    assert [count for count in lines if count] == [1, INTERVAL_S / 0.5, INTERVAL_S / 0.5]
