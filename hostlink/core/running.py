"""The core at work: a hub, the listeners for devices, the components. `serving` is all of it for a Python program."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterable, Sequence
from dataclasses import dataclass
from socket import socket
from time import thread_time

from hostlink.core.components import begun, begun_first, chosen_components, hosted
from hostlink.core.config import Config, MicroRosConfig, UdpConfig, check_ports
from hostlink.core.guardian.guardian import guarded
from hostlink.core.host import Host
from hostlink.core.hub.gates import Guard
from hostlink.core.hub.hub import Hub, Listening
from hostlink.core.hub.reloader import Read
from hostlink.core.hub.stall_watch import slept_s
from hostlink.core.listeners.accepting import TcpAcceptor, UdpAcceptor, protocols_of, serve_serial
from hostlink.core.messages.catalog import Catalog
from hostlink.core.runtime.cancellation import first_error, meanwhile
from hostlink.core.runtime.detached import DetachedThread
from hostlink.core.runtime.listening import spelled
from hostlink.core.transport.tcp import serve_tcp
from hostlink.core.transport.udp import serve_udp

# To open the serial ports: a USB adapter needs milliseconds, a reset of its board a tenth of a second.
FIRST_TRY_S = 2.0

Around = Callable[[Hub], contextlib.AbstractAsyncContextManager[object]]


@dataclass(frozen=True, slots=True)
class Addresses:
    """Addresses on which devices connect; a port 0 of the configuration is replaced by the chosen one."""

    tcp: tuple[str, int]
    udp: tuple[str, int] | None = None
    micro_ros: tuple[str, ...] = ()  # for micro-ROS boards: "udp://127.0.0.1:8888"
    serial: tuple[str, ...] = ()  # open ports
    missing: tuple[str, ...] = ()  # ports that are waited for


@contextlib.asynccontextmanager
async def serving(config: Config | None = None) -> AsyncIterator[Host]:
    """Hold the robots of these settings for the length of a block: docs/embedding.md.

    With the guardian, a second process, the robots also stop when this process is killed or hangs. At the end of the
    block every robot is stopped and every device is sent its stop.

    Raises:
        ConfigError: the settings cannot be served, for example because a port is in use.
    """
    config = Config() if config is None else config
    with guarded(is_wanted=config.guardian) as guardian:
        on_listening = guardian.start if guardian is not None else lambda: None
        async with (
            running(config, guard=guardian, on_listening=on_listening) as (hub, _),
            hosted(hub, "program", Counter()) as host,
        ):
            yield host


@contextlib.asynccontextmanager
async def running(
    config: Config,
    *,
    guard: Guard | None = None,
    read: Read | None = None,
    around: Around = contextlib.nullcontext,
    usual: Iterable[str] = (),
    on_listening: Callable[[], None] = lambda: None,
    listening: Sequence[socket] = (),
    namespace: str = "/",
) -> AsyncIterator[tuple[Hub, Addresses]]:
    """Run a hub with its listeners and components for the length of a block.

    However the block is left, first every robot is stopped and every device is sent its stop; then the rest ends.
    `read` reads the settings again, as a new start would. `usual` are components that run unless the settings switch
    them off. `around` begins before the first device is accepted, and ends after the
    robots were stopped. `on_listening` is called when every port is open. `listening` are the sockets for devices, if
    they are open already. `namespace` is as of `Hub`.
    """
    check_ports(config)
    chosen = chosen_components(config, usual)
    folders = config.message_folders  # one may be on a dead disk: the loop must still receive the signal that ends it
    catalog = await DetachedThread("message folders").run(lambda: Catalog(folders))
    hub = Hub(config, catalog, guard=guard, read=read, slept_s=slept_s, computed_s=thread_time, namespace=namespace)
    try:
        async with (
            _hub_running(hub),
            around(hub),
            begun_first(hub, chosen),
            _listening(hub, config, listening, on_listening) as addresses,
            begun(hub, chosen),
        ):
            try:
                yield hub, addresses
            finally:
                await hub.shutdown()
    except BaseExceptionGroup as group:  # one error is one line; the others follow from it
        raise first_error(group) from None


@contextlib.asynccontextmanager
async def _hub_running(hub: Hub) -> AsyncIterator[None]:
    """Run the hub in a task group of its own, so that links live until they were shut down."""
    async with meanwhile(("hub", hub.run())):
        await hub.is_running.wait()
        yield


@contextlib.asynccontextmanager
async def _listening(
    hub: Hub, config: Config, listening: Sequence[socket], on_listening: Callable[[], None]
) -> AsyncIterator[Addresses]:
    """Open the listeners for devices, and the serial ports.

    Raises:
        ConfigError: a listener or a protocol cannot be used.
    """
    for port in config.serial:
        protocols_of(hub, port)
    acceptor = TcpAcceptor(hub, config.tcp)
    tried = [asyncio.Event() for _ in config.serial]
    async with (
        serve_tcp(
            config.tcp,
            acceptor.accept,
            on_exhausted=acceptor.note_exhausted,
            listening=listening,
            is_prompt=acceptor.is_prompt,
        ) as listener,
        _datagrams(hub, config.udp) as udp,
        _micro_ros(hub, config.micro_ros) as micro_ros,
        meanwhile(
            *(
                (port.name, serve_serial(hub, port, on_tried=event.set))
                for port, event in zip(config.serial, tried, strict=True)
            )
        ),
    ):
        on_listening()
        hub.listening = Listening(listener.address, udp, micro_ros)
        await _all_set(tried)
        missing = tuple(port.name for port in config.serial if port.name in hub.diagnoses.ports)
        serial = tuple(port.name for port in config.serial if port.name not in missing)
        yield Addresses(listener.address, udp, micro_ros, serial, missing)


async def _all_set(events: Sequence[asyncio.Event]) -> None:
    """Wait until every serial port was tried once, so that the first lines of the log say which are missing."""
    with contextlib.suppress(TimeoutError):  # a driver that hangs
        async with asyncio.timeout(FIRST_TRY_S):
            for event in events:
                await event.wait()


@contextlib.asynccontextmanager
async def _micro_ros(hub: Hub, config: MicroRosConfig) -> AsyncIterator[tuple[str, ...]]:
    """Open the ports for micro-ROS boards that are configured. Return their addresses."""
    found: list[str] = []
    async with contextlib.AsyncExitStack() as ports:
        datagrams = None if config.udp is None else config.udp.listening()
        udp = await ports.enter_async_context(_datagrams(hub, datagrams, "--micro-ros udp://"))
        if udp is not None:
            found.append(f"udp://{spelled(*udp)}")
        if config.tcp is not None:
            listening = config.tcp.listening()
            acceptor = TcpAcceptor(hub, listening)
            serving = serve_tcp(
                listening,
                acceptor.accept,
                on_exhausted=acceptor.note_exhausted,
                option="--micro-ros tcp://",
                is_prompt=acceptor.is_prompt,
            )
            listener = await ports.enter_async_context(serving)
            found.append(f"tcp://{spelled(*listener.address)}")
        yield tuple(found)


@contextlib.asynccontextmanager
async def _datagrams(
    hub: Hub, config: UdpConfig | None, option: str = "--udp"
) -> AsyncIterator[tuple[str, int] | None]:
    """Open the UDP port for devices, if one is configured."""
    if config is None:
        yield None
        return
    acceptor = UdpAcceptor(hub, config)
    async with (
        serve_udp(config, hub.counts.datagrams_dropped, acceptor.receive, option) as ports,
        meanwhile(
            ("invitations over UDP", acceptor.invite(ports)), ("remembered devices over UDP", acceptor.resume(ports))
        ),
    ):
        yield ports[0].address[:2]
