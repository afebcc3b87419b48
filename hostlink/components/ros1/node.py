"""The daemon as one node of a ROS 1 graph: it listens, takes part in both graphs, and answers calls of other nodes."""

import asyncio
import contextlib
import ipaddress
import os
import socket
import urllib.parse
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any, ClassVar

import structlog
from aiohttp import web

from hostlink.components.graphs.hub_source import HubSource
from hostlink.components.ros1.connections import MakeProtocol, Port, Wire
from hostlink.components.ros1.graph_sync import GraphSync
from hostlink.components.ros1.local_node import GROUP, LocalNode
from hostlink.components.ros1.master import MasterParameters, Registrar
from hostlink.components.ros1.names import NameMap, NameResolver, joined
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.tcpros import ANY
from hostlink.components.ros1.xml_rpc import (
    ERROR,
    MASTER_PORT,
    SUCCESS,
    BadXml,
    decode_call,
    encode_answer,
    encode_fault,
)
from hostlink.core.config import check_port
from hostlink.core.host import Component, Connections, Graph, Host, Message
from hostlink.core.messages.catalog import CLOCK, CLOCK_TYPE, decode_clock
from hostlink.core.runtime.acceptor import why
from hostlink.core.runtime.cancellation import raise_if_cancelled
from hostlink.core.runtime.forwarding_protocol import ForwardingProtocol
from hostlink.core.runtime.listening import address_towards, spelled
from hostlink.core.runtime.logs import printable
from hostlink.errors import ConfigError, HostlinkError, system_text

log = structlog.get_logger()

RETRY_S = 2.0  # until the master's name has an address
HEADER_TIMEOUT_S = 5.0  # for a node that connects
CRASHED = "a fault of hostlink"
MAX_BODY_BYTES = 256 * 1024  # a list of a thousand publishers, or the parameters of one node
CALL_S = 0.0005  # what a call costs
MAX_AGE_S = 60.0  # of a connection to the slave API; a later call connects again
KEEPALIVE_S = 10.0  # between two calls
END_TIMEOUT_S = 0.3  # for calls that are under way
READ_TIMEOUT_S = 5.0  # for the body of a call
DESCRIPTORS = 3  # for each of `max_connections`: one at each of two ports, and one to a node

_Answer = tuple[int, str, object]


class Member:
    """Membership of a node in the hub's graph and in ROS. `ended` gets the reason of a shutdown."""

    def __init__(self, node: LocalNode, names: NameResolver, service_uri: str) -> None:
        """`service_uri`: the address at which other nodes connect to services."""
        self.ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self.sync = GraphSync(node)
        self.parameters = MasterParameters(node, names, self._follow_parameters)
        self._node, self._names = node, names
        self._sim_time = SimTime(node)
        self._registrar = Registrar(
            node,
            self.sync,
            self.parameters,
            service_uri,
            on_services=lambda found: self.sync.update_services(found, self._name_map()),
            on_collision=self.shut_down,
        )

    @contextlib.asynccontextmanager
    async def taking_part(self) -> AsyncIterator[None]:
        """Take part in the hub and in ROS for the length of the block."""
        host = self._node.host
        watcher = host.join(GROUP, group=GROUP, on_end=lambda: self.shut_down(CRASHED))
        watcher.watch_graph(lambda: self._update(watcher.graph()))
        host.answer_parameters(self.parameters)
        host.count_by(partial(asdict, self._node.counts))
        try:
            yield
        finally:
            host.answer_parameters(None)
            self._sim_time.update(is_wanted=False)
            watcher.leave()
            self.sync.close()
            await self._registrar.end()

    async def keep_registered(self) -> None:
        """Keep the node registered until cancelled."""
        try:
            await self._registrar.run()
        finally:
            self.shut_down(CRASHED)  # where it ends by itself

    def make_wire(self) -> Wire:
        """Make the connection of a node that connects. It is closed when its header does not arrive in time."""

        def receive(messages: list[bytes]) -> None:
            self.sync.accept(wire, messages)

        def cut_silent() -> None:
            if wire.receive is receive and not wire.is_closed:
                self._node.counts.refused_headers += 1
                wire.close()

        wire = Wire(self._node.host, receive)
        asyncio.get_running_loop().call_later(HEADER_TIMEOUT_S, cut_silent)
        return wire

    def shut_down(self, reason: str) -> None:
        """End the node, but not the daemon."""
        if not self.ended.done():
            self.ended.set_result(reason)

    def _update(self, graph: Graph) -> None:
        """Follow a change of the hub's graph."""
        self.sync.update(graph, self._name_map())
        self._registrar.note_change()
        self._follow_parameters()  # /clock may have had another type

    def _name_map(self) -> NameMap:
        return NameMap(self._names, self._node.host.device_names(), self._node.host.own_names())

    def _follow_parameters(self) -> None:
        self._sim_time.update(is_wanted=self.parameters.is_sim_time)


