"""Threads and processes that the daemon does not wait for: a thread may hang on a dead disk, a process outlives it."""

import asyncio
import contextlib
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from typing import TypeVar

Result = TypeVar("Result")


class DetachedThread:
    """Runner of one piece of work at a time. The process does not wait for its thread at the end."""

    def __init__(self, name: str) -> None:
        self.is_busy = False  # the last work still runs, including work that was abandoned
        self._name = name

    async def run(self, work: Callable[[], Result], *, timeout_s: float | None = None) -> Result:
        """Return what the work returns, or raise what it raises. Do not call it while `is_busy`.

        Raises:
            TimeoutError: the work lasts longer than timeout_s seconds. It continues, and its result is dropped.
        """
        loop = asyncio.get_running_loop()
        finished: asyncio.Future[Result] = loop.create_future()

        def note(result: Result | None, error: BaseException | None) -> None:
            self.is_busy = False
            if finished.done():  # the caller has given up
                return
            if error is None:
                finished.set_result(result)  # type: ignore[arg-type]
            else:
                finished.set_exception(error)

        def run() -> None:
            result, error = None, None
            try:
                result = work()
            except BaseException as raised:  # noqa: BLE001 - raised in the caller
                error = raised
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(note, result, error)

        self.is_busy = True
        threading.Thread(target=run, name=self._name, daemon=True).start()
        async with asyncio.timeout(timeout_s):
            return await finished


def start_python(arguments: Sequence[str], pass_fds: Sequence[int] = ()) -> "subprocess.Popen[bytes]":
    """Start a Python process that survives this one. All signals are blocked in it: the terminal's are not for it.

    Raises:
        OSError: it cannot be started.
    """
    before = signal.pthread_sigmask(signal.SIG_SETMASK, signal.valid_signals())
    try:
        return subprocess.Popen(  # noqa: S603 - every argument is our own
            [sys.executable, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=pass_fds,
            start_new_session=True,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
