"""`hostlink serve`: the composition root, which starts the parts of the daemon and stops them in order."""

import asyncio
import contextlib
import ctypes
import dataclasses
import gc
import importlib
import logging
import os
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from typing import Any

import structlog
from aiohttp.http_exceptions import HttpProcessingError

from hostlink.cli.check import check, describe, fitted, limit
from hostlink.cli.ending import stop_signals
from hostlink.cli.output import quantity, write, write_error
from hostlink.components.gateway.server import serve_api
from hostlink.components.recorder.recordings import Recordings
from hostlink.components.recorder.robot_names import kept_names, names_file
from hostlink.core import running as core
from hostlink.core.components import Make
from hostlink.core.config import Config
from hostlink.core.guardian.guardian import guarded
from hostlink.core.hub.gates import Guard
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.reloader import Read, Reloader
from hostlink.core.hub.robots import Robots
from hostlink.core.runtime import logs
from hostlink.core.runtime.listening import close_all, spelled
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.logs import printable

# -- serve ------------------------------------------------------------------------------------------------------------

log = structlog.get_logger()

SWITCH_INTERVAL_S = 0.0005  # a tenth of Python's default
M_MMAP_THRESHOLD = -3  # of malloc.h
LARGE_BYTES = 128 * 1024  # glibc's own threshold at the start
GC_THRESHOLDS = (
    100,
    5,
    100,
)  # often, so that each collection lasts a millisecond or two; the oldest generation after 50,000 objects


OnGraphEnd = Callable[[str], None]


@dataclasses.dataclass(frozen=True, slots=True)
class Addresses:
    """Addresses on which a running daemon listens; a port 0 of the configuration is replaced by the chosen one."""

    tcp: tuple[str, int]
    api: str
    udp: tuple[str, int] | None = None


@contextlib.asynccontextmanager
async def running(
    config: Config,
    *,
    guard: Guard | None = None,
    on_graph_end: OnGraphEnd = lambda _: None,
    on_listening: Callable[[], None] = lambda: None,
    read: Read | None = None,
    listening: Sequence[socket.socket] = (),
) -> AsyncIterator[tuple[Hub, Addresses]]:
    """Run the whole daemon for the length of a block: the core, recordings, graphs and the API.

    `on_graph_end` is called with the reason when this node of a ROS graph was shut down by ROS. `on_listening` is
    called when every port is open. `read` reads the configuration again, as a new start would. `listening` are the
    sockets for devices, if they are open already.
    """
    api = ""

    @contextlib.asynccontextmanager
    async def parts(hub: Hub) -> AsyncIterator[None]:
        nonlocal api
        reloader = Reloader(hub, read)
        async with (
            complaints_logged(),
            kept_names(hub, names_file(config)),
            _recordings(hub) as recordings,
            serve_api(hub, recordings, reloader) as api,
        ):
            with reload_signal(reloader):
                yield

    own: dict[str, Make] = {}
    if config.ros1.master:
        ros1 = importlib.import_module("hostlink.components.ros1.node").Ros1
        own["ros1"] = lambda: ros1(config.ros1, on_graph_end)
    async with core.running(
        config, guard=guard, around=parts, own=own, on_listening=on_listening, listening=listening
    ) as (hub, devices):
        udp = {} if devices.udp is None else {"udp": spelled(*devices.udp)}
        loop = getattr(asyncio.get_running_loop(), "name", "asyncio")
        ports = {"serial": list(devices.serial), "missing": list(devices.missing)} if config.serial else {}
        log.info("daemon.started", tcp=spelled(*devices.tcp), api=api, loop=loop, **udp, **ports)
        try:
            yield hub, Addresses(devices.tcp, api, devices.udp)
        except Exception as error:
            log.exception("daemon.failed", cause=repr(error))
            raise
        finally:
            log.info("daemon.stopping")
    logs.log_what_is_missing()
    log.info("daemon.stopped")


@contextlib.asynccontextmanager
async def _recordings(hub: Hub) -> AsyncIterator[Recordings]:
    """Open the recordings. They end after the robots were stopped, so that the stop is recorded."""
    recordings = Recordings(hub)
    await recordings.open()
    try:
        yield recordings
    finally:
        await recordings.aclose()


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
        for warning in asyncio.run(check(config, descriptors=limit(), is_listening=bool(listening))):
            log.warning("config.suspicious", reason=warning)
        read_again = None if read is None else (lambda: fitted(read(), limit()))
        with asyncio.Runner(loop_factory=loop_factory) as runner:
            runner.run(
                serve(fitted(config, limit()), ends_with_graph=ends_with_graph, read=read_again, listening=listening)
            )
    finally:
        close_all(listening)  # after a failed start: waiting devices are reset, and try again


def show_check(config: Config) -> None:
    """Print what the settings would serve, and warnings.

    Raises:
        ConfigError: the settings cannot be served.
    """
    warnings = asyncio.run(check(config, descriptors=limit()))
    write(*describe(config))
    write_error(*(f"warning: {warning}" for warning in warnings))


