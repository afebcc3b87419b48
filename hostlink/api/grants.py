"""Grants: which requests are answered at this moment by which token, to end those whose token is withdrawn."""

import asyncio
import contextlib
from collections.abc import Container, Iterator

from hostlink.api.access import Grant

Answering = asyncio.Task[object]


class Grants:
    """The tasks that answer requests; that of a WebSocket lasts as long as it is open."""

    def __init__(self) -> None:
        self._tasks: dict[Answering, Grant] = {}

    @contextlib.contextmanager
    def using(self, grant: Grant) -> Iterator[None]:
        """The present task answers by it within the block."""
        task = _present_task()
        self._tasks[task] = grant
        try:
            yield
        finally:
            del self._tasks[task]

    def end(self, revoked: Container[str]) -> None:
        """End those of the tokens with these names, but not the one that withdraws them; what they drive stops."""
        present = asyncio.current_task()
        for task, grant in self._tasks.items():
            if grant.who in revoked and task is not present:
                task.cancel()


def _present_task() -> Answering:
    task = asyncio.current_task()
    assert task is not None  # noqa: S101 - of a coroutine
    return task
