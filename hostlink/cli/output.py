"""Output of the commands. Names and texts of devices and programs are escaped, so that none controls the terminal."""

import codecs
import contextlib
import io
import json
import os
import sys
from collections.abc import Sequence
from typing import Any, TextIO

BYTES_PER_MB = 1_000_000
_CLEAR_LINE = "\r\x1b[2K"
_AS_JSON = "hostlink.json"  # error handler for characters that the terminal's encoding does not have


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


def plain(text: str) -> str:
    """Return the text in one line, with unprintable characters escaped as in JSON: JSON keeps its meaning.

    Escaped are control characters (ESC, C1), marks that change the direction of reading, and ends of lines.
    """
    return text if text.isprintable() else "".join(map(_escaped, text))


def write(*lines: str) -> None:
    """Write lines on standard output, now."""
    _write(sys.stdout, "".join(f"{plain(line)}\n" for line in lines))


def write_error(*lines: str) -> None:
    """Write lines on standard error, now."""
    _write(sys.stderr, "".join(f"{plain(line)}\n" for line in lines))


def write_over(line: str) -> None:
    """Write a line over the previous one on a terminal; write a new line to a file or a pipe."""
    _write(sys.stdout, f"{_CLEAR_LINE}{plain(line)}" if sys.stdout.isatty() else f"{plain(line)}\n")


def show_question(text: str) -> None:
    """Write a question on standard error; the answer is typed behind it."""
    _write(sys.stderr, plain(text))


def show_progress(line: str) -> None:
    """Write a line of standard error over the previous one on a terminal; write nothing to a file or a pipe."""
    if sys.stderr.isatty():
        _write(sys.stderr, f"{_CLEAR_LINE}{_fitting(plain(line), sys.stderr)}")


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
    """Return the columns and lines of the terminal; 80 and 24 without one."""
    try:
        return os.get_terminal_size(sys.stdout.fileno())
    except OSError:
        return 80, 24


def _fitting(line: str, terminal: TextIO) -> str:
    """Cut a line to the terminal's width: of a line that wraps, only the end could be written over."""
    with contextlib.suppress(OSError):
        if columns := os.get_terminal_size(terminal.fileno()).columns:
            return line[: columns - 1]
    return line


def _escaped(char: str) -> str:
    return char if char.isprintable() else json.dumps(char)[1:-1]


def _write(stream: TextIO, text: str) -> None:
    """Raises:
    OSError: the stream cannot be written; `filename` is the stream's name.
    """
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        error.filename = error.filename or stream.name
        raise


def table(head: list[str], rows: list[list[Any]]) -> list[str]:
    """Lines of a table: columns under a head; none without rows."""
    if not rows:
        return []
    cells = [head, *([plain(str(cell)) for cell in row] for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    return [
        "",
        *("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in cells),
    ]


def duration(seconds: float) -> str:
    """Text of a duration with three digits: 0.412 ms, 33.3 ms, 1.23 s."""
    value = abs(seconds)
    if value == 0:
        return "0 ms"
    if value >= 1:
        return f"{seconds:.2f} s"
    return f"{seconds * 1000:.1f} ms" if value >= 0.001 else f"{seconds * 1000:.3f} ms"  # noqa: PLR2004 - a millisecond


def size(count: float) -> str:
    """Text of a number of bytes: 320 B, 9.6 kB, 1.2 MB."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:  # noqa: PLR2004 - orders of magnitude
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def megabytes(count: float) -> str:
    """Text of a file's size, always in MB, so that a column or a progress line keeps its unit."""
    return f"{count / BYTES_PER_MB:.1f} MB"
