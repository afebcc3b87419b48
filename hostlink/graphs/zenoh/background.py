"""Background: a thread for answers, which wait for a neighbour who calls more than he reads, until he is cut off."""

import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager
from typing import Any


class Background:
    """Work is done in the order of the calls, and not after `close`."""

    def __init__(self, guarded: Callable[[str], AbstractContextManager[None]]) -> None:
        """`guarded`: keeps what Zenoh raises from the thread."""
        self._guarded = guarded
        self._thread = ThreadPoolExecutor(1, "zenoh")

    def replies(self, query: Any) -> tuple[Callable[..., None], Callable[[], None]]:
        """How a query is answered, and how it is ended."""

        def reply(payload: bytes, *, key: str = "", attachment: bytes | None = None) -> None:
            self._run(lambda: query.reply(key or str(query.key_expr), payload, attachment=attachment))

        def close() -> None:
            self._run(query.drop)

        return reply, close

    def close(self) -> None:
        """Do nothing more; it waits for nobody."""
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _run(self, work: Callable[[], None]) -> None:
        def run() -> None:
            with self._guarded("reply"):
                work()

        with contextlib.suppress(RuntimeError):  # it is closed
            self._thread.submit(run)
