"""Isolation: the boundaries at which a crash is logged and counted, and behind which nothing else ends."""

import contextlib
from collections import Counter
from collections.abc import Coroutine, Iterator
from typing import Any, Protocol

import structlog

log = structlog.get_logger()


class Isolation:
    """The boundaries between links, robots, participants and the daemon's own work."""

    def __init__(self, *, reraises: bool = False) -> None:
        """`reraises`: a crash is raised after it was counted, for tests."""
        self.crashes: Counter[str] = Counter()
        self._reraises = reraises

    @contextlib.contextmanager
    def around(self, what: str, **facts: object) -> Iterator[None]:
        """Keep an exception of the block from whoever entered it; logged as `what`.crashed."""
        try:
            yield
        except Exception as error:  # noqa: BLE001 - this is the boundary
            self.crashed(what, error, **facts)

    def crashed(self, what: str, error: Exception, **facts: object) -> None:
        """Count it and log it: without the traceback where that fails, which reads source files and needs memory."""
        self.crashes[what] += 1
        event = f"{what}.crashed"
        try:
            log.error(event, exc_info=error, **facts)
        except Exception:  # noqa: BLE001 - whatever it was, the crash itself matters more
            with contextlib.suppress(Exception):
                log.error(event, cause=repr(error), **facts)  # noqa: TRY400 - without the traceback, which failed
        if self._reraises:
            raise error


class Spawn(Protocol):
    """Run something, at most as long as the hub; its crash ends nothing else."""

    def __call__(self, work: Coroutine[Any, Any, object], *, name: str) -> object: ...
