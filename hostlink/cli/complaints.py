"""What asyncio, aiohttp and other libraries complain of goes into the daemon's log, as often as a person can read it.

By themselves they write a traceback of kilobytes for each request that is no HTTP, and each try to accept a connection.
"""

import asyncio
import contextlib
import logging
from collections import Counter
from collections.abc import AsyncIterator, Callable
from typing import Any

import structlog
from aiohttp.http_exceptions import HttpProcessingError

from hostlink.acceptor import EXHAUSTED
from hostlink.logs import printable

log = structlog.get_logger()

LOG_INTERVAL_S = 10.0
MAX_KINDS = 64  # with a count each
NO_DESCRIPTORS = "no_descriptors"


@contextlib.asynccontextmanager
async def complaints_logged(refused: Counter[str]) -> AsyncIterator[None]:
    """For the length of the block. `refused`: counts the connections that could not be accepted."""
    loop = asyncio.get_running_loop()
    budget = Budget(loop.time)
    before, handler = loop.get_exception_handler(), _LibraryLog(budget)
    loop.set_exception_handler(_LoopErrors(budget, refused))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
        loop.set_exception_handler(before)


class Budget:
    """The first complaint of a kind is logged, then one in LOG_INTERVAL_S with their count."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._since: Counter[str] = Counter()
        self._log_at_s: dict[str, float] = {}

    def due(self, kind: str) -> int:
        """How many there were since the last line; 0: no line now."""
        if kind not in self._log_at_s and len(self._log_at_s) >= MAX_KINDS:
            kind = "others"
        self._since[kind] += 1
        now_s = self._clock()
        if now_s < self._log_at_s.get(kind, float("-inf")):
            return 0
        self._log_at_s[kind] = now_s + LOG_INTERVAL_S
        return self._since.pop(kind)


class _LoopErrors:
    """An exception handler of the loop."""

    def __init__(self, budget: Budget, refused: Counter[str]) -> None:
        self._budget, self._refused = budget, refused

    def __call__(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if isinstance(error, OSError) and error.errno in EXHAUSTED and "socket" in context:
            self._refused[NO_DESCRIPTORS] += 1
            if count := self._budget.due(NO_DESCRIPTORS):
                log.error("descriptors.exhausted", reason=error.strerror, tries=count)
        elif count := self._budget.due(f"loop {type(error).__name__}"):
            log.error("loop.error", reason=printable(str(context.get("message", ""))), count=count, exc_info=error)


class _LibraryLog(logging.Handler):
    """A handler of the standard library's log, which nothing of hostlink's own uses."""

    def __init__(self, budget: Budget) -> None:
        super().__init__(logging.WARNING)
        self._budget = budget

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        count = self._budget.due(f"{record.name} {type(error).__name__}")
        if not count:
            return
        if isinstance(error, HttpProcessingError):
            log.warning("client.malformed", reason=printable(error.message.partition("\n")[0]), count=count)
        else:
            text = printable(record.getMessage())
            log.error("library.complained", library=record.name, text=text, count=count, exc_info=error)
