"""LoopThread: a connection with an event loop in a thread of its own, for programs that have none.

The thread ends with the connection; the connection ends with `close`, with the last reference to it, and with the
program (`program_end`).
"""

import asyncio
import concurrent.futures
import contextlib
import os
import threading
import weakref
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from hostlink.client import program_end
from hostlink.client.connecting import Connecting
from hostlink.client.driver import calling_thread
from hostlink.client.host import Host
from hostlink.errors import HostlinkError

CLOSE_TIMEOUT_S = 4.0  # the stops, what is not settled, and the goodbye have a second each
CANCEL_TIMEOUT_S = 1.0

Result = TypeVar("Result")


class LoopThread:
    """Runs coroutines of the connection for other threads.

    It ends by itself when nobody has it any more: the thread knows `_Life` only.
    """

    def __init__(self, connecting: Connecting) -> None:
        """Connect.

        Raises:
            HostlinkError: that cannot be done.
        """
        self._life = life = _Life(connecting)
        self.kept: set[object] = set()  # what lasts although nobody has it
        self._process, self._is_closed = os.getpid(), False
        threading.Thread(target=life.run, name="hostlink", daemon=True).start()
        program_end.watch(life)
        weakref.finalize(self, life.end).atexit = False
        try:
            self.host = _result(life.opened)
        except BaseException:  # Ctrl-C too
            life.end()
            raise

    def run(self, work: Coroutine[Any, Any, Result]) -> Result:
        """What comes of it; a caller that is interrupted cancels it.

        Raises:
            HostlinkError: the connection is closed, or belongs to another process; and what `work` raises.
        """
        if os.getpid() != self._process:
            work.close()
            raise HostlinkError("this connection belongs to the process that forked this one: connect here, too")
        calling_thread.set(threading.current_thread())  # `work` begins with a copy of this context
        call = self._life.begin(work)
        try:
            return _result(call)
        except concurrent.futures.CancelledError:
            raise HostlinkError("the connection is closed: connect again") from None
        finally:
            call.cancel()

    def call(self, function: Callable[[], Result]) -> Result:
        """What a function returns that does not wait, and must not run beside the connection.

        Raises:
            HostlinkError: as `run`.
        """

        async def work() -> Result:
            return function()

        return self.run(work())

    def begin(self, work: Coroutine[Any, Any, object]) -> None:
        """Run it without waiting for it; whoever is about to forget something uses it."""
        if os.getpid() == self._process:
            self._life.begin(work)
        else:
            work.close()

    def close(self) -> None:
        """End the connection; what is driven stops.

        Raises:
            HostlinkError: a message that was published was refused, and nobody has been told.
        """
        if os.getpid() == self._process and not self._is_closed:
            self._is_closed = True
            self._life.end()
            with contextlib.suppress(TimeoutError):
                _result(self._life.ended, CLOSE_TIMEOUT_S)


def _result(future: "concurrent.futures.Future[Result]", timeout_s: float | None = None) -> Result:
    """What came of it; an error without the way that it made through the other thread, which explains nothing."""
    try:
        return future.result(timeout_s)
    except HostlinkError as error:
        raise error.with_traceback(None) from None


class _Life:
    """The connection, as its thread runs it: until `end`, or until it breaks."""

    def __init__(self, connecting: Connecting) -> None:
        self.opened: concurrent.futures.Future[Host] = concurrent.futures.Future()
        self.ended: concurrent.futures.Future[None] = concurrent.futures.Future()
        self._connecting = connecting
        self._loop = asyncio.new_event_loop()
        self._ending = asyncio.Event()
        self._calls: set[concurrent.futures.Future[Any]] = set()

    def run(self) -> None:
        """The body of the thread."""
        try:
            try:
                self._loop.run_until_complete(self._live())
            finally:
                self._close_loop()
            self.ended.set_result(None)
        except HostlinkError as error:
            (self.ended if self.opened.done() else self.opened).set_exception(error)
        finally:
            for future in (self.opened, self.ended):
                if not future.done():
                    future.set_exception(HostlinkError("the connection has crashed; its thread shows why"))
            for call in list(self._calls):  # that came when the loop did not run any more
                call.cancel()

    async def _live(self) -> None:
        async with self._connecting as host:
            self.opened.set_result(host)
            await self._ending.wait()

    def _close_loop(self) -> None:
        """As asyncio.Runner does, but for the threads that resolve names: at the end of a program nobody can wait."""
        calls = asyncio.all_tasks(self._loop)
        for call in calls:
            call.cancel()
        if calls:
            self._loop.run_until_complete(asyncio.wait(calls, timeout=CANCEL_TIMEOUT_S))
        self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        self._loop.close()

    def begin(self, work: Coroutine[Any, Any, Result]) -> "concurrent.futures.Future[Result]":
        """Run it beside the others; it is cancelled when the connection ends before it."""
        try:
            call = asyncio.run_coroutine_threadsafe(work, self._loop)
        except RuntimeError:  # the loop is closed
            work.close()
            call = concurrent.futures.Future()
            call.cancel()
            return call
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)
        if self.ended.done():
            call.cancel()
        return call

    def end(self) -> None:
        """Begin to end; from any thread, more than once."""
        with contextlib.suppress(RuntimeError):  # the loop is closed
            self._loop.call_soon_threadsafe(self._ending.set)

    def begin_stop(self, *, of_ended_threads: bool = False) -> "concurrent.futures.Future[None] | None":
        """Stop what is driven, and stay connected; None: there is no connection."""
        if self.ended.done() or not self.opened.done() or self.opened.exception() is not None:
            return None
        return self.begin(self.opened.result().stop_driven(of_ended_threads=of_ended_threads))

    def finish(self) -> None:
        """End, and wait until it has."""
        self.end()
        with contextlib.suppress(TimeoutError, HostlinkError):
            self.ended.result(CLOSE_TIMEOUT_S)
