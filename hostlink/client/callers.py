"""Callers: when each thread of a program, or with asyncio each task, has called the client.

A program that hangs makes no call; the connection's own thread does not hang with it.
"""

import asyncio
import contextvars
import math
import threading
import time
import weakref
from collections.abc import Callable

Caller = threading.Thread | asyncio.Task[object]

_CLOCK = getattr(
    time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC
)  # it also counts while the computer sleeps, where the system has such a clock

calling_thread: contextvars.ContextVar[threading.Thread | None] = contextvars.ContextVar("calling_thread", default=None)
_is_own: contextvars.ContextVar[bool] = contextvars.ContextVar("is_own", default=False)


def boot_s() -> float:
    """Seconds since this computer was started, with those that it slept."""
    return time.clock_gettime(_CLOCK)


def thread_context() -> contextvars.Context:
    """Return a context in which the connection's thread works for the thread that calls this."""
    context = contextvars.copy_context()
    context.run(calling_thread.set, threading.current_thread())
    context.run(_is_own.set, False)
    return context


def own_context() -> contextvars.Context:
    """Return a context for the tasks of the connection itself. The program makes no call in them."""
    context = contextvars.copy_context()
    context.run(calling_thread.set, None)
    context.run(_is_own.set, True)
    return context


class Callers:
    """Times of calls: when one begins, when it returns, and with each item of a stream.

    A call that waits does not count: it may wait for ever.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        """`clock`: in seconds; it also counts while the computer sleeps."""
        self.now_s = clock
        self._called_s: weakref.WeakKeyDictionary[Caller, float] = weakref.WeakKeyDictionary()
        self._newest_s = -math.inf

    def note(self) -> None:
        """Note a call of the thread or task that runs."""
        caller = _caller()
        if caller is not None:
            self._called_s[caller] = self._newest_s = self.now_s()

    def called_s(self, thread: threading.Thread | None, task: asyncio.Task[object] | None) -> float:
        """Return the time of the newest call of a thread, or without one of a task; of all, when the task has ended.

        A library may make a task for one call, as asyncio.gather does.
        """
        if thread is not None:
            return self._called_s.get(thread, -math.inf)
        if task is None or task.done():
            return self._newest_s
        return self._called_s.get(task, -math.inf)


def _caller() -> Caller | None:
    """The thread or the task of the program that runs; None: it is one of the connection itself."""
    if _is_own.get():
        return None
    try:
        task = asyncio.current_task()
    except RuntimeError:  # no event loop runs here
        return threading.current_thread()
    return calling_thread.get() or task
