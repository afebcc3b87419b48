"""LogOutput: writes the log. Neither a reader that is gone or asleep nor a full disk stops the daemon."""

import os
import select
from typing import TextIO

CHUNK_BYTES = 4096  # PIPE_BUF: a pipe that is ready accepts that many bytes without blocking


class LogOutput:
    """A file for structlog. What cannot be written at once is lost and counted."""

    def __init__(self, stream: TextIO | None) -> None:
        """`stream` may be None, as `sys.stderr` is when nobody gave the process one."""
        self.lost_lines = 0  # since the start
        self._reported_lost_lines = 0
        self._stream = stream
        self._is_cut = False  # the last line was written in part
        self._descriptor = _descriptor(stream)
        self._poll = select.poll()
        if self._descriptor is not None:
            self._poll.register(self._descriptor, select.POLLOUT)

    def isatty(self) -> bool:
        """Whether people read it."""
        try:
            return self._stream is not None and self._stream.isatty()
        except ValueError:  # it is closed
            return False

    def write(self, text: str) -> None:
        """Write a line, or count it as lost."""
        try:
            if self._descriptor is None:
                self._write_to_stream(text)
            else:
                self._write_to_descriptor(("\n" if self._is_cut else "") + text)
        except (OSError, ValueError):  # also a stream that is closed
            self.lost_lines += 1

    def pop_lost(self) -> int:
        """Lines that were lost since the last call."""
        lost = self.lost_lines - self._reported_lost_lines
        self._reported_lost_lines = self.lost_lines
        return lost

    def flush(self) -> None:
        """Nothing waits here."""

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
                    raise BlockingIOError("nobody reads the log")
                written += os.write(self._descriptor, data[written : written + CHUNK_BYTES])
        finally:
            if written:
                self._is_cut = written < len(data)

    def _is_ready(self) -> bool:
        """A write would block where this is false; an error shows in the write itself."""
        return bool(self._poll.poll(0))


def _descriptor(stream: TextIO | None) -> int | None:
    try:
        return None if stream is None else stream.fileno()
    except (OSError, ValueError, AttributeError):  # a stream in memory, or one that is closed
        return None
