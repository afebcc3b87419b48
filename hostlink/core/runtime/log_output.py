"""LogOutput: writer of the log. Neither a missing or blocked reader nor a full disk stops the daemon."""

import os
import select
from typing import TextIO

CHUNK_BYTES = 4096  # PIPE_BUF: a ready pipe accepts this many bytes without blocking


class LogOutput:
    """Output file for structlog. Lines that cannot be written at once are lost and counted."""

    def __init__(self, stream: TextIO | None) -> None:
        """`stream` may be None, as `sys.stderr` is for a process without one."""
        self.lost_lines = 0  # since the start
        self._reported_lost_lines = 0
        self._stream = stream
        self._is_cut = False  # the last line was written in part
        self._descriptor = _descriptor(stream)
        self._poll = select.poll()
        if self._descriptor is not None:
            self._poll.register(self._descriptor, select.POLLOUT)

    def isatty(self) -> bool:
        """Whether the output is a terminal."""
        try:
            return self._stream is not None and self._stream.isatty()
        except ValueError:  # the stream is closed
            return False

    def write(self, text: str) -> None:
        """Write a line, or count it as lost."""
        try:
            if self._descriptor is None:
                self._write_to_stream(text)
            else:
                self._write_to_descriptor(("\n" if self._is_cut else "") + text)
        except (OSError, ValueError):  # a closed stream raises ValueError
            self.lost_lines += 1

    def pop_lost(self) -> int:
        """Return the number of lines lost since the last call."""
        lost = self.lost_lines - self._reported_lost_lines
        self._reported_lost_lines = self.lost_lines
        return lost

    def flush(self) -> None:
        """Do nothing: no line is buffered."""

    def _write_to_stream(self, text: str) -> None:
        if self._stream is None:
            raise ValueError("there is no stream")
        self._stream.write(text)
        self._stream.flush()

    def _write_to_descriptor(self, text: str) -> None:
        assert self._descriptor is not None and self._stream is not None  # noqa: S101, PT018
        data = text.encode(self._stream.encoding or "utf-8", "backslashreplace")
        written = 0
        try:
            while written < len(data):
                if not self._is_ready():
                    raise BlockingIOError("the reader of the log is blocked")
                written += os.write(self._descriptor, data[written : written + CHUNK_BYTES])
        finally:
            if written:
                self._is_cut = written < len(data)

    def _is_ready(self) -> bool:
        """Whether a write would not block. An error shows in the write itself."""
        return bool(self._poll.poll(0))


def _descriptor(stream: TextIO | None) -> int | None:
    try:
        return None if stream is None else stream.fileno()
    except (OSError, ValueError, AttributeError):  # a stream in memory, or a closed one
        return None
