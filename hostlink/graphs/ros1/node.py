"""The daemon as one node of a ROS 1 graph: it listens, takes part, and leaves in order."""

import asyncio
import contextlib
import ipaddress
import socket
import urllib.parse
from collections.abc import AsyncIterator, Callable
from functools import partial

import structlog

from hostlink.acceptor import why
from hostlink.cancellation import raise_if_cancelled
from hostlink.config import Ros1Config
from hostlink.errors import ConfigError, system_text
from hostlink.graphs.ros1.connections import Port
from hostlink.graphs.ros1.local_node import LocalNode
from hostlink.graphs.ros1.member import CRASHED, Member, SlaveApi
from hostlink.graphs.ros1.names import NameResolver
from hostlink.graphs.ros1.xml_rpc import MASTER_PORT
from hostlink.hub.hub import Hub
from hostlink.listening import spelled

log = structlog.get_logger()

RETRY_S = 2.0  # until the master's name has an address


@contextlib.asynccontextmanager
async def ros1_running(hub: Hub, config: Ros1Config, on_end: Callable[[str], None]) -> AsyncIterator[None]:
    """Take part in the graph for the length of the block, or until the node is shut down.

    Then `on_end` is called with the reason. The daemon continues without the graph, also after a fault of hostlink.
    """
    async with asyncio.TaskGroup() as tasks:
        node = tasks.create_task(_serve(hub, config, on_end), name="ROS 1")
        try:
            yield
        finally:
            node.cancel()


async def _serve(hub: Hub, config: Ros1Config, on_end: Callable[[str], None]) -> None:
    reason = CRASHED
    with hub.isolation.around("task", task="ROS 1"):
        try:
            reason = await run_node(hub, config)
        except* ConfigError as group:
            reason = str(group.exceptions[0])
    raise_if_cancelled()
    log.warning("ros1.ended", reason=reason, advice="robots are served on; start hostlink again to be in the graph")
    on_end(reason)


async def run_node(hub: Hub, config: Ros1Config) -> str:
    """Take part in the graph until the node is shut down. Return why."""
    names = NameResolver.of(config.namespace, config.name, config.remappings)
    host = await find_host(config)
    async with asyncio.TaskGroup() as tasks:
        node = LocalNode(hub, config, names.node, tasks)
        try:
            async with _serving(node, names, host) as member:
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
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)  # sends nothing
        return str(probe.getsockname()[0])


def _listening_address(host: str) -> str:
    """Return the address to listen on, so that nodes reach this one as `host`: loopback only for a loopback host."""
    everywhere = "::" if ":" in host else "0.0.0.0"  # noqa: S104 - nodes of ROS are on other hosts, too
    try:
        return host if ipaddress.ip_address(host).is_loopback else everywhere
    except ValueError:
        return "127.0.0.1" if host == "localhost" else everywhere
