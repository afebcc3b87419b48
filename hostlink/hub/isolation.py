"""Isolation: boundaries at which a crash is logged and counted, so that it ends nothing else."""

import contextlib
from collections import Counter
from collections.abc import Coroutine, Iterator
from typing import Any, Protocol

import structlog

log = structlog.get_logger()


class Isolation:
    """Boundaries between links, robots, participants and tasks of the daemon."""

    def __init__(self, *, reraises: bool = False) -> None:
        """`reraises` is for tests: a crash is raised after it was counted."""
        self.crashes: Counter[str] = Counter()
        self._reraises = reraises

    @contextlib.contextmanager
    def around(self, what: str, **facts: object) -> Iterator[None]:
        """Catch an exception of the block, and log it as `what`.crashed."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - this is the boundary
            self.crashed(what, error, **facts)

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


class Spawn(Protocol):
    """Run work at most as long as the hub. A crash ends only this work."""

    def __call__(self, work: Coroutine[Any, Any, object], *, name: str) -> object: ...
