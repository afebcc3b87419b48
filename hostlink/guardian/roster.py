"""Roster: which connections the guardian should hold, and what must still be sent to it. Pure.

It is bounded by the daemon's own links: one entry each, and one for each that the guardian holds without need.
"""

from collections.abc import Callable
from dataclasses import dataclass

from hostlink.guardian.records import encode_release, encode_watch


@dataclass(frozen=True, slots=True)
class Watched:
    """How one robot is stopped."""

    connection: Callable[[], int | None]  # its descriptor, as long as it is open
    topic_ids: tuple[int, ...]
    claim_bytes: int


class Roster:
    """Links by number. What changes twice before it was sent is sent once."""

    def __init__(self) -> None:
        self._wanted: dict[int, Watched] = {}
        self._guarded: set[int] = set()  # as far as the guardian knows
        self._unsent: dict[int, None] = {}  # the oldest first

    @property
    def connections(self) -> int:
        """How many connections the guardian has, if it received all that were sent."""
        return len(self._guarded)

    def watch(self, number: int, watched: Watched) -> None:
        """Give the guardian this link, or this link's new velocity topics."""
        self._wanted[number] = watched
        self._unsent[number] = None

    def release(self, number: int) -> None:
        """The guardian needs this link no more."""
        self._wanted.pop(number, None)
        self._unsent.pop(number, None)
        if number in self._guarded:
            self._unsent[number] = None

    def next(self) -> tuple[bytes, int | None] | None:
        """The record to send next, and the descriptor to go with it; None: the guardian knows all."""
        while self._unsent:
            number = next(iter(self._unsent))
            watched = self._wanted.get(number)
            descriptor = None if watched is None else watched.connection()
            if watched is not None and descriptor is not None:
                return encode_watch(number, watched.topic_ids, watched.claim_bytes), descriptor
            if number in self._guarded:
                return encode_release(number), None
            del self._unsent[number]  # it closed before it was passed on
        return None

    def confirm(self, *, has_descriptor: bool) -> None:
        """The record that `next` gave was sent; `is_held`: with a descriptor."""
        number = next(iter(self._unsent))
        del self._unsent[number]
        if has_descriptor:
            self._guarded.add(number)
        else:
            self._guarded.discard(number)

    def forget(self) -> None:
        """The guardian has ended: everything will have to be sent to another."""
        self._guarded.clear()
        self._unsent = dict.fromkeys(self._wanted)
