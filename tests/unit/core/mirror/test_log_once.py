"""Repeated failures are logged once, and the number of lines is bounded."""

from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from hostlink.core.mirror import log_once
from hostlink.core.mirror.log_once import MAX_LINES, LogOnce


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
