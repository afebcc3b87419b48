"""FairShare: scheduling of the work of links and clients in each turn of the event loop."""

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Protocol

from hostlink.core.runtime.arrival import SETTLE_S, Arrival
from hostlink.core.transport.base import READ_BYTES

TURN_S = 0.0002  # for all of them together, so that a command for a robot is handled within a few turns of the loop
# The same with what is urgent, which waits for no turn before that; or so many pieces of work, because each takes
# longer than TURN_S on a busy machine.
URGENT_TURN_S, URGENT_PIECES = 0.001, 5
# Of four parts of the time belong to calm readers while they wait: one piece of a flood can cost ten turns.
CALM_PARTS = 3
MAX_DEFERRALS = 3  # afterwards one is admitted although the turn is used up, so that no one starves
# Callback that admits the waiting task, and its expected cost in seconds.
_Queue = deque[tuple[Callable[[], None], float]]


class FairShare:
    """Scheduler of links and clients. Readers wait here when a turn of the loop is used up.

    A reader is calm while no more bytes wait than one read takes. Calm readers go first, in order of arrival, so that a
    robot's own requests do not wait behind a flood. Flooding readers take turns in the remaining time: all of it, or a
    quarter while calm readers wait.
    """

    def __init__(self, came_s: Callable[[float], float] = lambda now_s: now_s) -> None:
        """`came_s` returns the earliest arrival of bytes that the loop reads at a time: the loop may be late."""
        self.waits = 0  # number of waits so far
        self.came_s = came_s
        self._spent_s = 0.0  # used time of this turn
        self._pieces = 0  # of work in this turn
        self._owed_s = 0.0  # time for calm readers, if they wait, before a flood has its next turn
        self._is_turn_due = False
        self._calm: _Queue = deque()
        self._flooding: _Queue = deque()

    def is_free(self, *, is_flooding: bool = False) -> bool:
        """Whether `wait` would return at once: the turn is not used up, and no other reader waits before this one."""
        return self._spent_s < TURN_S and not self._calm and not (is_flooding and self._flooding)

    @property
    def is_free_for_urgent(self) -> bool:
        """Whether a velocity may be executed at once, also before readers that wait."""
        return self._spent_s < URGENT_TURN_S or self._pieces < URGENT_PIECES

    async def wait(self, expected_s: float, *, is_flooding: bool = False) -> None:
        """Wait until the caller may compute for about `expected_s`. Return at once while the turn is not used up."""
        queue = self._flooding if is_flooding else self._calm
        is_admitted = not self._calm and not (is_flooding and self._flooding)
        deferrals = 0
        while not is_admitted or (self._spent_s >= TURN_S and deferrals < MAX_DEFERRALS):
            deferrals += is_admitted  # the readers before it have cost more than expected
            turn = asyncio.get_running_loop().create_future()
            put = queue.appendleft if is_admitted else queue.append
            put((partial(_admit, turn), expected_s))
            self.waits += 1
            self._expect_turn()
            await turn
            is_admitted = True

    def call(self, work: Callable[[], None], expected_s: float, *, is_flooding: bool = False) -> None:
        """Schedule `work` for its turn. It must not raise, and must call `spend` with its cost."""
        queue = self._flooding if is_flooding else self._calm
        queue.append((work, expected_s))
        self.waits += 1
        self._expect_turn()

    def spend(self, seconds: float) -> None:
        """Subtract computing time from the turn. A turn ends only when it is used up."""
        self._spent_s += seconds
        self._pieces += 1
        if self._spent_s >= TURN_S and not self._is_turn_due:
            self._expect_turn()

    def _expect_turn(self) -> None:
        if not self._is_turn_due:
            self._is_turn_due = True
            asyncio.get_running_loop().call_soon(self._begin_turn)

    def _begin_turn(self) -> None:
        """Start a turn: admit as many as are expected to fill it. Calm readers go first while they have time left."""
        self._is_turn_due = False
        self._spent_s, self._pieces = 0.0, 0
        if not (self._calm or self._flooding):
            return
        left_s = TURN_S
        if self._owed_s > 0 or not self._flooding:
            left_s = self._admit(self._calm, left_s)
            self._owed_s -= TURN_S - left_s
        if self._flooding and left_s > 0:
            self._owed_s = CALM_PARTS * (left_s - self._admit(self._flooding, left_s))
        if self._calm or self._flooding:
            self._expect_turn()

    def _admit(self, queue: _Queue, left_s: float) -> float:
        while queue and left_s > 0:
            let_in, expected_s = queue.popleft()
            spent_s = self._spent_s
            let_in()
            left_s -= max(expected_s, self._spent_s - spent_s)
        return left_s


def _admit(turn: "asyncio.Future[None]") -> None:
    if not turn.done():  # otherwise the waiting task has ended
        turn.set_result(None)


