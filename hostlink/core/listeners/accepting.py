"""Acceptors of devices on TCP and UDP, serial ports that are opened again when they fail, admission of connections."""

import asyncio
import dataclasses
import ipaddress
import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import structlog

from hostlink.core.config import (
    AUTO,
    MICRO_ROS,
    ROSSERIAL,
    LinkConfig,
    SerialConfig,
    TcpConfig,
    UdpConfig,
    device_address,
)
from hostlink.core.hub.hub import Hub
from hostlink.core.link.link import Link
from hostlink.core.link.serving import Authenticate, LinkEnd, trust
from hostlink.core.listeners.turns import Turn
from hostlink.core.protocol.registry import find_protocol
from hostlink.core.protocol.session import DeviceProtocol
from hostlink.core.runtime.acceptor import EXHAUSTED
from hostlink.core.runtime.listening import spelled
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.logs import printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.core.runtime.rate_limit import RateLimit
from hostlink.core.transport.base import Transport
from hostlink.core.transport.connection import ignore
from hostlink.core.transport.keyed import HELLO, exchange_proofs, read_key
from hostlink.core.transport.port_users import PortUsers, users_of
from hostlink.core.transport.serial import SerialTransport, open_serial
from hostlink.core.transport.udp import Datagram, UdpPort, UdpTransport

log = structlog.get_logger()

PAUSE_S = 5.0  # a refused device reconnects at once, when there is still no room

OPENED_A_SECOND = 20.0  # new sessions of each kind, and burst size: each costs about a millisecond
# Answers without a session, of each kind. They are a fifth longer than what asks for them, with the headers of both: to
# forged addresses no more than 11 kB/s.
PINGS_A_SECOND = 200.0
RESUME_S = 0.1  # between two remembered devices: half of the openings are left to others
INVITE_S = 2.0  # the interval at which a link repeats an unanswered topic request

BITS_A_BYTE = 10  # 8N1
RETRY_S = 1.0  # interval of the search for a removed port
SHARING_S = 5.0  # interval of the search for other programs at a port, which reads some thousand links of /proc

# -- admission --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class OpenConnection:
    """One accepted connection."""

    number: int
    address: str
    is_identified: bool  # true for a device within a second; an identified connection is never evicted


@dataclass(frozen=True, slots=True)
class Verdict:
    """Decision about a new connection: accepted, refused with a reason, or accepted in place of another one."""

    refusal: str | None = None
    evicts: int | None = None


class ConnectionAdmission:
    """Rules for a new connection.

    | new connection                    | decision                                                                 |
    |-----------------------------------|--------------------------------------------------------------------------|
    | from outside the allowed networks | refused: not_allowed                                                     |
    | over the bound of its address     | refused: too_many_of_address                                             |
    | over the bound of all             | the oldest unidentified connection of the address with most of them is   |
    |                                   | evicted, if the new address has none, or at least two fewer;             |
    |                                   | otherwise refused: too_many                                              |

    A connection is unidentified until its device has announced topics.
    """

    def __init__(self, config: TcpConfig | UdpConfig) -> None:
        self._config = config
        self._allowed = [ipaddress.ip_network(network) for network in config.allow]
        self._keyless = [ipaddress.ip_network(network) for network in config.keyless]

    def judge(self, address: str, connections: Sequence[OpenConnection], *, room: int | None = None) -> Verdict:
        """Decide about a new connection.

        `connections` are the accepted ones, oldest first. `room` replaces the bound of all connections.
        """
        most = self._config.max_connections if room is None else room
        if not self.allows(address):
            return Verdict(refusal="not_allowed")
        if sum(connection.address == address for connection in connections) >= self._config.max_connections_per_address:
            return Verdict(refusal="too_many_of_address")
        if len(connections) < most:
            return Verdict()
        unidentified = [connection for connection in connections if not connection.is_identified]
        counts = Counter(connection.address for connection in unidentified)
        oldest = max(
            unidentified, key=lambda connection: counts[connection.address], default=None
        )  # the first of equals
        # Otherwise two crowds would evict each other without end.
        if oldest is None or 0 < counts[address] >= counts[oldest.address] - 1:
            return Verdict(refusal="too_many")
        return Verdict(evicts=oldest.number)

    def allows(self, address: str) -> bool:
        """Whether an address is in the allowed networks."""
        return not self._allowed or is_within(address, self._allowed)

    def needs_key(self, address: str) -> bool:
        """Whether a device at this address must prove the key, if there is one."""
        return not is_within(address, self._keyless)


