"""LoopThread: a connection with an event loop in its own thread, for programs without asyncio.

Needed because pings and repeated velocities are due every 0.1 to 0.2 s while the program computes: asyncio.Runner runs
only during a call. anyio's portal has such a thread, but does not stop a robot at the end of a cell, a thread or the
program (tests/unit/client/test_program_end.py).

The thread ends with the connection. The connection ends with `close`, with the last reference to it, and with the
program:

| event                                                                      | result                             |
|----------------------------------------------------------------------------|------------------------------------|
| an uncaught error or Ctrl-C: in a script, in a cell, at the prompt         | what it drives stops               |
| a cell ends without an error                                               | what it drove stops, unless `keep` |
| an error or exit() that ends a thread                                      | the same                           |
| the main thread ends, and another one still runs                           | what ended threads drove stops     |
| the program ends: exit(), the last line, an uncaught error                 | the same, and connections close    |
| the process is killed, the kernel of a notebook dies                       | the daemon notices that, and stops |
"""

import asyncio
import atexit
import concurrent.futures
import contextlib
import functools
import os
import sys
import threading
import weakref
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Coroutine, Iterator
from types import TracebackType
from typing import Any, TypeVar

from hostlink.client.callers import thread_context
from hostlink.client.cells import STOP_TIMEOUT_S, Names, watch_cells, watched
from hostlink.client.driver import Repeated
from hostlink.client.host import Connecting, Host
from hostlink.client.mailbox import Mailbox
from hostlink.client.services import Answer, Values
from hostlink.errors import HostlinkError

# -- end of the program -----------------------------------------------------------------------------------------------

_watched: "weakref.WeakSet[_Life]" = weakref.WeakSet()

CLOSE_TIMEOUT_S = 4.0  # the stops, what is not settled, and the goodbye have a second each
CANCEL_TIMEOUT_S = 1.0


def watch(connection: "_Life") -> None:
    """End what it drives when the program, or a part of it, ends."""
    _watch_program()
    _watch_main_thread()
    _watched.add(connection)
    watch_cells(connection)


def _stop_all(timeout_s: float = STOP_TIMEOUT_S) -> None:
    """At once: a daemon that does not answer delays no stop at another."""
    begun = [connection.begin_stop() for connection in list(_watched)]
    concurrent.futures.wait([stop for stop in begun if stop is not None], timeout=timeout_s)


def _finish_all() -> None:
    connections = list(_watched)
    _watched.clear()  # or the end of the main thread would stop what is about to close
    for connection in connections:
        connection.end()
    for connection in connections:
        connection.finish()


