"""Output of the commands: no text of a device or a program controls the terminal, and JSON keeps its meaning."""

import ast
import contextlib
import fcntl
import io
import json
import os
import pty
import struct
import termios
from pathlib import Path

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

import hostlink.cli
from hostlink.cli.main import main
from hostlink.cli.output import allow_any_text, show_progress, table, terminal_size, write
from hostlink.core.runtime import logs
from hostlink.core.runtime.plain_text import plain

WRITERS = {"output.py"}
LINE = "  driving: 12 s, leg 1 of 8; Ctrl-C stops it"
HOSTILE = "\x1b[2J\x9b31m\u202e\u2066\x7f\n\r\t\x07\u2028\ufeff\U000e0041"


@given(st.text(st.characters(codec=None)))
def test_any_line_becomes_printable(text: str) -> None:
    assert plain(text).isprintable()


@given(st.text())
def test_json_is_the_same_json(text: str) -> None:
    written = plain(json.dumps({text: text}, ensure_ascii=False))
    assert json.loads(written) == {text: text}


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_no_character_is_missing_in_a_terminal_of_another_encoding(encoding: str) -> None:
    written = io.BytesIO()
    with contextlib.redirect_stdout(io.TextIOWrapper(written, encoding)):
        allow_any_text()
        write(json.dumps({"heading °": "機器人 🤖"}, ensure_ascii=False))
        assert json.loads(written.getvalue().decode(encoding)) == {"heading °": "機器人 🤖"}


def test_plain_words_of_all_languages_stay() -> None:
    assert plain("robot_0  größe  機器人  +0.10 m/s") == "robot_0  größe  機器人  +0.10 m/s"


def test_a_line_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    write("a\nb", "c")
    assert capsys.readouterr().out == "a\\nb\nc\n"


def test_no_command_writes_past_it() -> None:
    """A new command that wrote by itself would write what devices call themselves."""
    for file in Path(hostlink.cli.__file__).parent.glob("*.py"):
        if file.name not in WRITERS:
            tree = ast.parse(file.read_text())
            written = [ast.unparse(node) for node in ast.walk(tree) if isinstance(node, ast.Call)]
            past = [call for call in written if call.startswith(("sys.stdout.write", "sys.stderr.write", "print("))]
            assert past == [], file.name


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("columns", "shown"), [(40, LINE[:39]), (0, LINE), (200, LINE)])
def test_progress_fits_into_one_line(columns: int, shown: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A line must not wrap, because only its end would be written over; a terminal without a size has 0 columns."""
    terminal, other = pty.openpty()
    try:
        fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        with open(other, "w", closefd=False) as stream:
            monkeypatch.setattr("sys.stderr", stream)
            show_progress(LINE)
        assert os.read(terminal, 1000).decode() == f"\r\x1b[2K{shown}"
    finally:
        os.close(terminal)
        os.close(other)


@pytest.mark.parametrize(("size", "known"), [((0, 0), (80, 24)), ((10, 40), (40, 10))])
def test_size_of_a_terminal(size: tuple[int, int], known: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    """A serial console has 0 columns and 0 lines until a program sets its size."""
    terminal, other = pty.openpty()
    try:
        fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
        with open(other, "w", closefd=False) as stream:
            monkeypatch.setattr("sys.stdout", stream)
            assert terminal_size() == known
    finally:
        os.close(terminal)
        os.close(other)


def test_a_traceback_is_not_written_behind_the_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: list[str]) -> int:
        show_progress("3 files ...")
        raise RuntimeError

    monkeypatch.setattr("sys.stderr", terminal := _Terminal())
    monkeypatch.setattr("hostlink.cli.main._run", fail)
    with pytest.raises(RuntimeError):
        main()
    assert terminal.getvalue() == "\r\x1b[2K3 files ...\r\x1b[2K"


def test_the_log_on_a_terminal_has_no_codes_but_its_own() -> None:
    before = structlog.get_config()
    out = _Terminal()
    try:
        logs.configure(stream=out)
        structlog.get_logger().info("robot.appeared", robot=f"r{HOSTILE}", velocity=f"/{HOSTILE}")
    finally:
        structlog.configure(**before)
    written = out.getvalue()
    assert "robot.appeared" in written
    assert "\x1b[2J" not in written
    assert not set(HOSTILE) - {"\x1b", "\n"} & set(written) - set("[2J31m")


def test_a_name_in_the_log_is_printable_and_short() -> None:
    assert logs.printable(HOSTILE).isprintable()
    assert len(logs.printable("x" * 1000)) == 64


HEAD = ("topic", "type", "subs")
ROWS = [("/robot_0/velocity_commands", "geometry_msgs/TwistWithCovarianceStamped", 2), ("/tf", "tf2_msgs/TFMessage", 0)]


def test_table_without_a_terminal_has_every_cell_in_full() -> None:
    assert table(HEAD, ROWS) == [
        "",
        "topic                       type                                      subs",
        "/robot_0/velocity_commands  geometry_msgs/TwistWithCovarianceStamped  2",
        "/tf                         tf2_msgs/TFMessage                        0",
    ]
    assert table(HEAD, []) == []


def test_table_that_is_too_wide_has_long_cells_shortened_in_the_middle_and_the_first_column_last() -> None:
    assert table(HEAD, ROWS, columns=60)[1:] == [
        "topic                       type                        subs",
        "/robot_0/velocity_commands  geometry_msg…rianceStamped  2",
        "/tf                         tf2_msgs/TFMessage          0",
    ]
    narrow = table(HEAD, ROWS, columns=34)
    assert narrow[2].split() == ["/robot…ommands", "geome…tamped", "2"]


def test_table_that_shortening_cannot_fit_takes_several_lines_for_a_row() -> None:
    assert table(HEAD, ROWS, columns=60, whole=("type", "topic"))[1:5] == [
        "topic",
        "    type                                      subs",
        "/robot_0/velocity_commands",
        "    geometry_msgs/TwistWithCovarianceStamped  2",
    ]


@given(
    st.lists(
        st.tuples(st.text("ab/_", max_size=60), st.text("01", max_size=6), st.text("xy", max_size=90)), min_size=1
    ),
    st.integers(24, 120),
)
def test_lines_of_any_table_fit_or_hold_a_single_cell(rows: list[tuple[str, str, str]], columns: int) -> None:
    for line in table(("name", "n", "why"), rows, columns=columns):
        assert len(line) <= columns or len(line.split()) == 1
