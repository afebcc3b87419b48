"""What a blocking connection gives that lasts: streams to iterate over, and what is open until it is closed."""

import asyncio
import concurrent.futures
import contextlib
import threading
import weakref
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterator
from typing import Any, TypeVar

from hostlink.client.loop_thread import LoopThread
from hostlink.client.mailbox import Mailbox
from hostlink.client.services import Answer, Values
from hostlink.errors import HostlinkError

Item = TypeVar("Item")
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
        self._opened, self._mailbox = opened, loop.run(_enter(opened))
        super().__init__(loop, self._mailbox, self._mailbox.name)
        self._forgotten = weakref.finalize(self, _forget, loop, opened)
        self._forgotten.atexit = False

    @property
    def dropped(self) -> int:
        """How many items the reader was too slow for."""
        return self._mailbox.dropped

    def pop_all(self) -> list[Item]:
        """What waits now, without waiting.

        Raises:
            HostlinkError: the subscription was refused, or the connection is lost for good.
        """
        return self._loop.call(self._mailbox.pop_all)

    def close(self) -> None:
        """Unsubscribe; whoever iterates gets an error."""
        if self._forgotten.detach() is not None:
            with contextlib.suppress(HostlinkError):  # the connection is closed, and so is this
                self._loop.run(_exit(self._opened))
                self._loop.call(lambda: self._mailbox.put(HostlinkError(f"the stream of {self._name} is closed")))

    def __repr__(self) -> str:
        return repr(self._mailbox).replace("Mailbox", "Messages", 1)


class Opened:
    """It lasts until `close`, the end of its `with` block, or that of the connection; nobody needs to keep it."""

    def __init__(self, loop: LoopThread, opened: contextlib.AbstractAsyncContextManager[None], name: str) -> None:
        self._loop, self._opened, self._name = loop, opened, name
        self._is_open = True
        loop.run(_enter(opened))
        loop.kept.add(opened)

    def close(self) -> None:
        """End it."""
        if self._is_open:
            self._is_open = False
            self._loop.kept.discard(self._opened)
            with contextlib.suppress(HostlinkError):  # the connection is closed, and so is this
                self._loop.run(_exit(self._opened))

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


async def _enter(opened: contextlib.AbstractAsyncContextManager[Item]) -> Item:
    return await opened.__aenter__()


async def _exit(opened: contextlib.AbstractAsyncContextManager[Any]) -> None:
    await opened.__aexit__(None, None, None)


def _forget(loop: LoopThread, opened: contextlib.AbstractAsyncContextManager[Any]) -> None:
    loop.begin(_exit(opened))