@functools.cache
def _watch_program() -> None:
    """Once."""
    atexit.register(_finish_all)
    report, report_thread = sys.excepthook, threading.excepthook

    def stop_and_report(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
        _stop_all()
        report(kind, error, traceback)

    def stop_and_report_thread(arguments: threading.ExceptHookArgs, /) -> None:
        _stop_all()
        report_thread(arguments)

    sys.excepthook, threading.excepthook = stop_and_report, stop_and_report_thread


@functools.cache
def _watch_main_thread() -> None:
    """Once a process: Python waits for other threads before it calls what atexit has."""
    threading.Thread(target=_stop_behind, args=(threading.main_thread(),), name="hostlink end", daemon=True).start()


def _stop_behind(main_thread: threading.Thread) -> None:
    main_thread.join()
    for connection in list(_watched):
        connection.begin_stop(Repeated.is_of_ended_thread)


os.register_at_fork(after_in_child=_watched.clear)  # the connections are the parent's, and the threads
os.register_at_fork(after_in_child=watched.clear)
os.register_at_fork(after_in_child=_watch_main_thread.cache_clear)


# -- thread -----------------------------------------------------------------------------------------------------------


Result = TypeVar("Result")
Item = TypeVar("Item")
Report = Callable[[Item], object]


class LoopThread:
    """Runs coroutines of the connection for other threads.

    It ends with its last reference, because the thread refers to `_Life` only.
    """

    def __init__(self, connecting: Connecting) -> None:
        """Connect.

        Raises:
            HostlinkError: that cannot be done.
        """
        self._life = life = _Life(connecting)
        self.kept: set[object] = set()  # kept open without a reference
        self._process, self._is_closed = os.getpid(), False
        threading.Thread(target=life.run, name="hostlink", daemon=True).start()
        watch(life)
        weakref.finalize(self, life.end).atexit = False
        try:
            self.host = _result(life.opened)
        except BaseException:  # Ctrl-C too
            life.end()
            raise

    def run(
        self,
        work: Coroutine[Any, Any, Result],
        wait: Callable[["concurrent.futures.Future[Result]"], object] | None = None,
    ) -> Result:
        """Return the result of a coroutine; an interrupted caller cancels it. `wait` may be called meanwhile.

        Raises:
            HostlinkError: the connection is closed, or belongs to another process; and what `work` raises.
        """
        if os.getpid() != self._process:
            work.close()
            raise HostlinkError("this connection belongs to the process that forked this one: connect here, too")
        call = thread_context().run(self._life.begin, work)
        try:
            if wait is not None:
                wait(call)
            return _result(call)
        except concurrent.futures.CancelledError:
            raise HostlinkError("the connection is closed: connect again") from None
        finally:
            call.cancel()

    def run_reporting(
        self, begin: Callable[[Report[Item]], Coroutine[Any, Any, Result]], report: Report[Item] | None
    ) -> Result:
        """Run a coroutine that reports, and call `report` in this thread: a slow one gets fewer, the newest first.

        Raises:
            HostlinkError: as `run`; an error of `report` cancels the coroutine.
        """
        newest: deque[Item] = deque(maxlen=1)
        news = threading.Event()

        def note(item: Item) -> None:
            newest.append(item)
            news.set()

        def wait(call: concurrent.futures.Future[Any]) -> None:
            call.add_done_callback(lambda _: news.set())
            while report is not None and not call.done():
                news.wait()
                news.clear()
                if newest:
                    report(newest.pop())
            if report is not None and newest and not call.cancelled() and call.exception() is None:
                report(newest.pop())

        return self.run(begin(note), wait)

    def call(self, function: Callable[[], Result]) -> Result:
        """Call a function in the connection's thread, and return its result.

        Raises:
            HostlinkError: as `run`.
        """

        async def work() -> Result:
            return function()

        return self.run(work())

    def begin(self, work: Coroutine[Any, Any, object]) -> None:
        """Start a coroutine without waiting for it, for finalizers."""
        if os.getpid() == self._process:
            self._life.begin(work)
        else:
            work.close()

    def close(self) -> None:
        """End the connection; what is driven stops.

        Raises:
            HostlinkError: a published message was refused, and the refusal was not reported yet.
        """
        if os.getpid() == self._process and not self._is_closed:
            self._is_closed = True
            self._life.end()
            with contextlib.suppress(TimeoutError):
                _result(self._life.ended, CLOSE_TIMEOUT_S)


def _result(future: "concurrent.futures.Future[Result]", timeout_s: float | None = None) -> Result:
    """Return the result of a call; an error is raised without the other thread's traceback."""
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
            for call in list(self._calls):  # that came after the loop had ended
                call.cancel()

    async def _live(self) -> None:
        async with self._connecting as host:
            self.opened.set_result(host)
            await self._ending.wait()

    def _close_loop(self) -> None:
        """Close the loop as asyncio.Runner does, without waiting for threads that resolve names."""
        calls = asyncio.all_tasks(self._loop)
        for call in calls:
            call.cancel()
        if calls:
            self._loop.run_until_complete(asyncio.wait(calls, timeout=CANCEL_TIMEOUT_S))
        self._loop.run_until_complete(self._loop.shutdown_asyncgens())
        self._loop.close()

    def begin(self, work: Coroutine[Any, Any, Result]) -> "concurrent.futures.Future[Result]":
        """Start a coroutine; it is cancelled when the connection ends first."""
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

    def begin_stop(self, is_meant: Callable[[Repeated], bool] | None = None) -> Names | None:
        """Stop what is driven, or only these velocities, and stay connected; None: there is no connection."""
        if self.ended.done() or not self.opened.done() or self.opened.exception() is not None:
            return None
        return self.begin(self.opened.result().stop_driven(is_meant))

    def end_cell(self, *, has_failed: bool) -> Names | None:
        """Stop what the cell of this thread drove without `keep`; after an error, everything."""
        thread = threading.current_thread()
        return self.begin_stop(None if has_failed else lambda each: each.is_of_cell(thread))

    def finish(self) -> None:
        """End, and wait until it has."""
        self.end()
        with contextlib.suppress(TimeoutError, HostlinkError):
            self.ended.result(CLOSE_TIMEOUT_S)


# -- streams ----------------------------------------------------------------------------------------------------------

PlainAnswer = Callable[[Values], Values | None]
_END: Any = object()


class Stream(Iterator[Item]):
    """Iterate over it with `for`, or get one item with `next`. After `break` it may be read on; Ctrl-C ends it."""

    def __init__(self, loop: LoopThread, source: AsyncIterator[Item], name: str) -> None:
        self._loop, self._source, self._name = loop, source, name

    def __next__(self) -> Item:
        """The next one, as soon as there is one.

        Raises:
            HostlinkError: what the same stream of `connect` raises; the connection is closed.
        """
        item = self._loop.run(_next(self._source))
        if item is _END:
            raise StopIteration
        return item

    def close(self) -> None:
        """Read no more of it."""
        if isinstance(self._source, AsyncGenerator):
            with contextlib.suppress(HostlinkError):  # the connection is closed, and so is this
                self._loop.run(_close(self._source))

    def __enter__(self) -> "Stream[Item]":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Stream of {self._name}>"


class Messages(Stream[Item]):
    """A stream whose items wait for the reader, the newest 256 of them. Ctrl-C does not end it; `close` does."""

    def __init__(self, loop: LoopThread, opened: contextlib.AbstractAsyncContextManager[Mailbox[Item]]) -> None:
        self._opened, self._mailbox = opened, loop.run(opened.__aenter__())
        super().__init__(loop, self._mailbox, self._mailbox.name)
        self._forgotten = weakref.finalize(self, lambda: loop.begin(opened.__aexit__(None, None, None)))
        self._forgotten.atexit = False

    @property
    def dropped(self) -> int:
        """Number of items that were dropped because the reader was too slow."""
        return self._mailbox.dropped

    def pop_all(self) -> list[Item]:
        """Return the items that have arrived, without waiting.

        Raises:
            HostlinkError: the subscription was refused, or the connection is lost for good.
        """
        return self._loop.call(self._mailbox.pop_all)

    def close(self) -> None:
        """Unsubscribe; a running iteration raises an error."""
        if self._forgotten.detach() is not None:
            with contextlib.suppress(HostlinkError):  # the connection is closed, and so is this
                self._loop.run(self._opened.__aexit__(None, None, None))
                self._loop.call(lambda: self._mailbox.put(HostlinkError(f"the stream of {self._name} is closed")))

    def __repr__(self) -> str:
        return repr(self._mailbox).replace("Mailbox", "Messages", 1)


class Opened:
    """Advertisement or service. It lasts until `close`, the end of its `with` block, or that of the connection."""

    def __init__(self, loop: LoopThread, opened: contextlib.AbstractAsyncContextManager[None], name: str) -> None:
        self._loop, self._opened, self._name = loop, opened, name
        self._is_open = True
        loop.run(opened.__aenter__())
        loop.kept.add(opened)

    def close(self) -> None:
        """End it."""
        if self._is_open:
            self._is_open = False
            self._loop.kept.discard(self._opened)
            with contextlib.suppress(HostlinkError):  # the connection is closed, and so is this
                self._loop.run(self._opened.__aexit__(None, None, None))

    def __enter__(self) -> "Opened":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<{'open' if self._is_open else 'closed'}: {self._name}>"


def in_thread(answer: PlainAnswer) -> Answer:
    """Each call in a thread of its own: it may take its time, and use the connection."""

    async def answer_call(values: Values) -> Values | None:
        answered: concurrent.futures.Future[Values | None] = concurrent.futures.Future()
        answered.set_running_or_notify_cancel()
        threading.Thread(target=_answer, args=(answer, values, answered), name="hostlink call", daemon=True).start()
        return await asyncio.wrap_future(answered)

    return answer_call


def _answer(answer: PlainAnswer, values: Values, answered: "concurrent.futures.Future[Values | None]") -> None:
    try:
        answered.set_result(answer(values))
    except HostlinkError as error:
        answered.set_exception(error)
    finally:
        if not answered.done():  # the thread shows the error where the program runs
            answered.set_exception(HostlinkError("the program that offers the service has an error in its answer"))


async def _next(source: AsyncIterator[Item]) -> Item:
    return await anext(source, _END)


async def _close(source: AsyncGenerator[Any, None]) -> None:
    await source.aclose()