class SimTime:
    """Time of /clock for devices, while /use_sim_time is true.

    The hub subscribes, so that /clock may be published in any graph.
    """

    def __init__(self, node: LocalNode) -> None:
        self._host, self._log_once = node.host, node.log_once
        self._clock = HubSource(
            lambda: node.host.join("ros1 clock"), CLOCK, self._receive, self._fail, type_name=CLOCK_TYPE
        )
        self._now_ns = 0  # as every node of ROS has it before the first message

    def update(self, *, is_wanted: bool) -> None:
        """Start or stop following /clock."""
        if not self._clock.is_read:
            self._now_ns = 0
        self._clock.set_read(is_wanted)
        self._host.set_clock((lambda: self._now_ns) if is_wanted else None)

    def _fail(self, error: HostlinkError) -> None:
        self._log_once("ros1.clock_unusable", reason=str(error))

    def _receive(self, message: Message) -> None:
        now_ns = decode_clock(message.payload)
        if now_ns is not None:
            self._now_ns = now_ns


class SlaveApi:
    """Answers of this node to calls by XML-RPC. A malformed or unknown call is counted."""

    def __init__(self, member: Member, node: LocalNode, tcpros_address: tuple[str, int]) -> None:
        """`tcpros_address`: where other nodes connect for topics."""
        self._member, self._node, self._tcpros_address = member, node, tcpros_address
        self._turns = node.host.turns()
        self._methods: dict[str, Callable[..., _Answer]] = {
            "getBusStats": lambda _: (SUCCESS, "bus stats", [[], [], []]),
            "getBusInfo": lambda _: (SUCCESS, "bus info", self._bus_info()),
            "getMasterUri": lambda _: (SUCCESS, node.master_uri, node.master_uri),
            "getPid": lambda _: (SUCCESS, "", os.getpid()),
            "getSubscriptions": lambda _: (SUCCESS, "subscriptions", self._subscriptions()),
            "getPublications": lambda _: (SUCCESS, "publications", self._publications()),
            "shutdown": self._shut_down,
            "paramUpdate": self._update_parameter,
            "publisherUpdate": self._update_publishers,
            "requestTopic": self._request_topic,
        }

    @contextlib.asynccontextmanager
    async def serving(self) -> AsyncIterator[MakeProtocol]:
        """Answer for the length of the block; yields what makes the protocol of a connection."""
        application = web.Application(client_max_size=MAX_BODY_BYTES)
        application.router.add_post("/{path:.*}", self.receive)
        runner = web.AppRunner(
            application,
            access_log=None,
            keepalive_timeout=KEEPALIVE_S,
            shutdown_timeout=END_TIMEOUT_S,
            auto_decompress=False,  # a kilobyte of a body is at most a kilobyte
        )
        await runner.setup()
        server = runner.server
        try:
            if server is not None:  # as it is after `setup`
                yield lambda: _Aged(server())
        finally:
            await runner.cleanup()

    async def receive(self, request: web.Request) -> web.Response:
        """Answer a request, in its turn."""
        try:
            async with asyncio.timeout(READ_TIMEOUT_S):
                body = await request.read()
        except TimeoutError:
            return web.Response(status=408)
        await self._turns.wait(CALL_S)
        answer = encode_fault("a fault of hostlink")
        with self._node.host.around("ros1", peer=request.remote):
            answer = await self.answer(body)
        return web.Response(body=answer, content_type="text/xml")

    async def answer(self, body: bytes) -> bytes:
        try:
            method, arguments = await self._node.rpc.parse(decode_call, body)
            return encode_answer(*self._methods.get(method, _refuse)(*arguments))
        except (BadXml, TypeError) as error:  # of arguments that do not fit
            self._node.counts.refused_calls += 1
            return encode_fault(str(error))

    def _publications(self) -> list[list[str]]:
        return [[name, each.type.name] for name, each in self._member.sync.publications.items()]

    def _subscriptions(self) -> list[list[str]]:
        return [[name, each.topic.type_name or ANY] for name, each in self._member.sync.subscriptions.items()]

    def _bus_info(self) -> list[list[object]]:
        """List number, other node, direction, protocol, topic and whether it is connected of each connection."""
        sync = self._member.sync
        found: list[tuple[str, str, str, bool]] = []
        for name, publication in sync.publications.items():
            found += [(node, "o", name, True) for node in publication.subscribers.values()]
        for name, subscription in sync.subscriptions.items():
            found += [(each.uri, "i", name, each.is_connected) for each in subscription.publishers.values()]
        return [[number, other, way, "TCPROS", name, ok] for number, (other, way, name, ok) in enumerate(found)]

    def _shut_down(self, caller: str, reason: str = "") -> _Answer:
        self._member.shut_down(f"{printable(str(caller))}: {printable(str(reason), 200) or 'shutdown'}")
        return SUCCESS, "shutdown", 0

    def _update_parameter(self, _: object, key: str, value: Any) -> _Answer:
        if not isinstance(key, str):
            raise BadXml("a key is a text")
        self._member.parameters.update(key, value)
        return SUCCESS, "", 0

    def _update_publishers(self, _: object, topic: str, uris: list[str]) -> _Answer:
        if not isinstance(topic, str) or not isinstance(uris, list) or not all(isinstance(uri, str) for uri in uris):
            raise BadXml("a topic and a list of addresses")
        self._member.sync.set_publishers(topic, uris, is_answer=False)
        return SUCCESS, "", 0

    def _request_topic(self, _: object, topic: str, protocols: list[list[object]]) -> _Answer:
        if not isinstance(topic, str) or topic not in self._member.sync.publications:
            return ERROR, f"not a publisher of {printable(str(topic))}", 0
        if not any(isinstance(each, list) and each and each[0] == "TCPROS" for each in protocols):
            return 0, "no supported protocol implementations", []
        host, port = self._tcpros_address
        return SUCCESS, f"ready on {host}:{port}", ["TCPROS", host, port]