def is_within(address: str, networks: Sequence[ipaddress.IPv4Network | ipaddress.IPv6Network]) -> bool:
    """Whether one of the networks contains the address."""
    found = ipaddress.ip_address(address)
    return any(found in network for network in networks)


# -- acceptors --------------------------------------------------------------------------------------------------------


class _Acceptor:
    """Both acceptors: the admission, the key, and counts and pauses of refused peers."""

    def __init__(self, hub: Hub, config: TcpConfig | UdpConfig, way: str) -> None:
        """Create the acceptor. `way`: tcp or udp.

        Raises:
            ConfigError: the key file cannot be used, or the protocol is unknown.
        """
        self._hub, self._way = hub, way
        self._protocol = find_protocol(config.protocol, way, velocity_stream=hub.config.micro_ros.velocity_stream)
        self._admission = ConnectionAdmission(config)
        self._key = None if config.key_file is None else read_key(config.key_file, f"{way}.key_file")
        self._paused_until_s: dict[str, float] = {}
        self._lines = Budget()

    def note_exhausted(self) -> None:
        """Count a connection that waits because no descriptor is free. Log at most one line per LOG_INTERVAL_S."""
        self._hub.counts.refused["no_descriptors"] += 1
        if counts := self._lines.due("descriptors.exhausted", loop_time_s(), "tries"):
            log.error("descriptors.exhausted", **counts)

    def _pause(self, address: str) -> None:
        """Refuse this address for PAUSE_S."""
        self._paused_until_s[address] = loop_time_s() + PAUSE_S

    def _is_paused(self, address: str) -> bool:
        now_s = loop_time_s()
        self._paused_until_s = {each: until_s for each, until_s in self._paused_until_s.items() if until_s > now_s}
        return address in self._paused_until_s

    def _count(self, cause: str, peer: str, address: str) -> None:
        """Count a refusal. Log the first one, then at most one line per LOG_INTERVAL_S with the counts since."""
        self._hub.counts.refused[cause] += 1
        now_s = loop_time_s()
        self._hub.diagnoses.refused.note(self._way, address, cause, now_s)
        if counts := self._lines.due("connection.refused", now_s, cause):
            log.warning("connection.refused", cause=cause, peer=printable(peer), **counts)

    def _evict(self, link: Link) -> None:
        self._count(LinkEnd.EVICTED.value, link.peer, link.address)
        link.end(LinkEnd.EVICTED)

    def _needs_key(self, address: str) -> bool:
        return self._key is not None and self._admission.needs_key(address)

    def _authentication(self, transport: Transport, on_proven: Callable[[], None] = ignore) -> Authenticate:
        """Return what a device must do before its protocol begins. `on_proven` is called when it has proven the key."""
        if self._key is None or not self._needs_key(transport.address):
            return trust
        count = partial(self._count, peer=transport.peer, address=transport.address)
        return partial(exchange_proofs, transport, self._key, on_refused=count, on_proven=on_proven)


# -- tcp acceptor -----------------------------------------------------------------------------------------------------


class TcpAcceptor(_Acceptor):
    """Acceptor of TCP connections."""

    def __init__(self, hub: Hub, config: TcpConfig) -> None:
        super().__init__(hub, config, "tcp")
        self.is_prompt = self._protocol.writes_in_parts  # as for `serve_tcp`
        self._links: dict[int, Link] = {}  # oldest first

    def accept(self, transport: Transport) -> None:
        """Accept or refuse a new connection."""
        connections = [
            OpenConnection(link.number, link.address, is_identified=link.session.counts.negotiations > 0)
            for link in self._links.values()
        ]
        verdict = self._admission.judge(transport.address, connections)
        refusal = "too_many_robots" if self._is_paused(transport.address) else verdict.refusal
        if refusal is not None:
            self._count(refusal, transport.peer, transport.address)
            self._hub.spawn(transport.aclose(), name=f"refusal of {transport.peer}")
            return
        if verdict.evicts is not None:
            self._evict(self._links.pop(verdict.evicts))
        link = self._hub.links.open(transport, self._protocol)
        self._links[link.number] = link
        self._hub.spawn(self._serve(link, self._authentication(transport)), name=f"link to {transport.peer}")

    async def _serve(self, link: Link, authenticate: Authenticate) -> None:
        try:
            if await self._hub.links.serve(link, authenticate) is LinkEnd.REFUSED:
                self._pause(link.address)
        finally:
            self._links.pop(link.number, None)


