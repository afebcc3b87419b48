"""Shutdown of a daemon by a signal, and the time limit of the shutdown."""

import asyncio
import contextlib
import os
import signal
import threading
from collections.abc import Iterator

import structlog

log = structlog.get_logger()

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
LONGEST_END_S = 8.0  # half a second for the robots, one for each connection, two for mDNS, and as much again
SHUTDOWN_S = 1.0  # after that the robots are stopped, and a second signal ends the process at once
MAX_NAMED = 8  # tasks
FORCED = 1  # exit status


class Ending:
    """Request to end the daemon, with its cause."""

    def __init__(self) -> None:
        self.cause = ""
        self._requested_at_s = 0.0
        self._is_requested = asyncio.Event()
        self._starting: asyncio.Task[object] | None = None

    @contextlib.contextmanager
    def at_start(self) -> Iterator[None]:
        """End the block at a request before `note_started`: a component may need long to begin."""
        self._starting = asyncio.current_task()
        try:
            yield
        except asyncio.CancelledError:
            if self._starting is None or not self.cause:
                raise  # it has started, or the cancellation is another's
            if self._starting.uncancel():
                raise  # another has cancelled it, too
            log.info("daemon.stop_requested", cause=self.cause)
        finally:
            self._starting = None

    def note_started(self) -> None:
        """From now on a request only ends `wait`."""
        self._starting = None

    async def wait(self) -> None:
        """Wait until the daemon is to end."""
        await self._is_requested.wait()

    def request(self, cause: str) -> None:
        """Begin the shutdown. Ignore further requests while the robots are being stopped; after that, end at once."""
        now_s = asyncio.get_running_loop().time()
        if not self._is_requested.is_set():
            self.cause, self._requested_at_s = cause, now_s
            self._is_requested.set()
            _force_after(LONGEST_END_S, asyncio.get_running_loop())
            if self._starting is not None:
                self._starting.cancel()
        elif now_s > self._requested_at_s + SHUTDOWN_S:
            _force(f"a second signal, {cause}")


@contextlib.contextmanager
def stop_signals() -> Iterator[Ending]:
    """Let signals end the daemon in order, for the length of the block."""
    ending = Ending()
    loop = asyncio.get_running_loop()
    for number in STOP_SIGNALS:
        loop.add_signal_handler(number, ending.request, number.name)
    try:
        yield ending
    finally:
        for number in STOP_SIGNALS:
            loop.remove_signal_handler(number)


def _force_after(seconds: float, loop: asyncio.AbstractEventLoop) -> None:
    """Limit the shutdown by a thread: the event loop may hang, or a driver's thread that the interpreter waits for."""
    timer = threading.Timer(seconds, _force_late, [f"the end lasted longer than {seconds:g} s", loop])
    timer.daemon = True
    timer.start()


def _force_late(cause: str, loop: asyncio.AbstractEventLoop) -> None:
    """End the process; name the tasks that ignore their cancellation, for example those of a component."""
    names = sorted({task.get_name() for task in asyncio.all_tasks(loop) if task.cancelling()})
    waits = f"; these tasks ignored it: {', '.join(names[:MAX_NAMED])}" if names else ""
    _force(f"{cause}{waits}")


def _force(cause: str) -> None:
    log.error("daemon.forced", cause=cause)
    os._exit(FORCED)
