"""Work that waits for files, in a thread that may be left behind: a dead disk or network keeps nobody from ending."""

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import TypeVar

Result = TypeVar("Result")


class DetachedThread:
    """One piece of work at a time, each in a thread that the process does not wait for at its end."""

    def __init__(self, name: str) -> None:
        self.is_busy = False  # the last work still runs, also one that was given up
        self._name = name

    async def run(self, work: Callable[[], Result], *, timeout_s: float | None = None) -> Result:
        """Return what the work returns, or raise what it raises. Begin nothing while `is_busy`.

        Raises:
            TimeoutError: it lasts longer than timeout_s seconds; it goes on, and its result is dropped.
        """
        loop = asyncio.get_running_loop()
        finished: asyncio.Future[Result] = loop.create_future()

        def note(result: Result | None, error: BaseException | None) -> None:
            self.is_busy = False
            if finished.done():  # nobody waits for it any more
                return
            if error is None:
                finished.set_result(result)  # type: ignore[arg-type]
            else:
                finished.set_exception(error)

        def run() -> None:
            result, error = None, None
            try:
                result = work()
            except BaseException as raised:  # noqa: BLE001 - raised where it is waited for
                error = raised
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(note, result, error)

        self.is_busy = True
        threading.Thread(target=run, name=self._name, daemon=True).start()
        async with asyncio.timeout(timeout_s):
            return await finished