def _refuse(*_: object) -> _Answer:
    raise BadXml("unknown method")


class _Aged(ForwardingProtocol, asyncio.Protocol):
    """Connection to the slave API that is closed after MAX_AGE_S, so that idle connections free their places."""

    is_replaceable = True  # a call is over within milliseconds, and who calls again connects again

    def __init__(self, inner: asyncio.Protocol) -> None:
        super().__init__(inner)
        self._timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._timer = asyncio.get_running_loop().call_later(MAX_AGE_S, transport.close)
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        self._inner.data_received(data)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)


# -- from its start to its end ----------------------------------------------------------------------------------------


class Ros1(Component[Ros1Config]):
    """The daemon as a node of ROS 1, for the settings of [ros1]."""

    name = "ros1"
    settings_type = Ros1Config
    connections: ClassVar[Mapping[str, Connections]] = {"ros1": Connections(descriptors=DESCRIPTORS)}

    @classmethod
    def is_wanted(cls, settings: Ros1Config) -> bool:
        """Whether there is a master."""
        return bool(settings.master)

    def check(self) -> Iterable[str]:
        """Check master and ports."""
        if not self.settings.master:
            raise ConfigError("ros1.master", "is missing; write the address of the ROS master: http://localhost:11311")
        check_port("ros1.port", self.settings.port)
        check_port("ros1.tcpros_port", self.settings.tcpros_port)
        return ()

    def describe(self) -> str:
        """Return one line for --check-config."""
        node = joined(self.settings.namespace, self.settings.name)
        return f"node {node} of the ROS 1 master at {self.settings.master}"

    async def run(self, host: Host) -> None:
        """Take part in the graph. A node that ROS has shut down, or whose settings are wrong, is not started again."""
        reason = CRASHED
        try:
            try:
                reason = await run_node(host, self.settings)
            except* ConfigError as group:
                reason = str(group.exceptions[0])
            raise_if_cancelled()
        except Exception:
            _end(host, reason)
            raise
        _end(host, reason)
        host.report(reason)
        await asyncio.Event().wait()


