"""Guard: what the hub knows of whoever stops the robots when this process cannot any more."""

from collections.abc import Callable
from typing import Protocol


class Guard(Protocol):
    """Its methods do not wait, and do not fail."""

    def watch(self, number: int, connection: Callable[[], int | None], *, topic_id: int, claim_bytes: int) -> None:
        """A link is a robot's. `connection`: its descriptor while it is open; `claim_bytes`: its longest frame."""
        ...

    def release(self, number: int) -> None:
        """A link has ended, or is no robot's any more."""
        ...
