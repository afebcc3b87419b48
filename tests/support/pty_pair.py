"""Two ends of a serial line without hardware."""

import contextlib
import os
import termios
import tty
from collections.abc import Iterator


@contextlib.contextmanager
def pty_pair() -> Iterator[tuple[int, str]]:
    """(descriptor of one end, path of the other), both raw."""
    ours, theirs = os.openpty()
    for end in (ours, theirs):
        tty.setraw(end, termios.TCSANOW)
    try:
        yield ours, os.ttyname(theirs)
    finally:
        for end in (ours, theirs):
            with contextlib.suppress(OSError):  # a test may have closed its end
                os.close(end)
