"""The connection of a command to the daemon, and what a command shows while it waits or follows a topic."""

import asyncio
import contextlib
import signal
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from hostlink.cli.names import similar
from hostlink.cli.output import end_line, show_progress, write_error
from hostlink.cli.own_name import NAME
from hostlink.client import Host, connect

Answer = TypeVar("Answer")

PATIENCE_S = 2.0
INTERVAL_S = 1.0
CHECKED_ITEMS = 256  # between two readings of the clock

# -- connecting -------------------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def connected(url: str, token: str | None) -> AsyncIterator[Host]:
    """Connect to the daemon for the length of the block; a lost connection is not opened again.

    Raises:
        HostlinkError: no hostlink answers at `url`, the daemon refuses, or the connection is lost.
    """
    async with contextlib.AsyncExitStack() as stack:
        with waiting(f"connecting to {url}"):
            host = await stack.enter_async_context(connect(url, token=token, reconnect=False, name=_command()))
        yield host


def _command() -> str:
    """Return the name of the command that runs, which the daemon shows as the name of this program."""
    if Path(sys.argv[0]).name != NAME:
        return NAME  # started by another program
    return next((word for word in sys.argv[1:] if not word.startswith("-")), NAME)


def ask(url: str, token: str | None, work: Callable[[Host], Awaitable[Answer]]) -> Answer:
    """Connect to the daemon, return what `work` returns, and disconnect.

    Raises:
        HostlinkError: no hostlink answers at `url`, the daemon refuses, or the connection is lost.
    """

    async def run() -> Answer:
        async with connected(url, token) as host:
            return await work(host)

    return asyncio.run(run())


async def rosapi(host: Host, service: str, field: str, /, **request: str) -> Any:
    """Call a service of rosapi; return one field of its answer."""
    return (await host.call(f"/rosapi/{service}", request))[field]


# -- waiting ----------------------------------------------------------------------------------------------------------


Show = Callable[[str], None]

Item = TypeVar("Item")


@contextlib.contextmanager
def waiting(text: str, show: Show = show_progress) -> Iterator[None]:
    """Show the text with the seconds that have passed, if the block lasts longer than PATIENCE_S."""
    loop = asyncio.get_running_loop()
    began_s, is_shown = loop.time(), False
    timer: asyncio.TimerHandle

    def show_line() -> None:
        nonlocal timer, is_shown
        is_shown = True
        show(f"{text} ... {loop.time() - began_s:.0f} s; Ctrl-C ends")
        timer = loop.call_later(INTERVAL_S, show_line)

    timer = loop.call_later(PATIENCE_S, show_line)
    try:
        yield
    finally:
        timer.cancel()
        if is_shown:
            show("")


def counted(
    items: Iterable[Item], what: str, *, show: Show = show_progress, clock: Callable[[], float] = time.monotonic
) -> Iterator[Item]:
    """Pass the items on; after PATIENCE_S show each second how many have passed."""
    show_at_s = clock() + PATIENCE_S
    is_shown = False
    for count, item in enumerate(items):
        if count % CHECKED_ITEMS == 0 and clock() >= show_at_s:
            show_at_s, is_shown = clock() + INTERVAL_S, True
            show(f"{count} {what} ...")
        yield item
    if is_shown:
        show("")


# -- following --------------------------------------------------------------------------------------------------------


def run_until_interrupted(work: Coroutine[Any, Any, None]) -> None:
    """Run a coroutine until its end, or until Ctrl-C. A second Ctrl-C cancels what the coroutine does at its end."""
    try:
        asyncio.run(_cancelled_by_ctrl_c(work))
    except (KeyboardInterrupt, asyncio.CancelledError):
        end_line()


async def _cancelled_by_ctrl_c(work: Coroutine[Any, Any, None]) -> None:
    """Await the coroutine. asyncio's own handler raises a second Ctrl-C in any callback, which ends in a traceback."""
    running = asyncio.current_task()
    assert running is not None  # noqa: S101 - this is a coroutine of a task
    asyncio.get_running_loop().add_signal_handler(signal.SIGINT, running.cancel)
    await work


async def write_hint(host: Host, topic: str) -> None:
    """Write one line about a topic that has no publisher, with the names that are similar."""
    topics = {each["name"]: each for each in await host.topics()}
    full = "/" + topic.lstrip("/~")
    known = topics.pop(full, None)
    if known is not None and known["publishers"]:
        return
    names = similar(full, topics) if known is None or not known["messages"] else ""
    write_error(f"{full} has no publisher; {names}`hostlink topics` lists all topics; waiting, Ctrl-C ends")
