"""`hostlink serve`: the composition root, which starts the core with its usual components and ends at a signal."""

import asyncio
import contextlib
import dataclasses
import os
import signal
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Sequence

import structlog

from hostlink.cli.check import check, check_settings, describe
from hostlink.cli.descriptors import fitted, limit
from hostlink.cli.ending import stop_signals
from hostlink.cli.garbage import collect_while_idle, return_large_blocks, shorten_pauses
from hostlink.cli.library_logs import complaints_logged
from hostlink.cli.output import quantity, write, write_error
from hostlink.cli.start import importing_fast
from hostlink.cli.systemd import Notifier
from hostlink.cli.usual import USUAL, chosen
from hostlink.components.gateway.settings import ApiAddress
from hostlink.components.ros1.settings import Ros1Config
from hostlink.core import running as core
from hostlink.core.config import Config
from hostlink.core.guardian.guardian import guarded
from hostlink.core.hub.gates import Guard
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.kept_memories import kept_memories, memories_file
from hostlink.core.hub.kept_names import kept_names, names_file
from hostlink.core.hub.reloader import Read, Reloader
from hostlink.core.runtime import logs
from hostlink.core.runtime.listening import close_all, spelled

log = structlog.get_logger()

OnEndRequest = Callable[[str], None]


@dataclasses.dataclass(frozen=True, slots=True)
class Addresses:
    """Addresses on which a running daemon listens; a port 0 of the configuration is replaced by the chosen one."""

    tcp: tuple[str, int]
    api: str  # empty: no gateway runs
    udp: tuple[str, int] | None = None
    micro_ros: tuple[str, ...] = ()


@contextlib.asynccontextmanager
async def running(
    config: Config,
    *,
    guard: Guard | None = None,
    on_end_request: OnEndRequest = lambda _: None,
    on_listening: Callable[[], None] = lambda: None,
    read: Read | None = None,
    listening: Sequence[socket.socket] = (),
) -> AsyncIterator[tuple[Hub, Addresses]]:
    """Run the whole daemon for the length of a block: the core, and the components that the settings switch on.

    `on_end_request` is called with the reason when a component asks the daemon to end: ROS has shut down its node.
    `on_listening` is called when every port is open. `read` reads the configuration again, as a new start would.
    `listening` are the sockets for devices, if they are open already.
    """

    @contextlib.asynccontextmanager
    async def parts(hub: Hub) -> AsyncIterator[None]:
        hub.on_end_request = on_end_request
        async with (
            complaints_logged(),
            kept_names(hub.links, names_file(config)),
            kept_memories(hub.links, memories_file(config)),
        ):
            with reload_signal(hub.reloader):
                yield

    async with core.running(
        config,
        guard=guard,
        read=read,
        around=parts,
        usual=USUAL,
        on_listening=on_listening,
        listening=listening,
        namespace=config.table("ros1", Ros1Config).namespace,
    ) as (hub, devices):
        gateway = hub.offered(ApiAddress)
        api = {} if gateway is None else {"api": gateway.url}
        udp = {} if devices.udp is None else {"udp": spelled(*devices.udp)}
        loop = getattr(asyncio.get_running_loop(), "name", "asyncio")
        ports = {"serial": list(devices.serial), "missing": list(devices.missing)} if config.serial else {}
        boards = {"micro_ros": list(devices.micro_ros)} if devices.micro_ros else {}
        log.info("daemon.started", tcp=spelled(*devices.tcp), **api, loop=loop, **udp, **boards, **ports)
        try:
            yield hub, Addresses(devices.tcp, api.get("api", ""), devices.udp, devices.micro_ros)
        except Exception as error:
            log.exception("daemon.failed", cause=repr(error))
            raise
        finally:
            log.info("daemon.stopping")
    logs.log_what_is_missing()
    log.info("daemon.stopped")


def import_components(config: Config) -> None:
    """Import the components that run.

    Raises:
        ConfigError: one is not installed, or cannot be imported.
    """
    with importing_fast():
        chosen(config)


def run(
    config: Config,
    listening: Sequence[socket.socket],
    loop_factory: Callable[[], asyncio.AbstractEventLoop] | None,
    *,
    read: Read | None = None,
    ends_with_graph: bool = False,
) -> None:
    """Check the settings, then serve. `listening` are the open sockets for devices; without them they are opened here.

    Raises:
        ConfigError: the settings cannot be served.
    """
    try:
        import_components(config)
        for warning in asyncio.run(check(config, descriptors=limit(), is_listening=bool(listening))):
            log.warning("config.suspicious", reason=warning)
        read_again = None if read is None else (lambda: _checked(read()))
        with asyncio.Runner(loop_factory=loop_factory) as runner:
            runner.run(
                serve(fitted(config, limit()), ends_with_graph=ends_with_graph, read=read_again, listening=listening)
            )
    finally:
        close_all(listening)  # after a failed start: waiting devices are reset, and try again


def _checked(config: Config) -> Config:
    """Check the settings of a reload, and limit connections, as a new start would.

    Raises:
        ConfigError: a new start would refuse them.
    """
    check_settings(config)
    return fitted(config, limit())


def show_check(config: Config) -> None:
    """Print what the settings would serve, and warnings.

    Raises:
        ConfigError: the settings cannot be served.
    """
    warnings = asyncio.run(check(config, descriptors=limit()))
    write(*describe(config))
    write_error(*(f"warning: {warning}" for warning in warnings))


async def serve(
    config: Config,
    *,
    ends_with_graph: bool = False,
    read: Read | None = None,
    listening: Sequence[socket.socket] = (),
) -> None:
    """Run the daemon until a signal; with `ends_with_graph` also until its node is shut down."""
    return_large_blocks()
    notifier = Notifier(os.environ)
    with stop_signals() as ending, guarded(is_wanted=config.guardian) as guardian, ending.at_start():
        async with running(
            config,
            guard=guardian,
            on_end_request=ending.request if ends_with_graph else lambda _: None,
            on_listening=lambda: None if guardian is None else guardian.start(),  # not if a port is in use
            read=read,
            listening=listening,
        ) as (hub, _):
            ending.note_started()
            hub.spawn(notifier.beat(lambda: _status(hub)), name="heartbeat")
            shorten_pauses()
            hub.spawn(collect_while_idle(hub.robots), name="garbage collector")
            notifier.notify("READY=1")
            await ending.wait()
            notifier.notify("STOPPING=1")
            log.info("daemon.stop_requested", cause=ending.cause)


def _status(hub: Hub) -> str:
    connected = [robot.name for robot in hub.robots.here() if robot.link is not None]
    return f"{quantity(len(hub.links.all()), 'device')}; robots: {', '.join(connected) or 'none'}"


# -- reload signal ----------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def reload_signal(reloader: Reloader) -> Iterator[None]:
    """Reload the configuration at SIGUSR1, for the length of the block. A wrong one is logged and changes nothing."""
    if threading.current_thread() is not threading.main_thread():  # signals arrive in the main thread only
        yield
        return
    loop = asyncio.get_running_loop()
    loop.add_signal_handler(signal.SIGUSR1, reloader.request)
    try:
        yield
    finally:
        loop.remove_signal_handler(signal.SIGUSR1)
