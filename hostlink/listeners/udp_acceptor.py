"""UdpAcceptor: devices over UDP. An address has a session from its first whole frame until it falls silent.

| a datagram of an address without a session   | what happens                                                         |
|----------------------------------------------|----------------------------------------------------------------------|
| with no whole frame (with a key: no hello)   | it is dropped, and nothing is sent                                   |
| over OPENED_A_SECOND of its kind             | refused: too_fast                                                    |
| over a bound                                 | as over TCP (Admission); no session that is verified is evicted      |
| else                                         | a session; one that is not verified is sent no more than it has sent |

Verified is whoever is in a trusted network, is named in the configuration, or has proven the key: a source address
alone can be anybody's.
"""

import asyncio
import errno
import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass

from hostlink.config import UdpConfig
from hostlink.hub.hub import Hub
from hostlink.link.greeting import INVITATION, has_frame
from hostlink.link.link import Authenticate, Link, LinkEnd, trust
from hostlink.listeners.admission import Admission, OpenConnection, is_within
from hostlink.listeners.refusals import Refusals
from hostlink.transport.keyed import HELLO, KeyProof, read_key
from hostlink.transport.tcp import spelled
from hostlink.transport.udp import UdpTransport
from hostlink.transport.udp_port import Datagram, UdpPort

OPENED_A_SECOND = 20.0  # sessions of each kind, and as many at once: each costs about a millisecond
INVITE_S = 2.0  # as often as a link requests the topics of a device that does not answer
_NO_DESCRIPTOR = frozenset({errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM})


@dataclass(frozen=True, slots=True)
class _Session:
    link: Link
    transport: UdpTransport

    def as_connection(self) -> OpenConnection:
        """As Admission has it: who is verified is not evicted."""
        is_identified = self.transport.is_verified or self.link.session.counts.negotiations > 0
        return OpenConnection(self.link.number, self.link.address, is_identified=is_identified)


class UdpAcceptor:
    """Owns the sessions that began over UDP."""

    def __init__(self, hub: Hub, config: UdpConfig) -> None:
        """Starts without sessions.

        Raises:
            ConfigError: the key file cannot be used.
        """
        self._hub, self._config = hub, config
        self._admission = Admission(config)
        self._key = None if config.key_file is None else read_key(config.key_file, "udp.key_file")
        self._trusted = [ipaddress.ip_network(network) for network in config.trusted]
        self._devices = config.device_addresses()
        self._sessions: dict[tuple[str, int], _Session] = {}  # by where their datagrams come from, oldest first
        self._refusals = Refusals(hub)
        self._rates = {is_verified: _Rate() for is_verified in (False, True)}

    def receive(self, port: UdpPort, datagram: Datagram) -> bool:
        """A datagram came that no session's own socket received; returns whether it has opened one."""
        session = self._sessions.get(datagram.source[:2])
        if session is not None:
            session.transport.feed(datagram.data)
            return False
        if self._is_greeting(datagram):
            return self._open(port, datagram)
        self._hub.counts.datagrams_dropped["not_rosserial"] += 1
        return False

    async def invite(self, ports: Sequence[UdpPort]) -> None:
        """Send something to each device that waits for it and has no session, again and again, until cancelled."""
        while True:
            for address in self._devices:
                is_ipv6 = ":" in address[0]
                port = next((each for each in ports if (":" in each.address[0]) == is_ipv6), None)
                if port is not None and address not in self._sessions:
                    port.send(INVITATION, address)
            await asyncio.sleep(INVITE_S)

    def _is_greeting(self, datagram: Datagram) -> bool:
        return datagram.data == HELLO if self._needs_key(datagram.source[0]) else has_frame(datagram.data)

    def _needs_key(self, address: str) -> bool:
        return self._key is not None and self._admission.needs_key(address)

    def _open(self, port: UdpPort, datagram: Datagram) -> bool:
        address, peer = datagram.source[0], spelled(*datagram.source[:2])
        is_verified = not self._needs_key(address) and self._is_trusted(datagram.source[:2])
        refusal = self._refusal(address, peer, is_verified=is_verified)
        if refusal is not None:
            self._refusals.count(refusal, peer)
            return False
        try:
            connection = port.connect(datagram)
        except OSError as error:
            self._refusals.count("no_descriptor" if error.errno in _NO_DESCRIPTOR else "unreachable", peer)
            return False
        transport = UdpTransport(
            connection,
            datagram,
            is_verified=is_verified,
            dropped=self._hub.counts.datagrams_dropped,
            on_other=lambda other: self.receive(port, other),
            on_limited=lambda: self._refusals.count("unverified", peer),
        )
        session = _Session(self._hub.links.open(transport), transport)
        self._sessions[datagram.source[:2]] = session
        self._hub.spawn(self._serve(session, datagram.source[:2]), name=f"link to {peer}")
        return True

    def _is_trusted(self, source: tuple[str, int]) -> bool:
        return source in self._devices or is_within(source[0], self._trusted)

    def _refusal(self, address: str, peer: str, *, is_verified: bool) -> str | None:
        """Why it gets no session; another may be ended for it."""
        if self._refusals.is_paused(peer):
            return "too_many_robots"
        if not self._rates[is_verified].allows(asyncio.get_running_loop().time()):
            return "too_fast"
        verified = [each for each in self._sessions.values() if each.transport.is_verified]
        others = [each for each in self._sessions.values() if not each.transport.is_verified]
        most = self._config.max_connections
        room = most if is_verified else min(most // 2, most - len(verified))
        beside = [*verified, *others] if is_verified else others
        verdict = self._admission.judge(address, [each.as_connection() for each in beside], room=room)
        if verdict.evicts is not None:
            self._evict(next(each for each in beside if each.link.number == verdict.evicts))
        return verdict.refusal

    def _evict(self, session: _Session) -> None:
        self._refusals.count(LinkEnd.EVICTED.value, session.link.peer)
        session.link.end(LinkEnd.EVICTED)

    def _authentication(self, transport: UdpTransport) -> Authenticate:
        if self._key is None or not self._needs_key(transport.address):
            return trust
        proof = KeyProof(
            transport,
            self._key,
            on_refused=lambda cause: self._refusals.count(cause, transport.peer),
            on_proven=transport.verify,
        )
        return proof.authenticate

    async def _serve(self, session: _Session, source: tuple[str, int]) -> None:
        try:
            if await self._hub.links.serve(session.link, self._authentication(session.transport)) is LinkEnd.REFUSED:
                self._refusals.pause(session.link.peer)
        finally:
            if self._sessions.get(source) is session:
                del self._sessions[source]


class _Rate:
    """At most OPENED_A_SECOND, and as many at once."""

    def __init__(self) -> None:
        self._left = OPENED_A_SECOND
        self._at_s = 0.0

    def allows(self, now_s: float) -> bool:
        self._left = min(OPENED_A_SECOND, self._left + (now_s - self._at_s) * OPENED_A_SECOND)
        self._at_s = now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True
