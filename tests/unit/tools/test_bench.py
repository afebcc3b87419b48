"""Rows of the benchmarks: bounds, the printed table and the exit status."""

import json
from pathlib import Path

import pytest

from tools.bench import Row, report


@pytest.mark.parametrize(
    ("row", "is_met"),
    [
        (Row("a", 10.0, "us"), True),
        (Row("a", 10.0, "us", at_most=9.0), False),
        (Row("a", 10.0, "us", at_most=10.0), True),
        (Row("a", 10.0, "us", "times another", 2.0, at_most=3.0), True),
        (Row("a", 1.0, "us", "times another", 4.0, at_most=3.0), False),
        (Row("a", 1.0, "us", "times another", 4.0, at_least=4.1), False),
        (Row("a", 0.0, "us", "times another", 4.0, at_least=3.0), True),
    ],
)
def test_bounds_are_of_the_ratio_where_there_is_a_yardstick(row: Row, is_met: bool) -> None:
    assert row.is_met is is_met


def test_report_with_a_missed_bound_returns_1_and_names_the_row(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "build" / "rows.json"
    rows = [Row("fast", 1.0, "ms", "times an echo", 1.5, at_most=2.0), Row("slow", 9.0, "ms", at_most=2.0)]
    assert report(rows, out) == 1
    printed = capsys.readouterr()
    assert "times an echo  (at most 2)" in printed.out
    assert printed.err == "missed its bound: slow\n"
    assert [row["is_met"] for row in json.loads(out.read_text())["rows"]] == [True, False]


def test_report_within_the_bounds_returns_0(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert report([Row("fast", 1.0, "ms", at_most=2.0)], tmp_path / "rows.json") == 0
    assert capsys.readouterr().err == ""
