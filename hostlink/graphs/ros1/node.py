"""Ros1Node: the daemon as one node of a ROS 1 graph. It listens, takes part, and leaves in order."""

import asyncio
import contextlib
import ipaddress
import socket
import urllib.parse
from collections.abc import AsyncIterator, Callable, Coroutine
from functools import partial
from typing import Any

import structlog

from hostlink.acceptor import why
from hostlink.cancellation import raise_if_cancelled
from hostlink.config import Ros1Config
from hostlink.errors import ConfigError
from hostlink.graphs.ros1.member import CRASHED, Member
from hostlink.graphs.ros1.names import Names, joined
from hostlink.graphs.ros1.parts import Counts, Parts, Spawn
from hostlink.graphs.ros1.port import Port
from hostlink.graphs.ros1.rpc import Master, Rpc
from hostlink.graphs.ros1.slave import serving_slave_api
from hostlink.graphs.ros1.xml_rpc import MASTER_PORT
from hostlink.hub.hub import Hub

log = structlog.get_logger()

RETRY_S = 2.0  # until the master's name has an address


class Ros1Node:
    """`run` serves until somebody shuts the node down; the daemon does not end with it."""

    def __init__(self, hub: Hub, config: Ros1Config) -> None:
        self.counts = Counts()
        plain = Names(joined(config.namespace, config.name))
        remappings = {plain.resolve(old): plain.resolve(new) for old, new in config.remappings.items()}
        self._names = Names(plain.node, remappings)
        self._hub, self._config = hub, config

    async def run(self) -> str:
        """Take part in the graph; returns why the node was shut down."""
        host = await self._find_host()
        async with asyncio.TaskGroup() as tasks:
            spawned = _Spawned(self._hub, tasks)
            try:
                async with self._serving(host, spawned.spawn) as member:
                    registering = spawned.spawn(member.keep_registered(), name="ROS 1 registrar")
                    try:
                        return await member.ended
                    finally:
                        registering.cancel()  # before everything is unregistered
            finally:
                spawned.cancel()

    @contextlib.asynccontextmanager
    async def _serving(self, host: str, spawn: Spawn) -> AsyncIterator[Member]:
        """All that listens, for the length of the block; at its end nothing of this node is left in either graph."""
        config, rpc = self._config, Rpc()
        make_port = partial(Port, self.counts, allow=config.allow, max_connections=config.max_connections)
        api, tcpros = make_port(), make_port()
        listen = _listening_address(host)
        try:
            api_port = await _bound(api, listen, config.port, "ros1.port")
            tcpros_port = await _bound(tcpros, listen, config.tcpros_port, "ros1.tcpros_port")
            parts = Parts(
                self._hub,
                rpc,
                Master(rpc, config.master, self._names.node),
                self._names.node,
                f"http://{_spelled(host)}:{api_port}/",
                self.counts,
                spawn,
                config.max_message_bytes,
                config.max_connections,
            )
            member = Member(parts, self._names, (host, tcpros_port), f"rosrpc://{_spelled(host)}:{tcpros_port}")
            async with member.taking_part(), serving_slave_api(member, parts) as connect:
                api.accept(connect, spawn)
                tcpros.accept(member.make_wire, spawn)
                log.info("ros1.started", node=parts.node, master=config.master, uri=parts.uri)
                yield member
        finally:
            api.close()
            tcpros.close()
            await rpc.aclose()

    async def _find_host(self) -> str:
        """By which name or address others reach this node; tried until the master's name has an address."""
        is_logged = False
        while True:
            try:
                return self._config.host or await _own_address(self._config.master)
            except OSError as error:
                if not is_logged:
                    log.warning("ros1.master_lost", master=self._config.master, reason=error.strerror or str(error))
                is_logged = True
            await asyncio.sleep(RETRY_S)


@contextlib.asynccontextmanager
async def ros1_running(hub: Hub, config: Ros1Config, on_end: Callable[[str], None]) -> AsyncIterator[None]:
    """A part of the graph for the length of the block, or until it is shut down from there.

    Then `on_end` is called with the reason. The daemon goes on without the graph, also where a fault of hostlink ends
    it.
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
        node = Ros1Node(hub, config)
        try:
            reason = await node.run()
        except* ConfigError as group:
            reason = str(group.exceptions[0])
    raise_if_cancelled()
    log.warning("ros1.ended", reason=reason, advice="robots are served on; start hostlink again to be in the graph")
    on_end(reason)


class _Spawned:
    """The tasks of one node; the crash of one ends nothing else."""

    def __init__(self, hub: Hub, tasks: asyncio.TaskGroup) -> None:
        self._hub, self._group = hub, tasks
        self._tasks: set[asyncio.Task[None]] = set()

    def spawn(self, work: Coroutine[Any, Any, object], *, name: str) -> asyncio.Task[None]:
        task = self._group.create_task(self._isolated(work, name), name=name)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        task.add_done_callback(lambda _: work.close())  # it may be cancelled before it begins
        return task

    def cancel(self) -> None:
        for task in self._tasks:
            task.cancel()

    async def _isolated(self, work: Coroutine[Any, Any, object], name: str) -> None:
        with self._hub.isolation.around("task", task=name):
            await work


async def _bound(port: Port, host: str, number: int, setting: str) -> int:
    """The number of the port on which it listens from now on.

    Raises:
        ConfigError: nobody can listen there; `setting` names it.
    """
    try:
        return await port.bind(host, number)
    except OSError as error:
        raise ConfigError(f"{setting} {number}", why(error)) from error


async def _own_address(master_uri: str) -> str:
    """The address of this host on the way to the master.

    Raises:
        OSError: the master's name has no address, or there is no way.
    """
    where = urllib.parse.urlsplit(master_uri)
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(where.hostname, where.port or MASTER_PORT, type=socket.SOCK_DGRAM)
    family, _, _, _, address = min(found, key=lambda each: each[0] != socket.AF_INET)
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(address)  # sends nothing
        return str(probe.getsockname()[0])


def _listening_address(host: str) -> str:
    """Where to listen, so that nodes reach this one as `host`: on loopback alone if it is that."""
    everywhere = "::" if ":" in host else "0.0.0.0"  # noqa: S104 - nodes of ROS are on other hosts, too
    try:
        return host if ipaddress.ip_address(host).is_loopback else everywhere
    except ValueError:
        return "127.0.0.1" if host == "localhost" else everywhere


def _spelled(host: str) -> str:
    return f"[{host}]" if ":" in host else host
