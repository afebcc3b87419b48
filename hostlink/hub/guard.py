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

    def beat(self, driven: set[int]) -> None:
        """This process runs, and these links have robots that may move; without a beat for a second they are stopped.

        Call it at least ten times a second while there are any, and once when there are none any more.
        """
        ...

    def release(self, number: int) -> None:
        """A link has ended, or has no velocity topic any more."""
        ...
