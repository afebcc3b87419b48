"""Isolation: boundaries at which a crash is logged and counted, so that it ends nothing else."""

import contextlib
from collections import Counter
from collections.abc import Coroutine
from typing import Any, Protocol

import structlog

log = structlog.get_logger()


class Isolation:
    """Boundaries between links, robots, participants and tasks of the daemon."""

    def __init__(self, *, reraises: bool = False) -> None:
        """`reraises` is for tests: a crash is raised after it was counted."""
        self.crashes: Counter[str] = Counter()
        self._reraises = reraises

    def around(self, what: str, **facts: object) -> "_Boundary":
        """Catch an exception of the block, and log it as `what`.crashed."""
        return _Boundary(self, what, facts)

    def crashed(self, what: str, error: Exception, **facts: object) -> None:
        """Count and log a crash. Without the traceback if that fails: it reads source files and needs memory."""
        self.crashes[what] += 1
        event = f"{what}.crashed"
        try:
            log.error(event, exc_info=error, **facts)
        except Exception:  # noqa: BLE001 - the crash itself matters more
            with contextlib.suppress(Exception):
                log.error(event, cause=repr(error), **facts)  # noqa: TRY400 - without the traceback, which failed
        if self._reraises:
            raise error


class _Boundary:
    """Block of `Isolation.around`. Each link is in two of them: a generator would need five times the memory."""

    __slots__ = ("_facts", "_isolation", "_what")

    def __init__(self, isolation: Isolation, what: str, facts: dict[str, object]) -> None:
        self._isolation, self._what, self._facts = isolation, what, facts

    def __enter__(self) -> None:
        """Begin the block."""

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> bool:
        """Log an exception. Return whether the block ended with one that is not to be raised."""
        if not isinstance(error, Exception):
            return False
        self._isolation.crashed(self._what, error, **self._facts)
        return True


class Spawn(Protocol):
    """Run work at most as long as the hub. A crash ends only this work."""

    def __call__(self, work: Coroutine[Any, Any, object], *, name: str) -> object: ...
