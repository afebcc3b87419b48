"""Complaints of libraries and of the event loop, as lines of the daemon's log."""

import asyncio
import contextlib
import logging
import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

import structlog

from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.logs import printable

log = structlog.get_logger()


@contextlib.asynccontextmanager
async def complaints_logged() -> AsyncIterator[None]:
    """Log complaints of libraries and of the event loop, for the length of the block."""
    loop = asyncio.get_running_loop()
    budget = Budget()
    before, handler = loop.get_exception_handler(), _LibraryLog(budget, loop.time)
    loop.set_exception_handler(_LoopErrors(budget))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
        loop.set_exception_handler(before)


class _LoopErrors:
    """Exception handler of the event loop."""

    def __init__(self, budget: Budget) -> None:
        self._budget = budget

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if counts := self._budget.due(f"loop {type(error).__name__}", loop.time()):
            log.error("loop.error", reason=printable(str(context.get("message", ""))), **counts, exc_info=error)


class _LibraryLog(logging.Handler):
    """Handler of the standard library's log, which only libraries use."""

    def __init__(self, budget: Budget, clock: Callable[[], float]) -> None:
        super().__init__(logging.WARNING)
        self._budget, self._clock = budget, clock

    def emit(self, record: logging.LogRecord) -> None:
        error: Any = record.exc_info[1] if record.exc_info else None
        counts = self._budget.due(f"{record.name} {type(error).__name__}", self._clock())
        if not counts:
            return
        if _is_malformed(error):
            log.warning("client.malformed", reason=printable(str(error.message).partition("\n")[0]), **counts)
        else:
            text = printable(record.getMessage())
            log.error("library.complained", library=record.name, text=text, **counts, exc_info=error)


def _is_malformed(error: object) -> bool:
    """Whether an error of aiohttp tells of a client's input. A daemon without a gateway does not import aiohttp."""
    module = sys.modules.get("aiohttp.http_exceptions")
    return module is not None and isinstance(error, module.HttpProcessingError)
