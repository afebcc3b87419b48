"""Spawn: how parts have something run beside everything else, as `Hub.spawn` does."""

from collections.abc import Coroutine
from typing import Any, Protocol


class Spawn(Protocol):
    """Run something, at most as long as the hub; its crash ends nothing else."""

    def __call__(self, work: Coroutine[Any, Any, object], *, name: str) -> object: ...
