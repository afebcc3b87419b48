"""What ends the drives of a program whose connection has a thread of its own: that thread would go on.

| event                                                                      | then                               |
|----------------------------------------------------------------------------|------------------------------------|
| an error or Ctrl-C that nobody catches: in a script, a cell, at the prompt | what is driven stops               |
| an error that ends a thread, or exit() there                               | the same                           |
| the main thread is over, and another one lives                             | what ended threads drove stops     |
| the program ends: exit(), the last line, such an error                     | the same, and connections close    |
| the process is killed, the kernel of a notebook dies                       | the daemon notices that, and stops |
"""

import atexit
import concurrent.futures
import functools
import os
import sys
import threading
import weakref
from types import TracebackType
from typing import Any, Protocol

STOP_TIMEOUT_S = 1.5  # of all connections together


class Ends(Protocol):
    """A connection."""

    def begin_stop(self, *, of_ended_threads: bool = False) -> "concurrent.futures.Future[None] | None":
        """Begin to stop what is driven, or what threads drove that are over; None: there is nothing to stop."""
        ...

    def end(self) -> None:
        """Begin to close."""
        ...

    def finish(self) -> None:
        """Close, and wait until that is done."""
        ...


_watched: weakref.WeakSet[Ends] = weakref.WeakSet()
_shells: weakref.WeakSet[Any] = weakref.WeakSet()


def watch(connection: Ends) -> None:
    """End what it drives when the program, or a part of it, ends."""
    _watch_program()
    _watch_main_thread()
    _watched.add(connection)
    _watch_cells()


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
        connection.begin_stop(of_ended_threads=True)


def _watch_cells() -> None:
    """IPython and Jupyter catch the errors of a cell: they report them by an event."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    if shell is not None and shell not in _shells:
        _shells.add(shell)
        shell.events.register("post_run_cell", _end_cell)


def _end_cell(result: Any) -> None:
    if not result.success:
        _stop_all()


os.register_at_fork(after_in_child=_watched.clear)  # the connections are the parent's, and the threads
os.register_at_fork(after_in_child=_watch_main_thread.cache_clear)