def shorten_pauses() -> None:
    """Keep the garbage collector and other threads from stopping the loop.

    The daemon makes no cycles, and objects of the start live for ever: with a thousand robots a full collection took
    0.23 s, ten times as long as a stop may wait. A thread that examines bytes holds the loop up for an interval.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*GC_THRESHOLDS)
    sys.setswitchinterval(SWITCH_INTERVAL_S)


def return_large_blocks() -> None:
    """Return the memory of large messages to the system when they are deleted.

    glibc returns a freed block of LARGE_BYTES once, then keeps blocks of that size in its heap, where small objects
    between them hold the rest: 30 programs with 4 latched messages of 900 KB each left 40 to 48 MiB behind, and 10 MiB
    with a fixed threshold. Other C libraries have no such function, or ignore the option.
    """
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)


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
    with stop_signals() as ending, guarded(is_wanted=config.guardian) as guardian:

        def graph_ended(reason: str) -> None:
            if ends_with_graph:
                ending.request(reason)

        async with running(
            config,
            guard=guardian,
            on_graph_end=graph_ended,
            on_listening=lambda: None if guardian is None else guardian.start(),  # not if a port is in use
            read=read,
            listening=listening,
        ) as (hub, _):
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


# -- garbage ----------------------------------------------------------------------------------------------------------

CHECK_INTERVAL_S = 1.0
WHOLE_INTERVAL_S = 60.0  # between two looks at all objects while little is freed: 0.25 s with a thousand robots
REST_S = 10.0  # before all objects are looked at: a stop between two drives would wait for that long
RESTLESS_S = 600.0  # between two such looks while robots never rest for so long
ENOUGH = 20  # collections of the younger generation: about a hundred connections since the last full one
WORTH = 1000  # collected objects: those of a dozen connections


async def collect_while_idle(robots: Robots) -> None:
    """Collect garbage while nothing moves, until cancelled.

    Many robots make enough objects for a collection each second, but leave no cycles behind. The objects that such a
    collection leaves are therefore not looked at again before WHOLE_INTERVAL_S, or before a collection frees much;
    and only while all robots have been at rest for REST_S, or after RESTLESS_S.
    """
    now_s = asyncio.get_running_loop().time
    whole_at_s = rested_at_s = now_s()
    has_freed_much = is_left = False  # is_left: what was frozen while it was in use may be garbage by now
    while True:
        await asyncio.sleep(CHECK_INTERVAL_S)
        if robots.may_move(now_s()):
            rested_at_s = now_s() + REST_S
            continue
        is_due = now_s() >= whole_at_s or has_freed_much
        is_whole = (is_due and now_s() >= rested_at_s) or now_s() >= whole_at_s + RESTLESS_S
        has_worked = gc.get_count()[2] >= ENOUGH
        if not has_worked and not (is_left and is_whole):
            continue
        if is_whole:
            gc.unfreeze()
            whole_at_s = now_s() + WHOLE_INTERVAL_S
        is_left = has_worked
        has_freed_much = gc.collect() >= WORTH
        gc.freeze()  # Python collects by itself, too, also while a robot moves


# -- systemd ----------------------------------------------------------------------------------------------------------

STATUS_INTERVAL_S = 10.0  # without a watchdog
_US_PER_S = 1_000_000


class Notifier:
    """Client of systemd's notify socket. Does nothing when NOTIFY_SOCKET is unset."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._interval_s = STATUS_INTERVAL_S
        microseconds = environment.get("WATCHDOG_USEC", "")
        is_for_us = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        if is_for_us and microseconds.isdecimal() and int(microseconds):
            self._interval_s = int(microseconds) / _US_PER_S / 2  # as sd_watchdog_enabled(3) advises

    def notify(self, *assignments: str) -> None:
        """Send `NAME=value` lines. A socket that cannot be written is logged and does not stop the daemon."""
        if not self._address:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK) as channel:
            try:
                channel.sendto("\n".join(assignments).encode(), self._address)
            except OSError as error:
                log.debug("systemd.notify_failed", reason=error.strerror)

    async def beat(self, status: Callable[[], str]) -> None:
        """Feed systemd's watchdog and report the status, until cancelled."""
        while self._address:
            self.notify("WATCHDOG=1", f"STATUS={status()}")
            await asyncio.sleep(self._interval_s)


# -- logs of libraries ------------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def complaints_logged() -> AsyncIterator[None]:
    """Log complaints of libraries and of the event loop, for the length of the block."""
    loop = asyncio.get_running_loop()
    budget = Budget()
    before, handler = loop.get_exception_handler(), _LibraryLog(budget, loop.time)
    loop.set_exception_handler(_LoopErrors(budget))
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)
        loop.set_exception_handler(before)


class _LoopErrors:
    """Exception handler of the event loop."""

    def __init__(self, budget: Budget) -> None:
        self._budget = budget

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        if counts := self._budget.due(f"loop {type(error).__name__}", loop.time()):
            log.error("loop.error", reason=printable(str(context.get("message", ""))), **counts, exc_info=error)


class _LibraryLog(logging.Handler):
    """Handler of the standard library's log, which only libraries use."""

    def __init__(self, budget: Budget, clock: Callable[[], float]) -> None:
        super().__init__(logging.WARNING)
        self._budget, self._clock = budget, clock

    def emit(self, record: logging.LogRecord) -> None:
        error = record.exc_info[1] if record.exc_info else None
        counts = self._budget.due(f"{record.name} {type(error).__name__}", self._clock())
        if not counts:
            return
        if isinstance(error, HttpProcessingError):
            log.warning("client.malformed", reason=printable(error.message.partition("\n")[0]), **counts)
        else:
            text = printable(record.getMessage())
            log.error("library.complained", library=record.name, text=text, **counts, exc_info=error)