def _end(host: Host, reason: str) -> None:
    log.warning("ros1.ended", reason=reason, advice="robots are served on; start hostlink again to be in the graph")
    host.request_end(reason)


async def run_node(host: Host, config: Ros1Config) -> str:
    """Take part in the graph until the node is shut down. Return why."""
    names = NameResolver.of(config.namespace, config.name, config.remappings)
    address = await find_host(config)
    async with asyncio.TaskGroup() as tasks:
        node = LocalNode(host, config, names.node, tasks)
        try:
            async with _serving(node, names, address) as member:
                registering = node.spawn(member.keep_registered(), name="ROS 1 registrar")
                try:
                    return await member.ended
                finally:
                    registering.cancel()  # before everything is unregistered
        finally:
            await node.aclose()


async def find_host(config: Ros1Config) -> str:
    """Find the name or address of this node for others. Repeat until the master's name has an address."""
    is_logged = False
    while True:
        try:
            return config.host or await _own_address(config.master)
        except OSError as error:
            if not is_logged:
                log.warning("ros1.master_lost", master=config.master, reason=system_text(error))
            is_logged = True
        await asyncio.sleep(RETRY_S)


@contextlib.asynccontextmanager
async def _serving(node: LocalNode, names: NameResolver, host: str) -> AsyncIterator[Member]:
    """Listen for the length of the block. At its end no graph contains a part of this node."""
    config = node.config
    make_port = partial(Port, node.counts, allow=config.allow, max_connections=config.max_connections)
    api, tcpros = make_port(), make_port()
    listen = _listening_address(host)
    try:
        api_port = await _bound(api, listen, config.port, "ros1.port")
        tcpros_port = await _bound(tcpros, listen, config.tcpros_port, "ros1.tcpros_port")
        node.uri = f"http://{spelled(host, api_port)}/"
        member = Member(node, names, f"rosrpc://{spelled(host, tcpros_port)}")
        slave_api = SlaveApi(member, node, (host, tcpros_port))
        async with member.taking_part(), slave_api.serving() as connect:
            api.accept(connect, node.spawn)
            tcpros.accept(member.make_wire, node.spawn)
            log.info("ros1.started", node=node.name, master=config.master, uri=node.uri)
            yield member
    finally:
        api.close()
        tcpros.close()


async def _bound(port: Port, host: str, number: int, setting: str) -> int:
    """Listen, and return the number of the port.

    Raises:
        ConfigError: the port is not available; `setting` names it.
    """
    try:
        return await port.bind(host, number)
    except OSError as error:
        raise ConfigError(f"{setting} {number}", why(error)) from error


async def _own_address(master_uri: str) -> str:
    """Return the address of this host on the route to the master.

    Raises:
        OSError: the master's name has no address, or there is no route.
    """
    where = urllib.parse.urlsplit(master_uri)
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(where.hostname, where.port or MASTER_PORT, type=socket.SOCK_DGRAM)
    family, _, _, _, address = min(found, key=lambda each: each[0] != socket.AF_INET)
    return address_towards(family, address)


def _listening_address(host: str) -> str:
    """Return the address to listen on, so that nodes reach this one as `host`: loopback only for a loopback host."""
    everywhere = "::" if ":" in host else "0.0.0.0"  # noqa: S104 - nodes of ROS are on other hosts, too
    try:
        return host if ipaddress.ip_address(host).is_loopback else everywhere
    except ValueError:
        return "127.0.0.1" if host == "localhost" else everywhere
