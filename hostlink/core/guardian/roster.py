"""GuardedLinks: connections that the guardian should hold, and records still to be sent to it. Pure.

The size is bounded by the daemon's links: one entry for each, and one for each that the guardian still has to release.
"""

from collections.abc import Callable
from dataclasses import dataclass

from hostlink.core.guardian.records import RELEASE, WATCH, encode
from hostlink.core.runtime.stop_frames import StopFrames


@dataclass(frozen=True, slots=True)
class Watched:
    """Data needed to stop one robot."""

    connection: Callable[[], int | None]  # returns its descriptor while it is open
    stop: StopFrames


class GuardedLinks:
    """Wanted and guarded links by number. Two changes of a link before it is sent cause one record."""

    def __init__(self) -> None:
        self._wanted: dict[int, Watched] = {}
        self._guarded: set[int] = set()  # by the guardian, if it received every record
        self._unsent: dict[int, None] = {}  # link numbers, oldest first

    @property
    def connections(self) -> int:
        """Number of connections that the guardian has, if it received every record."""
        return len(self._guarded)

    def watch(self, number: int, watched: Watched) -> None:
        """Guard a link, or replace the frames that stop its device."""
        self._wanted[number] = watched
        self._unsent[number] = None

    def release(self, number: int) -> None:
        """Stop guarding a link."""
        self._wanted.pop(number, None)
        self._unsent.pop(number, None)
        if number in self._guarded:
            self._unsent[number] = None

    def next(self) -> tuple[bytes, int | None] | None:
        """Return the next record and its descriptor; None if the guardian is up to date."""
        while self._unsent:
            number = next(iter(self._unsent))
            watched = self._wanted.get(number)
            descriptor = None if watched is None else watched.connection()
            if watched is not None and descriptor is not None:
                return encode(WATCH, number, watched.stop), descriptor
            if number in self._guarded:
                return encode(RELEASE, number), None
            del self._unsent[number]  # closed before it was sent
        return None

    def confirm(self, *, has_descriptor: bool) -> None:
        """Note that the record of `next` was sent, with or without a descriptor."""
        number = next(iter(self._unsent))
        del self._unsent[number]
        if has_descriptor:
            self._guarded.add(number)
        else:
            self._guarded.discard(number)

    def forget(self) -> None:
        """Reset what the guardian knows, because it ended. Everything is sent to the next one."""
        self._guarded.clear()
        self._unsent = dict.fromkeys(self._wanted)
