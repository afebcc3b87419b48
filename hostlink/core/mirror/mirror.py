"""Mirror: a Reconciler whose endpoints are objects or tasks of this event loop."""

import asyncio
import math
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Generic, Protocol, TypeVar

from hostlink.core.mirror.reconciler import Close, Key, Open, Reconciler, Spec
from hostlink.core.runtime.loop_time import loop_time_s


class Endpoint(Protocol):
    """Open endpoint."""

    def close(self) -> None:
        """Close the endpoint, without waiting."""


Made = TypeVar("Made", bound=Endpoint)


class Mirror(Generic[Key, Spec, Made]):
    """Opens and closes at once what a change of what is wanted calls for, and later what has failed."""

    def __init__(
        self,
        open_: Callable[[Key, Spec], Made],
        on_failure: Callable[[Key, Exception], None],
        *,
        slice_s: float = math.inf,
        **bounds: Any,
    ) -> None:
        """Mirror what `want` and `put` want.

        Args:
            open_: opens an endpoint, or raises why it cannot be.
            on_failure: called with what opening, closing or a task raised; no other endpoint is affected.
            slice_s: of the loop's time at once; as long is left to others before the next slice.
            bounds: arguments of Reconciler.
        """
        self.endpoints: dict[Key, Made] = {}
        self._open, self._on_failure, self._slice_s = open_, on_failure, slice_s
        self._reconciler: Reconciler[Key, Spec] = Reconciler(**bounds)
        self._is_settled = True  # what is opened works
        self._is_working = False
        self._is_closed = False
        self._timer: asyncio.TimerHandle | None = None
        self._is_paused = False  # the timer ends the pause after a slice

    @classmethod
    def of_tasks(
        cls,
        serve: Callable[[Key, Spec], Coroutine[Any, Any, None]],
        spawn: Callable[[Coroutine[Any, Any, None]], asyncio.Task[None]],
        on_failure: Callable[[Key, Exception], None],
        **bounds: Any,
    ) -> "Mirror[Key, Spec, Served[Key]]":
        """Mirror endpoints that are tasks: each runs `serve` until it is closed, fails, or returns.

        One that has failed or returned is served again after `retry_s`.
        """

        def open_(key: Key, spec: Spec) -> Served[Key]:
            served = Served(key, mirror)
            served.task = spawn(served.run(lambda: serve(key, spec)))
            return served

        mirror: Mirror[Key, Spec, Served[Key]] = Mirror(open_, on_failure, **bounds)
        mirror._is_settled = False
        return mirror

    @property
    def wanted(self) -> Mapping[Key, Spec]:
        """Wanted specifications, including those that failed or have no room."""
        return self._reconciler.wanted

    def want(self, wanted: Mapping[Key, Spec]) -> None:
        """Want these, and nothing else."""
        self._reconciler.want(wanted)
        self._work()

    def put(self, key: Key, spec: Spec | None) -> None:
        """Want a key with this specification; None: no longer."""
        self._reconciler.put(key, spec)
        self._work()

    def retry(self) -> None:
        """Try what has failed again now."""
        self._reconciler.retry()
        self._work()

    def ended(self, key: Key, error: Exception | None = None) -> None:
        """An endpoint ended by itself; `error`: why, if that was a failure."""
        self.endpoints.pop(key, None)
        self._reconciler.ended(key, loop_time_s(), has_failed=error is not None)
        self._work()

    def report(self, key: Key, error: Exception) -> None:
        """Report a failure of an endpoint that was closed."""
        self._on_failure(key, error)

    def close(self) -> None:
        """Close everything, and never open an endpoint again."""
        self._is_closed, self._slice_s = True, math.inf
        self._reconciler.want({})
        self._work(is_due=True)

    def _work(self, *, is_due: bool = False) -> None:
        """Do what is to be done, for one slice. What opening and closing change is a part of it."""
        if self._is_working or (self._is_paused and not is_due):
            return
        self._is_working = True
        until_s, is_finished = loop_time_s() + self._slice_s, False
        try:
            while not is_finished:
                action = None if self._is_closed and not self.endpoints else self._reconciler.next(loop_time_s())
                is_finished = action is None
                if action is not None:
                    self._perform(action)
                    if loop_time_s() >= until_s:
                        break
        finally:
            self._is_working = False
            self._expect(is_finished=is_finished)

    def _expect(self, *, is_finished: bool) -> None:
        """Work again after a pause, or when a failure is due."""
        self._is_paused = not is_finished and self._slice_s < math.inf
        at_s = self._reconciler.due_s if is_finished else loop_time_s() + (self._slice_s if self._is_paused else 0.0)
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if at_s < math.inf and not (self._is_closed and is_finished):
            self._timer = asyncio.get_running_loop().call_at(at_s, lambda: self._work(is_due=True))

    def _perform(self, action: Open[Key, Spec] | Close[Key, Spec]) -> None:
        key = action.key
        try:
            if isinstance(action, Close):
                self._reconciler.done(action)
                self.endpoints.pop(key).close()
            else:
                self.endpoints[key] = self._open(key, action.spec)
                self._reconciler.done(action, is_settled=self._is_settled)
        except Exception as error:  # noqa: BLE001 - any failure concerns this endpoint alone
            if isinstance(action, Open):
                self._reconciler.failed(action, loop_time_s())
            self._on_failure(key, error)


class Served(Generic[Key]):
    """An endpoint that is a task."""

    def __init__(self, key: Key, mirror: Mirror[Key, Any, Any]) -> None:
        self.task: asyncio.Task[None] | None = None
        self._key, self._mirror = key, mirror

    def close(self) -> None:
        """Cancel the task."""
        assert self.task is not None  # noqa: S101 - it is set with the endpoint
        self.task.cancel()

    async def run(self, serve: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Serve; a failure of a task that was closed already is only reported."""
        failure: Exception | None = None
        try:
            await serve()
        except Exception as error:  # noqa: BLE001 - any failure concerns this endpoint alone
            failure = error
        if self._mirror.endpoints.get(self._key) is self:
            self._mirror.ended(self._key, failure)
        if failure is not None:
            self._mirror.report(self._key, failure)
