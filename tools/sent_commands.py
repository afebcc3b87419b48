"""SentCommands: which commands of a program have reached the robot, how late, and what became of the others.

The newest command wins: two that come in one turn of the daemon's loop are one, the newer. Bytes to a robot keep their
order, so a command is superseded once one that was sent after it has come; what is left at the end is lost.
"""

from collections import deque
from typing import NamedTuple


class _Waiting(NamedTuple):
    number: int
    at_s: float


class SentCommands:
    """Commands of one driver by number. Number 0 is the stop, which is sent repeatedly."""

    def __init__(self) -> None:
        self.latencies_s: list[float] = []
        self.stops_s: list[float] = []
        self.superseded = 0  # commands, and stops
        self._waiting: deque[_Waiting] = deque()

    def send(self, number: int, at_s: float) -> None:
        """Note that a command is sent now."""
        self._waiting.append(_Waiting(number, at_s))

    def receive(self, number: int, at_s: float) -> None:
        """The robot has it. What it has already is sent again by the daemon, so that its watchdog is content."""
        if not any(number == waiting.number for waiting in self._waiting):
            return
        while (first := self._waiting.popleft()).number != number:
            self.superseded += 1
        (self.latencies_s if number else self.stops_s).append(at_s - first.at_s)

    def is_told(self, commands: int, stops: int) -> bool:
        """Whether at least so many commands and stops have come."""
        return len(self.latencies_s) >= commands and len(self.stops_s) >= stops

    @property
    def lost(self) -> int:
        """Number of commands that did not arrive, and were not followed by a later one that did."""
        return len(self._waiting)
