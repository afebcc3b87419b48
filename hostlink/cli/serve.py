"""`hostlink serve`: the composition root. It puts the parts together, and stops them in order."""

import asyncio
import contextlib
import dataclasses
import gc
import importlib
import os
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Annotated

import structlog
import typer

from hostlink import logs
from hostlink.api.server import serve_api
from hostlink.cli.addresses import is_origin, parse_address, parse_serial
from hostlink.cli.arguments import Origins
from hostlink.cli.check import check, describe
from hostlink.cli.complaints import complaints_logged
from hostlink.cli.descriptors import fitted, limit
from hostlink.cli.ending import stop_signals
from hostlink.cli.examples import read_example
from hostlink.cli.garbage import collect_while_idle
from hostlink.cli.output import write, write_error
from hostlink.cli.reload_signal import reload_signal
from hostlink.cli.systemd import Notifier
from hostlink.config import Config, Ros1Config, UdpConfig, ZenohConfig, load
from hostlink.errors import ConfigError
from hostlink.guardian.guardian import guarded
from hostlink.hub.guard import Guard
from hostlink.hub.hub import Hub
from hostlink.hub.reloader import Read, Reloader
from hostlink.listeners.serial_ports import serve_serial
from hostlink.listeners.tcp_acceptor import TcpAcceptor
from hostlink.listeners.udp_acceptor import UdpAcceptor
from hostlink.messages.catalog import Catalog
from hostlink.recording.recordings import Recordings
from hostlink.transport.mdns import advertised
from hostlink.transport.tcp import serve_tcp
from hostlink.transport.udp_port import serve_udp

log = structlog.get_logger()

SWITCH_INTERVAL_S = 0.0005  # a tenth of the usual
GC_THRESHOLDS = (100, 5, 100)  # often, so that each lasts a millisecond or two; the oldest after 50,000 objects


OnGraphEnd = Callable[[str], None]


@dataclasses.dataclass(frozen=True, slots=True)
class Addresses:
    """Where a running daemon listens; port 0 in the configuration is a real one here."""

    tcp: tuple[str, int]
    api: str
    udp: tuple[str, int] | None = None


@contextlib.asynccontextmanager
async def running(
    config: Config,
    *,
    guard: Guard | None = None,
    on_graph_end: OnGraphEnd = lambda _: None,
    read: Read | None = None,
) -> AsyncIterator[tuple[Hub, Addresses]]:
    """The whole daemon for the length of a block.

    However the block is left, first every robot is stopped and every device is sent its stop; then the rest ends.
    `on_graph_end` is called with the reason when this node of a ROS graph was shut down from there. `read` reads
    the configuration again, as a new start would.
    """
    hub = Hub(config, Catalog(config.message_folders), guard=guard)
    reloader = Reloader(hub, read)
    try:
        async with (
            complaints_logged(hub.counts.refused),
            _hub_running(hub),
            _recordings(hub) as recordings,
            _graphs(hub, config, on_graph_end),
            _listening(hub, config, recordings, reloader) as addresses,
        ):
            udp = {} if addresses.udp is None else {"udp": "{}:{}".format(*addresses.udp)}
            log.info("daemon.started", tcp="{}:{}".format(*addresses.tcp), api=addresses.api, **udp)
            try:
                yield hub, addresses
            except Exception as error:
                log.exception("daemon.failed", cause=repr(error))
                raise
            finally:
                log.info("daemon.stopping")
                await hub.shutdown()
    except BaseExceptionGroup as group:  # one error has one line; the others are its consequences
        raise group.exceptions[0] from None
    logs.log_what_is_missing()
    log.info("daemon.stopped")


@contextlib.asynccontextmanager
async def _hub_running(hub: Hub) -> AsyncIterator[None]:
    """In a task group of its own: whatever else fails, links live until they were shut down."""
    async with asyncio.TaskGroup() as tasks:
        heart = tasks.create_task(hub.run(), name="hub")
        await hub.is_running.wait()
        try:
            yield
        finally:
            heart.cancel()


@contextlib.asynccontextmanager
async def _recordings(hub: Hub) -> AsyncIterator[Recordings]:
    """They end after the robots were stopped, which is worth recording."""
    recordings = Recordings(hub)
    await recordings.open()
    try:
        yield recordings
    finally:
        await recordings.aclose()


@contextlib.asynccontextmanager
async def _listening(hub: Hub, config: Config, recordings: Recordings, reloader: Reloader) -> AsyncIterator[Addresses]:
    """Listeners and ports, for devices and for programs."""
    async with (
        serve_api(config.api, hub, recordings, reloader) as api,
        contextlib.AsyncExitStack() as last,  # mDNS may be slow
    ):
        acceptor = TcpAcceptor(hub, config.tcp)
        async with (
            serve_tcp(config.tcp, acceptor.accept) as listener,
            _datagrams(hub, config.udp) as udp,
            _serial_ports(hub, config),
        ):
            await last.enter_async_context(advertised(config.tcp, listener.address))
            last.enter_context(reload_signal(reloader))
            yield Addresses(listener.address, api, udp)


