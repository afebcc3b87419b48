"""TcpAcceptor: devices that connect over TCP. It opens a link for each that Admission allows, and counts the others."""

import asyncio
from collections import Counter

import structlog

from hostlink.config import TcpConfig
from hostlink.hub.hub import Hub
from hostlink.link.link import Link, LinkEnd
from hostlink.listeners.admission import Admission, OpenConnection
from hostlink.logs import printable
from hostlink.transport.base import Transport
from hostlink.transport.keyed import KeyedTransport, read_key

log = structlog.get_logger()

PAUSE_S = 5.0  # a device for which there is no room comes again at once, and nothing will have changed
LOG_INTERVAL_S = 10.0  # whoever is refused comes again at once


class TcpAcceptor:
    """Owns the connections that came over TCP."""

    def __init__(self, hub: Hub, config: TcpConfig) -> None:
        """Starts without connections.

        Raises:
            ConfigError: the key file cannot be used.
        """
        self._hub = hub
        self._admission = Admission(config)
        self._key = None if config.key_file is None else read_key(config.key_file)
        self._links: dict[int, Link] = {}  # oldest first
        self._paused_until_s: dict[str, float] = {}
        self._log_at_s = float("-inf")
        self._unlogged: Counter[str] = Counter()

    def accept(self, transport: Transport) -> None:
        """A device has connected."""
        connections = [
            OpenConnection(link.number, link.address, is_identified=link.session.counts.negotiations > 0)
            for link in self._links.values()
        ]
        verdict = self._admission.judge(transport.address, connections)
        refusal = "too_many_robots" if self._is_paused(transport.address) else verdict.refusal
        if refusal is not None:
            self._count(refusal, transport.peer)
            self._hub.spawn(transport.aclose(), name=f"refusal of {transport.peer}")
            return
        if verdict.evicts is not None:
            leaving = self._links.pop(verdict.evicts)
            self._count(LinkEnd.EVICTED.value, leaving.peer)
            leaving.end(LinkEnd.EVICTED)
        link = self._hub.open(self._guarded(transport))
        self._links[link.number] = link
        self._hub.spawn(self._serve(link), name=f"link to {transport.peer}")

    def _guarded(self, transport: Transport) -> Transport:
        if self._key is None or not self._admission.needs_key(transport.address):
            return transport
        return KeyedTransport(transport, self._key, on_refused=lambda cause: self._count(cause, transport.peer))

    async def _serve(self, link: Link) -> None:
        try:
            if await self._hub.serve(link) is LinkEnd.REFUSED:
                self._paused_until_s[link.address] = asyncio.get_running_loop().time() + PAUSE_S
        finally:
            self._links.pop(link.number, None)

    def _is_paused(self, address: str) -> bool:
        now_s = asyncio.get_running_loop().time()
        self._paused_until_s = {each: until_s for each, until_s in self._paused_until_s.items() if until_s > now_s}
        return address in self._paused_until_s

    def _count(self, cause: str, peer: str) -> None:
        """Count it; log the first, then at most one in LOG_INTERVAL_S, with what came since."""
        self._hub.refused[cause] += 1
        self._unlogged[cause] += 1
        now_s = asyncio.get_running_loop().time()
        if now_s >= self._log_at_s:
            self._log_at_s = now_s + LOG_INTERVAL_S
            log.warning("connection.refused", cause=cause, peer=printable(peer), **self._unlogged)
            self._unlogged.clear()
