"""Backlog: whether a client sends faster than it is read. A client whose messages the daemon has delayed does not."""

import asyncio
import contextlib
from collections.abc import Iterator

MANY = 64  # messages that one who drives may send while the daemon is busy: more than a second's worth at 50 Hz


class Backlog:
    """Counts the messages of one client that had come before they were waited for, one after the other."""

    def __init__(self) -> None:
        self._count = 0

    @property
    def is_flooding(self) -> bool:
        """Whether too many waited: it is read when the others have had their turn, until nothing of it waits."""
        return self._count > MANY

    @contextlib.contextmanager
    def receiving(self) -> Iterator[None]:
        """The next message is received in the block, which waits for it unless it is there already."""
        waiting = asyncio.get_running_loop().call_soon(self._note_wait)
        self._count += 1
        try:
            yield
        finally:
            waiting.cancel()

    def _note_wait(self) -> None:
        """The loop goes on: the message is not there."""
        self._count = 0
