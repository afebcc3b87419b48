"""Guard: what the hub knows of the process that stops the robots when this one cannot any more."""

from collections.abc import Callable, Sequence
from typing import Protocol


class Guard(Protocol):
    """Its methods do not wait, and do not fail."""

    def watch(
        self, number: int, connection: Callable[[], int | None], *, topic_ids: Sequence[int], claim_bytes: int
    ) -> None:
        """A link has these velocity topics.

        `connection`: its descriptor while it is open; `claim_bytes`: the longest frame that was sent.
        """
        ...

    def release(self, number: int) -> None:
        """A link has ended, or has no velocity topic any more."""
        ...