@contextlib.asynccontextmanager
async def _datagrams(hub: Hub, config: UdpConfig | None) -> AsyncIterator[tuple[str, int] | None]:
    """The port for devices over UDP, where it is configured."""
    if config is None:
        yield None
        return
    acceptor = UdpAcceptor(hub, config)
    async with serve_udp(config, hub.counts.datagrams_dropped, acceptor.receive) as ports, asyncio.TaskGroup() as tasks:
        inviting = tasks.create_task(acceptor.invite(ports), name="invitations over UDP")
        try:
            yield ports[0].address[:2]
        finally:
            inviting.cancel()


@contextlib.asynccontextmanager
async def _graphs(hub: Hub, config: Config, on_end: OnGraphEnd) -> AsyncIterator[None]:
    """The daemon's parts in graphs of ROS and Zenoh; what one of them needs is imported with it."""
    async with contextlib.AsyncExitStack() as graphs:
        if config.zenoh is not None:
            module = importlib.import_module("hostlink.graphs.zenoh.running")
            await graphs.enter_async_context(module.zenoh_running(hub, config.zenoh))
        if config.ros1.master:
            module = importlib.import_module("hostlink.graphs.ros1.node")
            await graphs.enter_async_context(module.ros1_running(hub, config.ros1, on_end))
        yield


@contextlib.asynccontextmanager
async def _serial_ports(hub: Hub, config: Config) -> AsyncIterator[None]:
    async with asyncio.TaskGroup() as tasks:
        ports = [tasks.create_task(serve_serial(hub, port), name=port.name) for port in config.serial]
        try:
            yield
        finally:
            for port in ports:
                port.cancel()


def command(  # noqa: PLR0913 - each is an option of the command line
    *,
    config: Annotated[Path | None, typer.Option(help="hostlink.toml", show_default=False)] = None,
    listen: Annotated[
        str | None, typer.Option(help="Where devices connect: HOST:PORT.", show_default="0.0.0.0:11411")
    ] = None,
    udp: Annotated[
        str | None, typer.Option(help="Where devices send datagrams: PORT or HOST:PORT; without it nowhere.")
    ] = None,
    serial: Annotated[
        list[str] | None, typer.Option(help="A serial port with a device: /dev/ttyACM0@57600. May be repeated.")
    ] = None,
    api: Annotated[
        str | None, typer.Option(help="Where programs connect: HOST:PORT.", show_default="127.0.0.1:9090")
    ] = None,
    origin: Origins = None,
    messages: Annotated[
        list[Path] | None, typer.Option(help="A folder of .msg and .srv files. May be repeated.")
    ] = None,
    zenoh: Annotated[
        bool, typer.Option("--zenoh", help="Show and drive the robots of other daemons in this network: docs/fleet.md.")
    ] = False,
    ros1: Annotated[
        str | None, typer.Option(metavar="URL", help="Be a node of this ROS 1 master: http://localhost:11311.")
    ] = None,
    log_level: Annotated[str, typer.Option(help="debug, info, warning or error.")] = "info",
    loop: Annotated[str, typer.Option(help="The event loop: asyncio, or uvloop for crowds of robots.")] = "asyncio",
    check_config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Say what FILE would serve, or what is wrong with it.")
    ] = None,
    example: Annotated[
        str | None, typer.Option(metavar="NAME", help="Print an example file: config, systemd or udev.")
    ] = None,
) -> None:
    """Run the daemon: devices on TCP port 11411, serial ports and UDP, programs on port 9090.

    Exit status: 0 stopped as asked, 1 failed, 2 wrong arguments or settings, or an address that is in use.
    """
    if example is not None:
        write(*read_example(example).splitlines())
        return
    if log_level.upper() not in ("DEBUG", "INFO", "WARNING", "ERROR"):
        raise ConfigError("--log-level", f"{log_level} is none of debug, info, warning, error")
    new_loop = loop_factory(loop)
    logs.configure(level=log_level)
    file = check_config or config

    def read() -> Config:
        settings = merge(
            load(file) if file else Config(), listen=listen, udp=udp, serial=serial, api=api, messages=messages
        )
        settings = allow_origins(settings, origin)
        if zenoh and settings.zenoh is None:
            settings = dataclasses.replace(settings, zenoh=ZenohConfig())
        if ros1 is not None:
            settings = dataclasses.replace(settings, ros1=with_master(settings.ros1, "--ros1", ros1))
        return settings

    settings = read()
    warnings = asyncio.run(check(settings, descriptors=limit()))
    if check_config is not None:
        write(*describe(settings))
        write_error(*(f"warning: {warning}" for warning in warnings))
        return
    for warning in warnings:
        log.warning("config.suspicious", reason=warning)
    with asyncio.Runner(loop_factory=new_loop) as runner:
        read_again = (lambda: fitted(read(), limit())) if config else None
        runner.run(serve(fitted(settings, limit()), read=read_again))


