"""FairShare: how much of each turn of the event loop goes into reading devices, and which link is next."""

import asyncio
from collections import deque

TURN_S = 0.001  # of all links together; what drives a robot comes in between, within a few turns


class FairShare:
    """Links that read wait here when a turn of the loop is used up; first come, first served.

    A flooding device so has no more of the loop than any other, and all together have TURN_S of each turn.
    """

    def __init__(self, turn_s: float = TURN_S) -> None:
        self.waits = 0  # how often somebody had to wait
        self._turn_s = turn_s
        self._spent_s = 0.0  # in this turn
        self._is_turn_due = False
        self._waiting: deque[tuple[asyncio.Future[None], float]] = deque()

    async def wait(self, expected_s: float) -> None:
        """Returns when the caller may compute for about `expected_s`: at once while something of the turn is left."""
        is_let_in = not self._waiting
        while not is_let_in or self._spent_s >= self._turn_s:  # those before may cost more than was expected
            turn = asyncio.get_running_loop().create_future()
            queue = self._waiting.appendleft if is_let_in else self._waiting.append
            queue((turn, expected_s))
            self.waits += 1
            self._expect_turn()
            await turn
            is_let_in = True

    def spend(self, seconds: float) -> None:
        """The caller has computed for so long."""
        self._spent_s += seconds
        self._expect_turn()

    def _expect_turn(self) -> None:
        if not self._is_turn_due:
            self._is_turn_due = True
            asyncio.get_running_loop().call_soon(self._begin_turn)

    def _begin_turn(self) -> None:
        """Let in as many as are expected to fill the turn, at least one."""
        self._is_turn_due = False
        self._spent_s = expected_s = 0.0
        while self._waiting and expected_s < self._turn_s:
            turn, cost_s = self._waiting.popleft()
            if not turn.done():  # else its link has ended
                turn.set_result(None)
                expected_s += cost_s
        if self._waiting:
            self._expect_turn()
