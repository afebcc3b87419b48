"""Refusals: connections that were not served, counted and logged; addresses that must wait before they try again."""

import asyncio
from collections import Counter

import structlog

from hostlink.hub.hub import Hub
from hostlink.logs import printable

log = structlog.get_logger()

PAUSE_S = 5.0  # a device for which there is no room comes again at once, and nothing will have changed
LOG_INTERVAL_S = 10.0  # whoever is refused comes again at once


class Refusals:
    """What one acceptor has refused."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._paused_until_s: dict[str, float] = {}
        self._log_at_s = float("-inf")
        self._unlogged: Counter[str] = Counter()

    def pause(self, address: str) -> None:
        """Refuse this address for PAUSE_S."""
        self._paused_until_s[address] = _now_s() + PAUSE_S

    def is_paused(self, address: str) -> bool:
        """Whether its pause is not over."""
        now_s = _now_s()
        self._paused_until_s = {each: until_s for each, until_s in self._paused_until_s.items() if until_s > now_s}
        return address in self._paused_until_s

    def count(self, cause: str, peer: str) -> None:
        """Count it; log the first, then at most one in LOG_INTERVAL_S, with what came since."""
        self._hub.counts.refused[cause] += 1
        self._unlogged[cause] += 1
        now_s = _now_s()
        if now_s >= self._log_at_s:
            self._log_at_s = now_s + LOG_INTERVAL_S
            log.warning("connection.refused", cause=cause, peer=printable(peer), **self._unlogged)
            self._unlogged.clear()


def _now_s() -> float:
    return asyncio.get_running_loop().time()