# -- udp acceptor -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Session:
    link: Link
    transport: UdpTransport

    def as_connection(self) -> OpenConnection:
        """Describe the session for the admission. A verified device counts as identified, so it is not evicted."""
        is_identified = self.transport.is_verified or self.link.session.counts.negotiations > 0
        return OpenConnection(self.link.number, self.link.address, is_identified=is_identified)


class UdpAcceptor(_Acceptor):
    """Acceptor of UDP sessions."""

    def __init__(self, hub: Hub, config: UdpConfig) -> None:
        super().__init__(hub, config, "udp")
        self._config = config
        self._trusted = [ipaddress.ip_network(network) for network in config.trusted]
        self._devices = config.device_addresses()
        self._sessions: dict[tuple[str, int], _Session] = {}  # by source address, oldest first
        self._openings = RateLimit(OPENED_A_SECOND)  # of verified and of other addresses
        self._pings = RateLimit(PINGS_A_SECOND)
        self._foreign = "not_" + "".join(each if each.isalnum() else "_" for each in self._protocol.name.lower())

    def receive(self, port: UdpPort, datagram: Datagram) -> bool:
        """Handle a datagram from the shared port. Return whether it opened a session."""
        session = self._sessions.get(datagram.source[:2])
        if session is not None:
            session.transport.feed(datagram.data)
            return False
        peer, memories = spelled(*datagram.source[:2]), self._hub.links.memories
        if self._is_greeting(datagram):
            memories.forget(self._protocol, "udp", peer)
            return self._open(port, datagram)
        if memories.has(self._protocol, "udp", peer):
            return self._open(port, datagram)
        if self._is_answered(port, datagram):
            return False
        self._hub.counts.datagrams_dropped[self._foreign] += 1
        refused, address, now_s = self._hub.diagnoses.refused, datagram.source[0], loop_time_s()
        if self._protocol.is_of_other_host(datagram.data):
            refused.note_session("udp", address, now_s)
        else:
            refused.note("udp", address, self._foreign, now_s)
        return False

    async def invite(self, ports: Sequence[UdpPort]) -> None:
        """Send the invitation to each configured device without a session, repeatedly, until cancelled."""
        while True:
            for address in self._devices:
                is_ipv6 = ":" in address[0]
                port = next((each for each in ports if (":" in each.address[0]) == is_ipv6), None)
                if port is not None and address not in self._sessions:
                    port.send(self._protocol.invitation, address)
            await asyncio.sleep(INVITE_S)

    async def resume(self, ports: Sequence[UdpPort]) -> None:
        """Open a session with each device that is remembered: some of them only listen."""
        for peer in self._hub.links.memories.peers(self._protocol, "udp"):
            try:
                address = device_address(peer)
            except ValueError:
                log.warning("boards.damaged", peer=printable(peer), reason="it is no address and port")
                self._hub.links.memories.forget(self._protocol, "udp", peer)
                continue
            port = next((each for each in ports if (":" in each.address[0]) == (":" in address[0])), None)
            if port is not None and address not in self._sessions and self._admission.allows(address[0]):
                self._open(port, Datagram(b"", address, port.address))
                await asyncio.sleep(RESUME_S)

    def _is_greeting(self, datagram: Datagram) -> bool:
        return (
            datagram.data == HELLO if self._needs_key(datagram.source[0]) else self._protocol.is_greeting(datagram.data)
        )

    def _is_answered(self, port: UdpPort, datagram: Datagram) -> bool:
        """Answer a datagram that only asks whether a host is there, or refuse to. Return whether it is one."""
        address = datagram.source[0]
        answer = b"" if self._needs_key(address) else self._protocol.answer_ping(datagram.data)
        if not answer:
            return False
        if not self._admission.allows(address):
            self._count("not_allowed", spelled(*datagram.source[:2]), address)
        elif not self._pings.allows(self._is_trusted(datagram.source[:2]), loop_time_s()):
            self._count("too_fast", spelled(*datagram.source[:2]), address)
        else:
            port.send(answer, datagram.source)
        return True

    def _open(self, port: UdpPort, datagram: Datagram) -> bool:
        address, peer = datagram.source[0], spelled(*datagram.source[:2])
        is_verified = not self._needs_key(address) and self._is_trusted(datagram.source[:2])
        refusal = self._refusal(address, peer, is_verified=is_verified)
        if refusal is not None:
            self._count(refusal, peer, address)
            return False
        try:
            connection = port.connect(datagram)
        except OSError as error:
            cause = "no_descriptor" if error.errno in EXHAUSTED else "unreachable"
            self._count(cause, peer, address)
            return False
        transport = UdpTransport(
            connection,
            datagram,
            is_verified=is_verified,
            dropped=self._hub.counts.datagrams_dropped,
            on_other=lambda other: self.receive(port, other),
            on_limited=lambda: self._count("unverified", peer, address),
            keeps_datagrams=self._protocol.keeps_datagrams,
        )
        self._hub.diagnoses.refused.forget_session("udp", address)
        session = _Session(self._hub.links.open(transport, self._protocol), transport)
        self._sessions[datagram.source[:2]] = session
        self._hub.spawn(self._serve(session, datagram.source[:2]), name=f"link to {peer}")
        return True

    def _is_trusted(self, source: tuple[str, int]) -> bool:
        return source in self._devices or is_within(source[0], self._trusted)

    def _refusal(self, address: str, peer: str, *, is_verified: bool) -> str | None:
        """Return why the peer gets no session, or None. May evict another session to make room."""
        if self._is_paused(peer):
            return "too_many_robots"
        if not self._openings.allows(is_verified, loop_time_s()):
            return "too_fast"
        verified = [each for each in self._sessions.values() if each.transport.is_verified]
        others = [each for each in self._sessions.values() if not each.transport.is_verified]
        most = self._config.max_connections
        room = most if is_verified else min(most // 2, most - len(verified))
        rivals = [*verified, *others] if is_verified else others
        verdict = self._admission.judge(address, [each.as_connection() for each in rivals], room=room)
        if verdict.evicts is not None:
            self._evict(next(each.link for each in rivals if each.link.number == verdict.evicts))
        return verdict.refusal

    async def _serve(self, session: _Session, source: tuple[str, int]) -> None:
        try:
            authenticate = self._authentication(session.transport, session.transport.verify)
            if await self._hub.links.serve(session.link, authenticate) is LinkEnd.REFUSED:
                self._pause(session.link.peer)
        finally:
            if self._sessions.get(source) is session:
                del self._sessions[source]


# -- serial ports -----------------------------------------------------------------------------------------------------


async def serve_serial(
    hub: Hub, config: SerialConfig, *, retry_s: float = RETRY_S, on_tried: Callable[[], None] = lambda: None
) -> None:
    """Serve the serial port until cancelled. Open it again after `retry_s` when it fails.

    `on_tried` is called each time after the port was opened, or could not be opened.
    """
    logged = ""
    while True:
        with hub.isolation.around("task", task=f"serial port {config.name}"):
            reason = await _serve_once(hub, config, on_tried)
            if reason and reason != logged:
                found = hub.diagnoses.ports[config.name]
                log.warning("serial.waiting", port=config.name, reason=reason, next_step=found.next_step)
            logged = reason
            on_tried()
        await asyncio.sleep(retry_s)


async def _serve_once(hub: Hub, config: SerialConfig, on_open: Callable[[], None]) -> str:
    """Serve the port to the end of its link. Return the reason when it cannot be opened."""
    try:
        transport = await open_serial(config)
    except OSError as error:
        hub.diagnoses.observe_port(config.name, error)
        return error.strerror or str(error)
    hub.diagnoses.observe_port(config.name, None)
    on_open()
    protocols, found = protocols_of(hub, config), b""
    while True:
        protocol, other = protocols[0], protocols[-1]
        turn = Turn(transport, other, first=found)
        link = hub.links.open(transport if protocol is other else turn, protocol, _link_config(hub, config))
        turn.count_own, turn.on_other = partial(_frames_of, link), partial(link.end, LinkEnd.OTHER_PROTOCOL)
        hub.diagnoses.observe_baud(link, transport.baud)
        async with asyncio.TaskGroup() as tasks:
            helpers = (
                tasks.create_task(_try_bauds(hub, transport, link, config), name=f"baud rate of {config.name}"),
                tasks.create_task(_watch_sharing(hub, transport, link), name=f"other programs at {config.name}"),
                tasks.create_task(_invite(transport, link, other), name=f"invitation at {config.name}"),
            )
            await hub.links.serve(link)
            for helper in helpers:
                helper.cancel()
        found = turn.taken
        if not found:
            return ""
        hub.links.memories.forget(protocol, "serial", "", config.name)
        log.info("serial.protocol_found", port=config.name, protocol=other.name)
        protocols.reverse()


def protocols_of(hub: Hub, config: SerialConfig) -> list[DeviceProtocol]:
    """Return the protocols that take turns at a port, the likeliest first.

    Raises:
        ConfigError: the configured one is unknown.
    """
    names = (ROSSERIAL, MICRO_ROS) if config.protocol == AUTO else (config.protocol,)
    stream, memories = hub.config.micro_ros.velocity_stream, hub.links.memories
    protocols = [find_protocol(each, "serial", velocity_stream=stream) for each in names]
    return sorted(protocols, key=lambda each: not memories.has(each, "serial", "", config.name))


def _frames_of(link: Link) -> int:
    return link.session.counts.frames_from_device


async def _invite(transport: SerialTransport, link: Link, other: DeviceProtocol) -> None:
    """Invite a device of the other protocol that waits to be invited, while the port is silent."""
    while other.name != link.session.protocol and other.invitation:
        await asyncio.sleep(INVITE_S)
        if link.silent_s >= INVITE_S:
            transport.write(other.invitation)


def _link_config(hub: Hub, config: SerialConfig) -> LinkConfig:
    """Return the settings of a serial link. Silence does not end it, because reopening a port may reset a board.

    A removed port raises an error instead.
    """
    uart_bytes_s = hub.config.link.uart_bytes_s or min(config.bauds) // BITS_A_BYTE
    return dataclasses.replace(hub.config.link, idle_timeout_s=None, silence_timeout_s=None, uart_bytes_s=uart_bytes_s)


async def _watch_sharing(hub: Hub, transport: SerialTransport, link: Link) -> None:
    """Look for other programs at the port: once, then while bytes are missing or damaged."""
    users, lost, damage = PortUsers(), 0, -1
    while True:
        await asyncio.sleep(SHARING_S)
        has_changed, lost_now, counts = transport.keep_settings(), transport.lost_reads, link.session.counts
        damage_now = counts.skipped_bytes + sum(link.session.rejected.values())
        is_troubled = has_changed or lost_now > lost or damage_now > damage or counts.bytes_from_device == 0
        if is_troubled or users.names:
            users = await asyncio.to_thread(users_of, link.peer)
        hub.diagnoses.observe_sharing(
            link,
            users.names,
            has_login=users.has_login,
            lost_reads=lost_now - lost,
            has_changed_settings=has_changed,
        )
        lost, damage = lost_now, damage_now


async def _try_bauds(hub: Hub, transport: SerialTransport, link: Link, config: SerialConfig) -> None:
    """Try the baud rates in turn until a whole frame was received."""
    at = config.bauds.index(transport.baud)
    rates = config.bauds[at:] + config.bauds[:at]
    for baud in itertools.cycle(rates) if len(rates) > 1 else ():
        log.debug("serial.baud_tried", port=config.name, baud=baud)
        try:
            transport.set_baud(baud)
        except OSError:  # the port was removed; the link ends by its own error
            return
        hub.diagnoses.observe_baud(link, baud)
        await asyncio.sleep(config.baud_try_s)
        if link.session.counts.frames_from_device:
            log.info("serial.baud_found", port=config.name, baud=baud)
            return
