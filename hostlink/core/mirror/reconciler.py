"""Reconciler: what is to be closed and opened next, so that what is open becomes equal to what is wanted. Pure."""

import heapq
import math
import operator
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

_MIN_HEAP = 64  # times of failures that are over

Key = TypeVar("Key", bound=Hashable)
Spec = TypeVar("Spec")


@dataclass(frozen=True, slots=True)
class Open(Generic[Key, Spec]):
    """Open an endpoint. With `replaces` another one of this key may be open; it is replaced."""

    key: Key
    spec: Spec


@dataclass(frozen=True, slots=True)
class Close(Generic[Key, Spec]):
    """Close the endpoint that was opened with this specification."""

    key: Key
    spec: Spec


@dataclass(slots=True)
class _Failure(Generic[Spec]):
    """Newest failure of an endpoint since it was wanted with this specification."""

    spec: Spec
    delay_s: float
    due_s: float
    is_waiting: bool = True


class Reconciler(Generic[Key, Spec]):
    """The caller performs `next` and reports it with `done` or `failed`, until `next` is None.

    | state of a key | meaning                  | next state                                                      |
    |----------------|--------------------------|-----------------------------------------------------------------|
    | to open        | wanted, not open         | open (`done`), waiting (`failed`), crowded (there is no room)   |
    | open           | open as it is wanted     | to close (not wanted so), waiting (`ended`), to open (`forget`) |
    | to close       | open, not wanted so      | gone, or to open (`done`)                                       |
    | waiting        | wanted, has failed       | to open (in time, by `retry`, with another specification)       |
    | crowded        | wanted, but over a bound | open (another endpoint was closed)                              |

    A key that is neither wanted nor open is forgotten. Closing precedes opening. Endpoints are opened in the order in
    which they were wanted. A failed endpoint that is tried again keeps its place, so the bounds limit attempts, too.
    """

    def __init__(
        self,
        *,
        limit: float = math.inf,
        group_of: Callable[[Key], Hashable] = lambda _: None,
        group_limit: float = math.inf,
        retry_s: float = math.inf,
        longest_s: float = 0.0,
        replaces: bool = False,
        is_same: Callable[[Spec, Spec], bool] = operator.eq,
        on_crowded: Callable[[Key], None] = lambda _: None,
    ) -> None:
        """Bound what is open, and say what is tried again.

        Args:
            limit: endpoints that are open at once, or tried again.
            group_of: the group of a key, of which at most `group_limit` are open or tried again.
            group_limit: see there.
            retry_s: from the first failure to the next attempt; it doubles with each failure up to `longest_s`.
                Without it a key is tried again by `retry`, or with another specification.
            longest_s: see there; it is at least `retry_s`.
            replaces: an endpoint with another specification is opened over the one before, which is not closed.
            is_same: whether an endpoint of the first specification may stay where the second is wanted.
            on_crowded: called once for a key that is wanted and has no room.
        """
        self.open: dict[Key, Spec] = {}
        self._limit, self._group_of, self._group_limit = limit, group_of, group_limit
        self._retry_s, self._longest_s = retry_s, max(retry_s, longest_s)
        self._replaces, self._is_same, self._on_crowded = replaces, is_same, on_crowded
        self.wanted: dict[Key, Spec] = {}
        self._to_close: dict[Key, None] = {}
        self._to_open: dict[Key, None] = {}
        self._failures: dict[Key, _Failure[Spec]] = {}
        self._due: list[tuple[float, int, Key]] = []  # a heap of when failures are over; some are over already
        self._numbers = 0  # so that keys in the heap are never compared
        self._crowded: dict[Hashable, dict[Key, None]] = {}  # by group
        self._places: set[Key] = set()  # what is open, or is tried again
        self._sizes: dict[Hashable, int] = {}  # its number by group

    # -- what is wanted -----------------------------------------------------------------------------------------------

    def want(self, wanted: Mapping[Key, Spec]) -> None:
        """Want these, and nothing else."""
        before, self.wanted = self.wanted, dict(wanted)
        for key in [key for key in before if key not in wanted]:
            self._judge(key)
        for key, spec in wanted.items():
            is_noted = key in self._to_close or key in self._to_open or key in self._failures
            if is_noted or key not in self.open or not self._is_same(self.open[key], spec):
                self._judge(key)

    def put(self, key: Key, spec: Spec | None) -> None:
        """Want a key with this specification; None: no longer."""
        if spec is None:
            self.wanted.pop(key, None)
        else:
            self.wanted[key] = spec
        self._judge(key)

    def retry(self) -> None:
        """Try everything that has failed again now, and let the next failure be the first."""
        failed = list(self._failures)
        self._failures.clear()
        for key in failed:
            self._judge(key)

    # -- what is done -------------------------------------------------------------------------------------------------

    def next(self, now_s: float) -> Open[Key, Spec] | Close[Key, Spec] | None:
        """Return the next action, the same one until it is reported; None when nothing is to be done."""
        while self._due and self._due[0][0] <= now_s:
            due_s, _, key = heapq.heappop(self._due)
            failure = self._failures.get(key)
            if failure is not None and failure.due_s == due_s:
                failure.is_waiting = False
                self._judge(key)
        if self._to_close:
            key = next(iter(self._to_close))
            return Close(key, self.open[key])
        while self._to_open:
            key = next(iter(self._to_open))
            group = self._group_of(key)
            if key in self._places or self._has_room(group):
                return Open(key, self.wanted[key])
            del self._to_open[key]
            self._crowded.setdefault(group, {})[key] = None
            self._on_crowded(key)
        for group, keys in self._crowded.items():
            if self._has_room(group):
                key = next(iter(keys))
                return Open(key, self.wanted[key])
        return None

    @property
    def due_s(self) -> float:
        """Time at which `next` has a new action if nothing else happens; infinite: never."""
        return self._due[0][0] if self._due else math.inf

    def done(self, action: Open[Key, Spec] | Close[Key, Spec], *, is_settled: bool = True) -> None:
        """The action was performed. `is_settled`: what was opened works, so its next failure is the first."""
        key = action.key
        if isinstance(action, Close):
            del self.open[key]
        else:
            self.open[key] = action.spec
            if is_settled:
                self._failures.pop(key, None)
        self._judge(key)

    def failed(self, action: Open[Key, Spec], now_s: float) -> None:
        """Note that the endpoint could not be opened."""
        self._note_failure(action.key, action.spec, now_s)
        self._judge(action.key)

    def ended(self, key: Key, now_s: float, *, has_failed: bool) -> None:
        """An open endpoint ended by itself. It is opened again as after a failure; an end is as the first of them."""
        if key not in self.open:
            return
        if not has_failed:
            self._failures.pop(key, None)
        self._note_failure(key, self.open.pop(key), now_s)
        self._judge(key)

    def forget(self, keys: Iterable[Key]) -> None:
        """Note that the other side has lost these endpoints: they are opened again at once."""
        for key in [key for key in keys if key in self.open]:
            del self.open[key]
            self._failures.pop(key, None)
            self._judge(key)

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _judge(self, key: Key) -> None:
        """Give a key its state, after anything about it has changed."""
        self._to_close.pop(key, None)
        self._to_open.pop(key, None)
        is_missing = self._is_missing(key)
        self._update_place(key)
        if is_missing:
            if key not in self._crowded.get(self._group_of(key), ()):
                self._to_open[key] = None
            return
        self._leave_crowd(key)
        if key in self.open and not self._may_stay(key):
            self._to_close[key] = None

    def _may_stay(self, key: Key) -> bool:
        """Whether what is open need not be closed."""
        return key in self.wanted and (self._replaces or self._is_same(self.open[key], self.wanted[key]))

    def _is_missing(self, key: Key) -> bool:
        """Whether it is to be opened; a failure of another specification, or of what is not wanted, is forgotten."""
        failure = self._failures.get(key)
        if failure is not None and (key not in self.wanted or not self._is_same(failure.spec, self.wanted[key])):
            del self._failures[key]
            failure = None
        if key not in self.wanted or (failure is not None and failure.is_waiting):
            return False
        return key not in self.open or (self._replaces and not self._is_same(self.open[key], self.wanted[key]))

    def _note_failure(self, key: Key, spec: Spec, now_s: float) -> None:
        before = self._failures.get(key)
        delay_s = self._retry_s if before is None else min(2 * before.delay_s, self._longest_s)
        self._failures[key] = _Failure(spec, delay_s, now_s + delay_s)
        if delay_s == math.inf:
            return
        if len(self._due) > _MIN_HEAP + 2 * len(self._failures):  # most are over: peers come and go quickly
            self._due = [each for each in self._due if each[2] in self._failures]
            heapq.heapify(self._due)
        self._numbers += 1
        heapq.heappush(self._due, (now_s + delay_s, self._numbers, key))

    def _update_place(self, key: Key) -> None:
        """Count what is open, and what is tried again."""
        is_placed = key in self.open or (key in self._failures and self._retry_s < math.inf)
        if is_placed == (key in self._places):
            return
        group = self._group_of(key)
        if is_placed:
            self._places.add(key)
            self._sizes[group] = self._sizes.get(group, 0) + 1
        else:
            self._places.remove(key)
            self._sizes[group] -= 1
            if not self._sizes[group]:
                del self._sizes[group]

    def _leave_crowd(self, key: Key) -> None:
        group = self._group_of(key)
        keys = self._crowded.get(group, {})
        keys.pop(key, None)
        if not keys:
            self._crowded.pop(group, None)

    def _has_room(self, group: Hashable) -> bool:
        return len(self._places) < self._limit and self._sizes.get(group, 0) < self._group_limit
