"""Virtual time: when nothing is ready, the clock jumps to the next timer. An hour of waiting lasts about a millisecond.

    def test_a_silent_device_is_dropped() -> None:
        assert run_virtual(link.run()) is LinkEnd.IDLE

For coroutines whose world is in memory (`memory_transport.py`): a socket on the loop is a NotImplementedError.
`loop.time()` is virtual and starts at 0; `time.time()` is not. Measured need: 150 tests wait for hours of virtual time.
The standard library has no loop with a virtual clock, and this one also reports a deadlock.
"""

import asyncio
import functools
import inspect
from collections.abc import Awaitable, Callable, Coroutine
from contextlib import AbstractAsyncContextManager
from typing import Any, Concatenate, ParamSpec, TypeVar

Result = TypeVar("Result")
World = TypeVar("World")
Arguments = ParamSpec("Arguments")
Settings = ParamSpec("Settings")


class Deadlock(AssertionError):
    """Every task waits, and no timer will wake one."""


def run_virtual(coroutine: Coroutine[Any, Any, Result]) -> Result:
    """Run to the end in a loop of its own; tasks that are left are cancelled. For plain `def` tests."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(coroutine)


def virtual(test: Callable[Arguments, Coroutine[Any, Any, None]]) -> Callable[Arguments, None]:
    """Decorator of a test that is a coroutine: it runs in virtual time."""

    @functools.wraps(test)
    def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> None:
        run_virtual(test(*args, **kwargs))

    return run


def inside(
    play: Callable[Concatenate[Callable[[World], Awaitable[None]], Settings], None],
    *settings: Settings.args,
    **named: Settings.kwargs,
) -> Callable[[Callable[Concatenate[World, Arguments], Awaitable[None]]], Callable[Arguments, None]]:
    """Decorator of a test that is a coroutine: `play` runs it with what it makes, which is the first argument.

    The other arguments are those of pytest.
    """

    def decorate(test: Callable[Concatenate[World, Arguments], Awaitable[None]]) -> Callable[Arguments, None]:
        @functools.wraps(test)
        def run(*args: Arguments.args, **kwargs: Arguments.kwargs) -> None:
            play(lambda world: test(world, *args, **kwargs), *settings, **named)

        whole = inspect.signature(test)
        run.__signature__ = whole.replace(parameters=list(whole.parameters.values())[1:])  # type: ignore[attr-defined]
        return run

    return decorate


def within(
    world: Callable[Settings, AbstractAsyncContextManager[World]], *settings: Settings.args, **named: Settings.kwargs
) -> Callable[[Callable[Concatenate[World, Arguments], Awaitable[None]]], Callable[Arguments, None]]:
    """Decorator of a test that is a coroutine: it runs in virtual time, in the block of `world`, its first argument."""

    def play(test: Callable[[World], Awaitable[None]]) -> None:
        async def run() -> None:
            async with world(*settings, **named) as made:
                await test(made)

        run_virtual(run())

    return inside(play)


class VirtualLoop(asyncio.BaseEventLoop):
    """An event loop that is its own selector: where others wait for sockets, it moves the clock."""

    def __init__(self) -> None:
        super().__init__()
        self._selector = self
        self._clock_resolution = 1e-6  # the usual 1e-9 is lost in rounding after some months
        self._now_s = 0.0
        self.readers: dict[Any, Callable[[], object]] = {}  # of sockets that a test pretends to have

    def add_reader(self, fd: Any, callback: Callable[..., object], *args: object) -> None:
        """Note the callback. The test calls it when its socket is readable."""
        self.readers[fd] = functools.partial(callback, *args)

    def remove_reader(self, fd: Any) -> bool:
        return self.readers.pop(fd, None) is not None

    def remove_writer(self, fd: Any) -> bool:  # noqa: ARG002 - of asyncio
        return False

    def time(self) -> float:
        """Seconds since the loop was made."""
        return self._now_s

    def burn(self, seconds: float) -> None:
        """A callback computes for a time: it passes, and nothing else runs."""
        self._now_s += seconds

    def run_in_executor(self, executor: object, func: Callable[..., Any], *args: Any) -> asyncio.Future[Any]:  # type: ignore[override]  # noqa: ARG002 - of asyncio
        """Run a thread's work at once: it lasts no virtual time."""
        future = self.create_future()
        try:
            future.set_result(func(*args))
        except Exception as error:  # noqa: BLE001 - it is the caller's, as of a thread
            future.set_exception(error)
        return future

    def add_signal_handler(self, sig: int, callback: Callable[..., object], *args: object) -> None:
        """Do nothing, because no signal arrives."""

    def remove_signal_handler(self, sig: int) -> bool:  # noqa: ARG002 - of asyncio
        return True

    def select(self, timeout: float | None) -> list[object]:
        """Called between two rounds of callbacks; `timeout` is the time to the next timer, None: there is none."""
        if timeout is None:
            raise Deadlock(f"deadlock at {self._now_s:g} s: nothing is ready and no timer is set\n{self._waiting()}")
        self._now_s += timeout
        if self._scheduled and self._scheduled[0].when() < self._now_s + self._clock_resolution:
            self._now_s = max(self._now_s, self._scheduled[0].when())  # else a loop of tiny sleeps would never end
        return []

    def _waiting(self) -> str:
        return "\n".join(sorted(f"  {task.get_name()} waits in {_place(task)}" for task in asyncio.all_tasks(self)))

    def _process_events(self, events: list[object]) -> None:
        """No socket, no event."""

    def _write_to_self(self) -> None:
        """Do nothing, because no thread waits in `select`."""


def _place(task: asyncio.Task[Any]) -> str:
    stack = task.get_stack()
    if not stack:
        return "nothing yet"
    frame = stack[-1]
    return f"{frame.f_code.co_qualname}, {frame.f_code.co_filename}:{frame.f_lineno}"
