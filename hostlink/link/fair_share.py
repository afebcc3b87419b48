"""FairShare: how much of each turn of the event loop goes into what links and clients send, and who is next."""

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Protocol

from hostlink.transport.base import READ_BYTES

TURN_S = 0.0002  # of all together; what drives a robot comes in between, within a few turns of the loop
CALM_PARTS = 3  # of four of the time is theirs while they wait: one piece of a flood can cost ten turns
MAX_DEFERRALS = 3  # then one is let in though the turn is used up: nobody waits without end
_Queue = deque[tuple[Callable[[], None], float]]  # what lets in, and what that is expected to cost


class FairShare:
    """Links and clients that read wait here when a turn of the loop is used up.

    Those of which no more waits than one read takes go first, in the order in which they came: a robot's own questions
    do not wait behind a flood. Those that flood take turns in what is left: all of it, or a quarter of the time.
    """

    def __init__(self, turn_s: float = TURN_S) -> None:
        self.waits = 0  # how often somebody had to wait
        self._turn_s = turn_s
        self._spent_s = 0.0  # in this turn
        self._owed_s = 0.0  # that calm ones may compute, if they wait, before a flood has its next turn
        self._is_turn_due = False
        self._calm: _Queue = deque()
        self._flooding: _Queue = deque()

    def is_free(self, *, is_flooding: bool = False) -> bool:
        """Whether `wait` would return at once: something of the turn is left, and nobody waits before the caller."""
        return not self._is_used_up and self._is_first(is_flooding=is_flooding)

    async def wait(self, expected_s: float, *, is_flooding: bool = False) -> None:
        """Returns when the caller may compute for about `expected_s`: at once while something of the turn is left."""
        queue = self._flooding if is_flooding else self._calm
        is_admitted = self._is_first(is_flooding=is_flooding)
        deferrals = 0
        while not is_admitted or (self._is_used_up and deferrals < MAX_DEFERRALS):
            deferrals += is_admitted  # those before have cost more than was expected
            turn = asyncio.get_running_loop().create_future()
            put = queue.appendleft if is_admitted else queue.append
            put((partial(_admit, turn), expected_s))
            self.waits += 1
            self._expect_turn()
            await turn
            is_admitted = True

    def call(self, work: Callable[[], None], expected_s: float, *, is_flooding: bool = False) -> None:
        """Call `work`, which raises nothing, when it is its turn; it spends what it has computed."""
        queue = self._flooding if is_flooding else self._calm
        queue.append((work, expected_s))
        self.waits += 1
        self._expect_turn()

    def spend(self, seconds: float) -> None:
        """The caller has computed for this long. What is left of a turn stays until it is used up."""
        self._spent_s += seconds
        if self._is_used_up:
            self._expect_turn()

    @property
    def _is_used_up(self) -> bool:
        return self._spent_s >= self._turn_s

    def _is_first(self, *, is_flooding: bool) -> bool:
        return not self._calm and not (is_flooding and self._flooding)

    def _expect_turn(self) -> None:
        if not self._is_turn_due:
            self._is_turn_due = True
            asyncio.get_running_loop().call_soon(self._begin_turn)

    def _begin_turn(self) -> None:
        """Let in as many as are expected to fill the turn: calm ones first, if they are owed time or nobody floods."""
        self._is_turn_due = False
        self._spent_s = 0.0
        left_s = self._turn_s
        if self._owed_s > 0 or not self._flooding:
            left_s = self._admit(self._calm, left_s)
            self._owed_s -= self._turn_s - left_s
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
    if not turn.done():  # else whoever waited has ended
        turn.set_result(None)


class Turns:
    """The part of one link or one client in a FairShare; it remembers what its work costs."""

    __slots__ = ("_cost_s", "_share")

    def __init__(self, share: FairShare) -> None:
        self._share = share
        self._cost_s = TURN_S  # of the first piece nobody knows

    async def run(self, work: Callable[[], None], *, is_flooding: bool) -> None:
        """Do a piece of work when it is its turn."""
        began_s = await self.begin(is_flooding=is_flooding)
        try:
            work()
        finally:
            self.end(began_s)

    def is_free(self, *, is_flooding: bool) -> bool:
        """Whether a piece of work may be done without waiting."""
        return self._share.is_free(is_flooding=is_flooding)

    def call(self, work: Callable[[], None], *, is_flooding: bool) -> None:
        """Call a piece of work, which raises nothing, when it is its turn."""
        self._share.call(work, self._cost_s, is_flooding=is_flooding)

    def reader(self, source: "Source", read: Callable[[], None], on_end: Callable[[], None]) -> "TurnReader":
        """What reads `source` in these turns."""
        return TurnReader(self, source, read, on_end)

    async def begin(self, *, is_flooding: bool) -> float:
        """Wait for the turn of a piece of work; returns when it begins."""
        await self._share.wait(self._cost_s, is_flooding=is_flooding)
        return asyncio.get_running_loop().time()

    def end(self, began_s: float) -> float:
        """The piece of work is done; returns the time."""
        now_s = asyncio.get_running_loop().time()
        self._cost_s = now_s - began_s
        self._share.spend(self._cost_s)
        return now_s

    async def wait(self, cost_s: float, *, is_flooding: bool = False) -> None:
        """Returns when it is its turn, for work of about this cost that can only be begun here."""
        await self._share.wait(cost_s, is_flooding=is_flooding)
        self._share.spend(cost_s)


class Source(Protocol):
    """What a connection has received: a Transport, or a Connection itself."""

    @property
    def unread_bytes(self) -> int: ...

    @property
    def is_ended(self) -> bool: ...


class TurnReader:
    """Reads a connection piece by piece: at once while it is its turn, else later.

    `read` reads one piece, ends its turn, and raises nothing; `on_end` is called when all is read and nothing more
    will come.
    """

    __slots__ = ("_is_due", "_is_flooding", "_is_stopped", "_on_end", "_read", "_source", "_turns")

    def __init__(self, turns: Turns, source: Source, read: Callable[[], None], on_end: Callable[[], None]) -> None:
        self._turns, self._source = turns, source
        self._read, self._on_end = read, on_end
        self._is_due = self._is_flooding = self._is_stopped = False

    def stop(self) -> None:
        """Nothing is read any more."""
        self._is_stopped = True
        self._read = self._on_end = _read_nothing  # else it and its owner keep each other until a collection
        self._source = _NOTHING

    def receive(self) -> None:
        """Bytes have come, or the end has."""
        if self._is_due or self._is_stopped:
            return
        source = self._source
        while (unread_bytes := source.unread_bytes) and not self._is_stopped:
            if unread_bytes >= READ_BYTES:
                self._is_flooding = True
            if not self._turns.is_free(is_flooding=self._is_flooding):
                self._is_due = True
                self._turns.call(self._read_due, is_flooding=self._is_flooding)
                return
            self._read()
        self._is_flooding = False
        if source.is_ended and not self._is_stopped:
            self._on_end()

    def _read_due(self) -> None:
        """It is its turn."""
        self._is_due = False
        if self._source.unread_bytes and not self._is_stopped:
            self._read()
        self.receive()


class _Nothing:
    """The source of a TurnReader after `stop`."""

    unread_bytes = 0
    is_ended = True


_NOTHING: Source = _Nothing()


def _read_nothing() -> None:
    """What a TurnReader calls after `stop`."""
