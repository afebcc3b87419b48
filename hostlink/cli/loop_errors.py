"""LoopErrors: what asyncio has to complain of goes into the daemon's log, as often as a person can read it."""

import asyncio
from collections import Counter
from typing import Any

import structlog

from hostlink.acceptor import EXHAUSTED
from hostlink.logs import printable

log = structlog.get_logger()

LOG_INTERVAL_S = 10.0
NO_DESCRIPTORS = "no_descriptors"


class LoopErrors:
    """An exception handler of the loop. The first of a kind is logged, then one in LOG_INTERVAL_S with their count."""

    def __init__(self, refused: Counter[str]) -> None:
        """`refused`: counts the connections that could not be accepted."""
        self._refused = refused
        self._since: Counter[str] = Counter()
        self._log_at_s: dict[str, float] = {}

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if isinstance(error, OSError) and error.errno in EXHAUSTED and "socket" in context:
            self._refused[NO_DESCRIPTORS] += 1
            if count := self._due(NO_DESCRIPTORS, loop.time()):
                log.error("descriptors.exhausted", reason=error.strerror, tries=count)
        elif count := self._due(type(error).__name__, loop.time()):
            log.error("loop.error", reason=printable(str(context.get("message", ""))), count=count, exc_info=error)

    def _due(self, kind: str, now_s: float) -> int:
        """How many there were since the last line; 0: no line now."""
        self._since[kind] += 1
        if now_s < self._log_at_s.get(kind, float("-inf")):
            return 0
        self._log_at_s[kind] = now_s + LOG_INTERVAL_S
        return self._since.pop(kind)
