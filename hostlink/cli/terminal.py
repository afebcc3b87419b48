"""A terminal that gives every key at once, and is as it was before when the block is left, however that happens."""

import atexit
import contextlib
import os
import sys
import termios
import tty
from collections.abc import Iterator, Sequence

from hostlink.cli.keys import KeyReader
from hostlink.cli.output import plain
from hostlink.errors import ConfigError

_HIDE_CURSOR, _SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_CLEAR = "\x1b[2J\x1b[H"


class Terminal:
    """The terminal of standard input and output."""

    def __init__(self) -> None:
        self.input = sys.stdin.fileno()
        self._saved = termios.tcgetattr(self.input)

    def enter(self) -> None:
        """Keys without echo and without waiting for a line; signals stay signals."""
        tty.setcbreak(self.input)
        write(_HIDE_CURSOR + KeyReader.ENTER + _CLEAR)

    def leave(self) -> None:
        """As it was before; also when the terminal itself is gone."""
        with contextlib.suppress(OSError, termios.error, ValueError):
            termios.tcsetattr(self.input, termios.TCSADRAIN, self._saved)
            write(KeyReader.LEAVE + _SHOW_CURSOR + "\n")


@contextlib.contextmanager
def key_terminal() -> Iterator[Terminal]:
    """The terminal in key mode for the length of the block.

    Raises:
        ConfigError: there is no terminal.
    """
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise ConfigError("teleop", "needs a terminal for its keys; a program drives with `hostlink pub` or the API")
    terminal = Terminal()
    atexit.register(terminal.leave)
    terminal.enter()
    try:
        yield terminal
    finally:
        terminal.leave()
        atexit.unregister(terminal.leave)


def draw(lines: Sequence[tuple[str, str]]) -> None:
    """Write a screen over the one before, line by line, so that nothing flickers; a line is its text and its colour."""
    width, height = size()
    visible = [_coloured(plain(text)[: width - 1], colour) + "\x1b[K" for text, colour in lines[:height]]
    write("\x1b[H" + "\r\n".join(visible) + "\x1b[J")


def write(text: str) -> None:
    """Write now."""
    sys.stdout.write(text)
    sys.stdout.flush()


def _coloured(text: str, colour: str) -> str:
    return f"\x1b[{colour}m{text}\x1b[0m" if colour and not os.environ.get("NO_COLOR") else text


def size() -> tuple[int, int]:
    """Columns and lines of the terminal."""
    try:
        return os.get_terminal_size(sys.stdout.fileno())
    except OSError:
        return 80, 24
