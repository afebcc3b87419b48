"""TcpAcceptor: devices that connect over TCP. It opens a link for each that Admission allows, and counts the others."""

from hostlink.config import TcpConfig
from hostlink.hub.hub import Hub
from hostlink.link.link import Authenticate, Link, LinkEnd, trust
from hostlink.listeners.admission import Admission, OpenConnection
from hostlink.listeners.refusals import Refusals
from hostlink.transport.base import Transport
from hostlink.transport.keyed import KeyProof, read_key


class TcpAcceptor:
    """Owns the connections that came over TCP."""

    def __init__(self, hub: Hub, config: TcpConfig) -> None:
        """Starts without connections.

        Raises:
            ConfigError: the key file cannot be used.
        """
        self._hub = hub
        self._admission = Admission(config)
        self._key = None if config.key_file is None else read_key(config.key_file, "tcp.key_file")
        self._links: dict[int, Link] = {}  # oldest first
        self._refusals = Refusals(hub)

    def accept(self, transport: Transport) -> None:
        """A device has connected."""
        connections = [
            OpenConnection(link.number, link.address, is_identified=link.session.counts.negotiations > 0)
            for link in self._links.values()
        ]
        verdict = self._admission.judge(transport.address, connections)
        refusal = "too_many_robots" if self._refusals.is_paused(transport.address) else verdict.refusal
        if refusal is not None:
            self._refusals.count(refusal, transport.peer)
            self._hub.spawn(transport.aclose(), name=f"refusal of {transport.peer}")
            return
        if verdict.evicts is not None:
            leaving = self._links.pop(verdict.evicts)
            self._refusals.count(LinkEnd.EVICTED.value, leaving.peer)
            leaving.end(LinkEnd.EVICTED)
        link = self._hub.links.open(transport)
        self._links[link.number] = link
        self._hub.spawn(self._serve(link, self._authentication(transport)), name=f"link to {transport.peer}")

    def _authentication(self, transport: Transport) -> Authenticate:
        if self._key is None or not self._admission.needs_key(transport.address):
            return trust
        proof = KeyProof(transport, self._key, on_refused=lambda cause: self._refusals.count(cause, transport.peer))
        return proof.authenticate

    async def _serve(self, link: Link, authenticate: Authenticate) -> None:
        try:
            if await self._hub.links.serve(link, authenticate) is LinkEnd.REFUSED:
                self._refusals.pause(link.address)
        finally:
            self._links.pop(link.number, None)
