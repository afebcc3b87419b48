"""Fields of a message as a person writes and reads them, and what `hostlink info` is given: a name or a file."""

import csv
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.cli.topics import csv_line, field_of, flat, is_recording, readable
from hostlink.core.runtime.plain_text import csv_text
from hostlink.errors import HostlinkError

MESSAGE = {"header": {"stamp": {"secs": 5}}, "ranges": [0.5, 1.5], "legs": [{"x": 1}, {"x": 2}], "name": "a"}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("name", "a"),
        ("header.stamp.secs", 5),
        ("ranges", [0.5, 1.5]),
        ("ranges[1]", 1.5),
        ("ranges.1", 1.5),
        ("legs[1].x", 2),
        (".name", "a"),
    ],
)
def test_a_field_by_its_path(path: str, value: Any) -> None:
    assert field_of(MESSAGE, path) == value


@pytest.mark.parametrize(
    ("path", "text"),
    [
        ("nam", "no field nam; at that place the message has header, ranges, legs, name"),
        ("header.stmp", "no field header.stmp; at that place the message has stamp"),
        ("ranges[2]", r"no field ranges\[2\]; at that place the message has a list of 2"),
        ("ranges.x", r"no field ranges.x; at that place the message has a list of 2"),
        ("name.x", "no field name.x; at that place the message has a single value"),
    ],
)
def test_a_field_that_is_not_there(path: str, text: str) -> None:
    with pytest.raises(HostlinkError, match=text):
        field_of(MESSAGE, path)


def test_a_row_has_a_cell_for_each_field_and_lists_are_one() -> None:
    names, values = zip(*flat(MESSAGE), strict=True)
    assert names == ("header.stamp.secs", "ranges", "legs", "name")
    assert csv_line(values) == '5,"[0.5, 1.5]","[{""x"": 1}, {""x"": 2}]",a'


def test_text_that_a_spreadsheet_would_execute_begins_with_an_apostrophe() -> None:
    assert csv_line(['=HYPERLINK("http://x")', -2, "-2"]) == """"'=HYPERLINK(""http://x"")",-2,'-2"""


@given(st.lists(st.one_of(st.text(st.characters(exclude_characters="\r\n\x00")), st.integers()), min_size=1))
def test_a_table_is_read_again(cells: list[str | int]) -> None:
    (row,) = csv.reader([csv_line(cells)]) if any(map(str, cells)) else [list(map(str, cells))]
    assert row == [csv_text(cell) if isinstance(cell, str) else str(cell) for cell in cells]


def test_numbers_have_the_digits_of_a_person() -> None:
    shown = readable({"a": 0.1 + 0.2, "b": [1.23456789, 1e-9 / 3], "c": 1763774000.123456, "d": 7, "e": True})
    assert shown == {"a": 0.3, "b": [1.234568, 3.33333e-10], "c": 1763774000.123456, "d": 7, "e": True}


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_no_number_is_changed_by_more_than_its_last_digit(value: float) -> None:
    assert math.isclose(readable(value), value, rel_tol=1e-5, abs_tol=0)


@pytest.mark.parametrize("name", ["/robot_0/odometry", "robot_0", "x" * 5000, "/" + "x" * 5000, "a\0b"])
def test_name_without_a_file_is_a_name_of_the_graph(name: str) -> None:
    assert not is_recording(name)


def test_file_of_any_name_is_a_recording(tmp_path: Path) -> None:
    (tmp_path / "run").touch()
    assert is_recording(str(tmp_path / "run"))
    assert is_recording("no/such/file.mcap")


def test_folder_is_a_recording_if_it_is_here_has_one_or_is_written_as_a_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert not is_recording("robot_0")
    (tmp_path / "robot_0" / "sub").mkdir(parents=True)
    assert is_recording("robot_0")
    assert is_recording("robot_0/sub")
    assert not is_recording("/robot_0")
    assert not is_recording("/run")
    assert is_recording("./robot_0")
    assert is_recording("robot_0/")
    assert is_recording(str(tmp_path / "robot_0"))
    monkeypatch.setattr("hostlink.cli.topics.PARTS_OF_TOPIC", len((tmp_path / "robot_0").parts))
    assert not is_recording(str(tmp_path / "robot_0"))  # as /run
    (tmp_path / "robot_0" / "run.mcap").touch()
    assert is_recording(str(tmp_path / "robot_0"))
