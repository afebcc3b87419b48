"""Text lines of a board's settings. tests/firmware/test_board_settings.py tests the board's side."""

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.board.settings import (
    LINE_BYTES_MAX,
    SETTINGS,
    AnswerReader,
    BoardAnswer,
    assignment,
    check_value,
    parse_answer,
    request_line,
    value_of,
)
from hostlink.errors import BadRequest


def test_answer_after_text_of_the_sketch_is_found() -> None:
    line = request_line(7, "value host=mule").rstrip(b"\n")
    assert parse_answer(b"speed 0.2 #hl " + line) == BoardAnswer(7, "value host=mule")


@given(st.integers(0, 60), st.integers(1, 255))
def test_line_with_a_wrong_byte_is_ignored(at: int, flip: int) -> None:
    line = bytearray(request_line(7, "value wifi_name=a%20b").rstrip(b"\n"))
    line[at % len(line)] ^= flip
    assert parse_answer(bytes(line)) is None


@given(st.lists(st.binary(max_size=400), max_size=10))
def test_reader_of_any_bytes_has_a_bound_and_finds_the_next_answer(pieces: list[bytes]) -> None:
    reader = AnswerReader()
    for piece in pieces:
        list(reader.feed(piece))
        assert len(reader._rest) <= max(LINE_BYTES_MAX, 0)
    assert list(reader.feed(b"\n" + request_line(1, "ok"))) == [BoardAnswer(1, "ok")]
    assert reader.received_bytes == sum(map(len, pieces)) + len(request_line(1, "ok")) + 1


@given(st.sampled_from(["host", "wifi_name"]), st.text(max_size=60))
def test_quoted_value_is_unquoted(name: str, value: str) -> None:
    words = assignment(name, value).replace("set ", "value ")
    assert words.isascii()
    assert not {"#", " ", "\n"} & set(words.partition("=")[2])
    assert value_of(words) == (name, value)


def test_longest_request_fits_a_line() -> None:
    for setting in SETTINGS.values():
        assert len(request_line(65535, assignment(setting.name, "\u20ac" * (setting.most // 3)))) <= LINE_BYTES_MAX


def test_error_text_does_not_contain_the_value() -> None:
    with pytest.raises(BadRequest) as refused:
        check_value(SETTINGS["wifi_password"], "s3cr3t\n")
    assert "s3cr3t" not in str(refused.value)
    with pytest.raises(BadRequest) as refused:
        check_value(SETTINGS["key"], "s3cr3t s3cr3t s3cr3t")
    assert "s3cr3t" not in str(refused.value)


def test_value_that_is_not_utf_8_is_refused() -> None:
    with pytest.raises(BadRequest, match="wifi_name: not UTF-8"):
        check_value(SETTINGS["wifi_name"], os.fsdecode(b"caf\xe9"))


def test_other_answers_have_no_value() -> None:
    assert value_of("ok") is None
    assert value_of("error long") is None
    assert value_of("value host") is None
