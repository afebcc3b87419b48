"""Waiting of a link for its end. A module of its own because it must not be compiled.

mypyc 2.4 keeps the exception that a coroutine handles while it waits in an `except`, a `finally` or an `async with`
where every other coroutine finds it: after one link was cancelled, every later one ended as cancelled.
"""

import asyncio
import contextlib
import contextvars
from collections.abc import Awaitable, Callable, Coroutine
from enum import Enum
from typing import Any

import structlog

from hostlink.core.runtime.cancellation import raise_if_cancelled
from hostlink.core.runtime.host_pauses import HostPauses
from hostlink.core.transport.base import Transport

log = structlog.get_logger()

LAST_FRAME_TIMEOUT_S = 0.2


class LinkEnd(Enum):
    """Reason for the end of a link."""

    PEER_CLOSED = "peer_closed"
    IDLE = "idle"
    REPLACED = "replaced"
    REFUSED = "refused"
    EVICTED = "evicted"
    UNAUTHENTICATED = "unauthenticated"
    STOPPED = "stopped"
    OTHER_PROTOCOL = "other_protocol"  # the device at a serial port speaks another one
    BROKEN = "broken"
    CRASHED = "crashed"
    UNANSWERABLE = "unanswerable"  # the device waits for an answer that its buffer cannot hold


Authenticate = Callable[[], Awaitable[None]]


async def trust() -> None:
    """Accept a device that needs no key."""


class Helper:
    """Second task of a link. Most links have it only while they open."""

    __slots__ = ("_end_broken", "_name", "_task", "_tasks")

    def __init__(self, name: str, end_broken: Callable[[OSError], bool]) -> None:
        """`end_broken` ends the link after an error of its connection. Return False if the error is to be raised."""
        self._name, self._end_broken = name, end_broken
        self._tasks: asyncio.TaskGroup | None = None
        self._task: asyncio.Task[None] | None = None

    def enter(self, tasks: asyncio.TaskGroup | None) -> None:
        """Set the parent of the task; None: no task is started from now on, and the last one is cancelled."""
        self._tasks = tasks
        if tasks is None:
            self._end_broken = _ignore  # otherwise helper and link form a reference cycle
            if self._task is not None:
                self._task.cancel()

    def start(self, work: Callable[[], Coroutine[Any, Any, None]], context: contextvars.Context) -> None:
        """Start the task, unless one is at work."""
        if self._tasks is not None and (self._task is None or self._task.done()):
            self._task = self._tasks.create_task(self._run(work), name=self._name, context=context)
            self._task.add_done_callback(self._forget)

    async def _run(self, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        try:
            await work()
        except OSError as error:  # raised, its traceback would keep the link until garbage is collected
            if not self._end_broken(error):
                raise

    def _forget(self, ended: "asyncio.Task[None]") -> None:
        if self._task is ended:  # otherwise another one was started in the same turn of the loop
            self._task = None


def _ignore(_: OSError) -> bool:
    """Ignore an error of the connection: the reason of the link's end is known."""
    return True


async def serve(
    finished: Awaitable[LinkEnd],
    helper: Helper,
    opening: Callable[[], Coroutine[Any, Any, None]],
    transport: Transport,
    close: Callable[[], tuple[bytes, ...]],
) -> LinkEnd:
    """Run `opening`, and what the link gives its helper, until `finished` returns the reason of the end.

    Then send the frames that `close` returns, each as one write.

    Raises:
        Exception: a callback of the link has failed, and `finished` raised its error.
    """
    end = LinkEnd.BROKEN
    try:
        async with asyncio.TaskGroup() as tasks:
            helper.enter(tasks)
            helper.start(opening, contextvars.copy_context())
            try:
                end = await finished
            finally:
                helper.enter(None)
    except* ConnectionRefusedError:  # the device did not prove the key
        end = LinkEnd.UNAUTHENTICATED
    except* OSError as broken:
        end = LinkEnd.BROKEN
        log.debug("link.broken", cause=str(broken.exceptions[0]))
    finally:
        last_frames = close()
        try:
            if last_frames:
                await _send_last(transport, last_frames)
        finally:  # also when cancelled
            await transport.aclose()
    raise_if_cancelled()
    return end


async def _send_last(transport: Transport, frames: tuple[bytes, ...]) -> None:
    """Send the final zero velocities before closing. Give up after LAST_FRAME_TIMEOUT_S."""
    with contextlib.suppress(OSError):  # TimeoutError is an OSError
        async with asyncio.timeout(LAST_FRAME_TIMEOUT_S):
            for frame in frames:
                await transport.send(frame)


async def drain(transport: Transport, timeout_s: float, pauses: Callable[[float], HostPauses]) -> None:
    """Wait until the device keeps up. A timeout during a pause of the host is not counted.

    Raises:
        OSError: the connection is lost, or the device does not read for `timeout_s`.
    """
    now_s = asyncio.get_running_loop().time
    began_s = now_s()
    while True:
        try:
            async with asyncio.timeout(timeout_s):
                return await transport.drain()
        except TimeoutError:  # an OSError, so the link ends as broken
            if not pauses(now_s()).was_paused(began_s):
                raise
            began_s = now_s()
