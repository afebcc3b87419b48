"""Output of the commands. Names and texts of devices and programs are escaped, so that none controls the terminal."""

import codecs
import contextlib
import io
import json
import os
import sys
from collections.abc import Collection, Sequence
from typing import Any, TextIO

from hostlink.core.runtime.plain_text import plain

_CLEAR_LINE = "\r\x1b[2K"
_AS_JSON = "hostlink.json"  # error handler for characters that the terminal's encoding does not have
_has_progress = False  # standard error ends in a line of `show_progress`

LEAST = 12  # characters of a cell that was shortened


def allow_any_text() -> None:
    """Escape characters as in JSON that the encoding of the terminal or pipe does not have, instead of failing."""
    codecs.register_error(_AS_JSON, _escape_unknown)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            with contextlib.suppress(OSError):  # reconfigure asks for the position, which a pipe does not have
                stream.reconfigure(errors=_AS_JSON)


def _escape_unknown(error: UnicodeError) -> tuple[str, int]:
    """Raises:
    UnicodeError: the error is one of decoding.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(json.dumps(char)[1:-1] for char in error.object[error.start : error.end]), error.end


def write(*lines: str) -> None:
    """Write lines on standard output, now."""
    _write(sys.stdout, "".join(f"{plain(line)}\n" for line in lines))


def write_error(*lines: str) -> None:
    """Write lines on standard error, now."""
    _write(sys.stderr, "".join(f"{plain(line)}\n" for line in lines))


def show_question(text: str) -> None:
    """Write a question on standard error; the answer is typed behind it."""
    _write(sys.stderr, plain(text))


def end_line() -> None:
    """End the line on which the terminal has written ^C, so that the prompt of the shell begins a new one."""
    with contextlib.suppress(OSError):  # the terminal is gone
        if sys.stderr.isatty():
            _write(sys.stderr, "\n")


def show_progress(line: str) -> None:
    """Write a line of standard error over the previous one on a terminal; write nothing to a file or a pipe.

    The next output of the command, and its end, clear the line.
    """
    global _has_progress  # noqa: PLW0603 - of the one terminal
    if sys.stderr.isatty():
        _has_progress = False
        _write(sys.stderr, f"{_CLEAR_LINE}{_fitting(plain(line), sys.stderr)}")
        _has_progress = bool(line)


def clear_progress() -> None:
    """Remove the line of `show_progress`, if there is one."""
    if _has_progress:
        show_progress("")


def write_control(text: str) -> None:
    """Write control sequences of this program's own on standard output, now."""
    _write(sys.stdout, text)


def draw(lines: Sequence[tuple[str, str]]) -> None:
    """Draw a screen over the previous one, line by line, so that it does not flicker; a line is its text and colour."""
    width, height = terminal_size()
    visible = [_coloured(plain(text)[: width - 1], colour) + "\x1b[K" for text, colour in lines[:height]]
    write_control("\x1b[H" + "\r\n".join(visible) + "\x1b[J")


def _coloured(text: str, colour: str) -> str:
    return f"\x1b[{colour}m{text}\x1b[0m" if colour and not os.environ.get("NO_COLOR") else text


def terminal_size() -> tuple[int, int]:
    """Return the columns and lines of the terminal; 80 and 24 without one, and for one that does not know its size."""
    columns = lines = 0
    with contextlib.suppress(OSError):
        columns, lines = os.get_terminal_size(sys.stdout.fileno())
    return columns or 80, lines or 24


def _fitting(line: str, terminal: TextIO) -> str:
    """Cut a line to the terminal's width: of a line that wraps, only the end could be written over."""
    with contextlib.suppress(OSError):
        if columns := os.get_terminal_size(terminal.fileno()).columns:
            return line[: columns - 1]
    return line


def _write(stream: TextIO, text: str) -> None:
    """Raises:
    OSError: the stream cannot be written; `filename` is the stream's name.
    """
    clear_progress()
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        error.filename = error.filename or stream.name
        raise


