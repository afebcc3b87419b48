"""Ending: the signals that end a daemon, and a limit for the end itself."""

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
SHUTDOWN_S = 1.0  # after that the robots stand, and a second signal ends the process at once
FORCED = 1  # exit status


class Ending:
    """Whether the daemon is to end, and why."""

    def __init__(self) -> None:
        self.cause = ""
        self._requested_at_s = 0.0
        self._is_requested = asyncio.Event()

    async def wait(self) -> None:
        """Returns when the daemon is to end."""
        await self._is_requested.wait()

    def request(self, cause: str) -> None:
        """A signal came, or another cause. The first begins the end; what comes while robots are stopped is ignored."""
        now_s = asyncio.get_running_loop().time()
        if not self._is_requested.is_set():
            self.cause, self._requested_at_s = cause, now_s
            self._is_requested.set()
            _force_after(LONGEST_END_S)
        elif now_s > self._requested_at_s + SHUTDOWN_S:
            _force(f"a second signal, {cause}")


@contextlib.contextmanager
def stop_signals() -> Iterator[Ending]:
    """Let signals end the daemon in good order, for the length of the block."""
    ending = Ending()
    loop = asyncio.get_running_loop()
    for number in STOP_SIGNALS:
        loop.add_signal_handler(number, ending.request, number.name)
    try:
        yield ending
    finally:
        for number in STOP_SIGNALS:
            loop.remove_signal_handler(number)


def _force_after(seconds: float) -> None:
    """In a thread: the loop may be what hangs, or a driver in another thread that the interpreter waits for."""
    timer = threading.Timer(seconds, _force, [f"the end lasted longer than {seconds:g} s"])
    timer.daemon = True
    timer.start()


def _force(cause: str) -> None:
    log.error("daemon.forced", cause=cause)
    os._exit(FORCED)