def with_master(config: Ros1Config, where: str, url: str) -> Ros1Config:
    """The settings with this master.

    Raises:
        ConfigError: it is no address of one; `where` names it.
    """
    if not url:
        raise ConfigError(where, "no address of a master is given; they look like http://localhost:11311")
    try:
        return dataclasses.replace(config, master=url)
    except ValueError as error:
        raise ConfigError(where, str(error)) from error


def loop_factory(name: str) -> Callable[[], asyncio.AbstractEventLoop] | None:
    """Of what `--loop` names; None is asyncio's own.

    Raises:
        ConfigError: there is no such loop, or it is not installed.
    """
    if name == "asyncio":
        return None
    if name != "uvloop":
        raise ConfigError("--loop", f"{name} is none of asyncio, uvloop")
    try:
        factory: Callable[[], asyncio.AbstractEventLoop] = importlib.import_module("uvloop").new_event_loop
    except ImportError as error:
        raise ConfigError("--loop", 'uvloop is not installed: pip install "hostlink[uvloop]"') from error
    return factory


def shorten_pauses() -> None:
    """Keep the garbage collector and other threads from stopping the loop.

    Nothing here makes cycles, and what the start made stays: with a thousand robots a full collection took 0.23 s, ten
    times as long as a stop may wait. A thread that examines bytes keeps the loop waiting for an interval each time.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GC_THRESHOLDS)
    sys.setswitchinterval(SWITCH_INTERVAL_S)


async def serve(config: Config, *, ends_with_graph: bool = False, read: Read | None = None) -> None:
    """Run the daemon until a signal ends it; with `ends_with_graph` also when its node is shut down."""
    notifier = Notifier(os.environ)
    with stop_signals() as ending, guarded(is_wanted=config.guardian) as guardian:

        def graph_ended(reason: str) -> None:
            if ends_with_graph:
                ending.request(reason)

        async with running(config, guard=guardian, on_graph_end=graph_ended, read=read) as (hub, _):
            hub.spawn(notifier.beat(lambda: _status(hub)), name="heartbeat")
            shorten_pauses()
            hub.spawn(collect_while_idle(hub.robots), name="garbage collector")
            notifier.notify("READY=1")
            await ending.wait()
            notifier.notify("STOPPING=1")
            log.info("daemon.stop_requested", cause=ending.cause)


def _status(hub: Hub) -> str:
    connected = [robot.name for robot in hub.robots.here() if robot.link is not None]
    return f"{len(hub.links.all())} devices; robots: {', '.join(connected) or 'none'}"


def allow_origins(config: Config, origins: list[str] | None) -> Config:
    """The configuration with the origins of `--origin` beside its own.

    Raises:
        ConfigError: one is none.
    """
    for origin in origins or ():
        if not is_origin(origin):
            raise ConfigError("--origin", f"{origin} is none: it begins with a scheme, as https://app.foxglove.dev")
    api = dataclasses.replace(config.api, origins=config.api.origins + tuple(origins or ()))
    return dataclasses.replace(config, api=api)


def merge(
    config: Config,
    *,
    listen: str | None = None,
    udp: str | None = None,
    serial: list[str] | None = None,
    api: str | None = None,
    messages: list[Path] | None = None,
) -> Config:
    """The configuration with the flags over it.

    Raises:
        ConfigError: a flag is wrong.
    """
    if listen is not None:
        host, port = parse_address("--listen", listen, config.tcp.host)
        config = dataclasses.replace(config, tcp=dataclasses.replace(config.tcp, host=host, port=port))
    if udp is not None:
        wanted = UdpConfig() if config.udp is None else config.udp
        host, port = parse_address("--udp", f":{udp}" if udp.isdecimal() else udp, wanted.host)
        config = dataclasses.replace(config, udp=dataclasses.replace(wanted, host=host, port=port))
    if api is not None:
        host, port = parse_address("--api", api, config.api.host)
        config = dataclasses.replace(config, api=dataclasses.replace(config.api, host=host, port=port))
    ports = config.serial + tuple(parse_serial(text) for text in serial or ())
    return dataclasses.replace(config, serial=ports, message_folders=config.message_folders + tuple(messages or ()))