_GAP = 2
_INDENT = 4  # of a row's second line


def write_table(head: Sequence[str], rows: Sequence[Sequence[Any]], *, whole: Collection[str] = ()) -> None:
    """Write a table that fits the terminal; a file or a pipe gets every cell in full. Nothing without rows."""
    write(*fitted_table(head, rows, whole=whole)[1:])


def fitted_table(head: Sequence[str], rows: Sequence[Sequence[Any]], *, whole: Collection[str] = ()) -> list[str]:
    """Lines of a table that fits the terminal; in full for a file or a pipe."""
    return table(head, rows, columns=terminal_size()[0] if is_terminal() else 0, whole=whole)


def is_terminal() -> bool:
    """Whether standard output is a terminal, which shows less than a program reads."""
    return sys.stdout.isatty()


def table(
    head: Sequence[str], rows: Sequence[Sequence[Any]], *, columns: int = 0, whole: Collection[str] = ()
) -> list[str]:
    """Lines of a table: columns under a head; none without rows.

    A table wider than `columns` (0: any width) has long cells shortened in the middle, except under the heads of
    `whole`. If that is not enough, no cell is shortened, and a row takes several lines.
    """
    if not rows:
        return []
    cells = [list(head), *([plain(str(cell)) for cell in row] for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    fitted = widths if columns == 0 else _shrunk(head, widths, columns, whole)
    if fitted is None:
        return ["", *(line for row in cells for line in _folded(row, widths, columns))]
    return ["", *(_line(row, fitted) for row in cells)]


def _line(row: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(middle(cell, width).ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()


def middle(text: str, width: int) -> str:
    """Return the text in at most `width` characters: its middle is replaced by `…`, because ends tell names apart."""
    if len(text) <= width:
        return text
    end = width // 2
    return f"{text[: width - end - 1]}…{text[len(text) - end :]}"


def _shrunk(head: Sequence[str], widths: Sequence[int], columns: int, whole: Collection[str]) -> list[int] | None:
    """Return widths that fit into the columns; None if that is not possible.

    The widest column is shortened, and the first, which names the row, only after all others.
    """
    found = list(widths)
    least = [
        width if name in whole else min(width, max(LEAST, len(name))) for name, width in zip(head, widths, strict=True)
    ]
    for _ in range(sum(widths) + _GAP * (len(widths) - 1) - columns):
        spare = [column for column in range(len(found)) if found[column] > least[column]]
        if not spare:
            return None
        found[max(spare, key=lambda column: (column > 0, found[column]))] -= 1
    return found


def _folded(row: Sequence[str], widths: Sequence[int], columns: int) -> list[str]:
    """Lines of a row that is wider than the columns; the same cells share a line in every row."""
    lines: list[list[tuple[str, int]]] = [[]]
    used = 0
    for cell, width in zip(row, widths, strict=True):
        if lines[-1] and used + width > columns:
            lines.append([])
            used = _INDENT
        lines[-1].append((cell, width))
        used += width + _GAP
    texts = ["  ".join(cell.ljust(width) for cell, width in line).rstrip() for line in lines]
    return [texts[0], *(" " * _INDENT + text for text in texts[1:])]


def duration(seconds: float) -> str:
    """Text of a duration with three digits: 0.412 ms, 33.3 ms, 1.23 s."""
    value = abs(seconds)
    if value == 0:
        return "0 ms"
    if value >= 1:
        return f"{seconds:.2f} s"
    return f"{seconds * 1000:.1f} ms" if value >= 0.001 else f"{seconds * 1000:.3f} ms"  # noqa: PLR2004 - a millisecond


def quantity(count: int, noun: str, nouns: str = "") -> str:
    """Text of a number of things: 1 parameter, 2 parameters. `nouns` is a plural that does not end in s alone."""
    return f"{count} {noun if count == 1 else nouns or f'{noun}s'}"