class Turns:
    """Share of one link or client in a FairShare, with the cost of its last piece of work."""

    __slots__ = ("_cost_s", "share")

    def __init__(self, share: FairShare) -> None:
        self.share = share
        self._cost_s = TURN_S  # assumed cost of the first piece

    async def run(self, work: Callable[[], None], *, is_flooding: bool) -> None:
        """Run a piece of work in its turn."""
        if not self.share.is_free(is_flooding=is_flooding):
            await self.share.wait(self._cost_s, is_flooding=is_flooding)
        began_s = asyncio.get_running_loop().time()
        try:
            work()
        finally:
            self.end(began_s)

    def call(self, work: Callable[[], None], *, is_flooding: bool) -> None:
        """Schedule a piece of work for its turn. It must not raise."""
        self.share.call(work, self._cost_s, is_flooding=is_flooding)

    def reader(self, source: "ReadSource", read: Callable[[], None], on_end: Callable[[], None]) -> "TurnReader":
        """Create a reader of `source` that reads in these turns."""
        return TurnReader(self, source, read, on_end)

    def end(self, began_s: float) -> float:
        """End the piece of work and charge its cost. Return the time."""
        now_s = asyncio.get_running_loop().time()
        self._cost_s = now_s - began_s
        self.share.spend(self._cost_s)
        return now_s

    def leave(self, arrival: Arrival, now_s: float, *, is_more: bool) -> None:
        """Note that all bytes of a source were read, and settle its arrival when the loop has read for a while."""
        number = arrival.leave(now_s, is_more=is_more)
        if number:
            loop = asyncio.get_running_loop()
            # What waits when the timer is due is read within the next turn, also in uvloop.
            loop.call_later(SETTLE_S, loop.call_soon, loop.call_soon, arrival.settle, number)

    async def wait(self, cost_s: float, *, is_flooding: bool = False) -> None:
        """Wait for a turn for work of about `cost_s` that is only started here."""
        await self.share.wait(cost_s, is_flooding=is_flooding)
        self.share.spend(cost_s)


class ReadSource(Protocol):
    """Received bytes of a connection: a Transport, or a BufferedConnection of ROS 1."""

    @property
    def unread_bytes(self) -> int: ...

    @property
    def is_ended(self) -> bool: ...

    @property
    def is_behind(self) -> bool: ...


class TurnReader:
    """Reads a connection piece by piece: at once while it is its turn, otherwise later.

    `read` reads one piece, ends its turn and must not raise. `on_end` is called when everything was read and the source
    has ended. `rest` is the part of a piece that `read` has left for its next call. `came_s` is the earliest arrival of
    the piece that is read.
    """

    __slots__ = (
        "_arrival", "_is_due", "_is_flooding", "_is_stopped", "_now_s", "_on_end", "_read", "_source", "_turns",
        "came_s", "rest",
    )  # fmt: skip

    def __init__(self, turns: Turns, source: ReadSource, read: Callable[[], None], on_end: Callable[[], None]) -> None:
        self._turns, self._source = turns, source
        self._read, self._on_end = read, on_end
        self._is_due = self._is_flooding = self._is_stopped = False
        self._now_s = asyncio.get_running_loop().time
        self._arrival, self.came_s = Arrival(), self._now_s()
        self.rest = b""

    def stop(self) -> None:
        """Stop reading for good."""
        self._is_stopped = True
        self._read = self._on_end = _read_nothing  # otherwise the reader and its owner form a reference cycle
        self._source = _NOTHING

    def receive(self) -> None:
        """Handle new bytes or the end of the source."""
        if self._is_due or self._is_stopped:
            return
        source, share = self._source, self._turns.share
        unread_bytes = len(self.rest) + source.unread_bytes
        if unread_bytes:
            self.came_s = self._arrival.arrive(share.came_s(self._now_s()))
        while unread_bytes and not self._is_stopped:
            if unread_bytes >= READ_BYTES:
                self._is_flooding = True
            if not share.is_free(is_flooding=self._is_flooding):
                self._is_due = True
                self._turns.call(self._read_due, is_flooding=self._is_flooding)
                return
            self._read()
            unread_bytes = len(self.rest) + source.unread_bytes
        self._is_flooding = False
        self._turns.leave(self._arrival, self._now_s(), is_more=source.is_behind)
        if source.is_ended and not self._is_stopped:
            self._on_end()

    def _read_due(self) -> None:
        """Read one piece in its turn, then continue."""
        self._is_due = False
        if (self.rest or self._source.unread_bytes) and not self._is_stopped:
            self._read()
        self.receive()


class _Nothing:
    """ReadSource of a TurnReader after `stop`."""

    unread_bytes = 0
    is_ended = True
    is_behind = False


_NOTHING: ReadSource = _Nothing()


def _read_nothing() -> None:
    """Do nothing. Replaces the callbacks of a TurnReader after `stop`."""
