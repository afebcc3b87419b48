"""Noise: cost of the machine and of the harness itself, which is not the daemon's fault. Pure."""

import math
from collections import deque

from hostlink.core.hub.stall_watch import BEAT_S, GRACE_S, STALL_S

KEPT = 4000  # samples: ten minutes and more


class Noise:
    """Lateness of the honest process's own loop, how long the daemon waited for a core, and when it was stopped."""

    def __init__(self, *, stretch_most: float) -> None:
        self._stretch_most = stretch_most
        self._lags: deque[tuple[float, float]] = deque(maxlen=KEPT)  # (when, by how much)
        self._turns: deque[tuple[float, float, float]] = deque(maxlen=KEPT)  # (when, ran, waited) of the daemon, sums
        self._pauses: list[tuple[float, float]] = []  # in which it was stopped by a signal
        self._absences: list[tuple[float, float]] = []  # in which it was being restarted

    def add_lag(self, at_s: float, lag_s: float) -> None:
        """The honest process woke so late."""
        self._lags.append((at_s, lag_s))

    def add_turn(self, at_s: float, ran_s: float, waited_s: float) -> None:
        """Note for how long the daemon has run, and waited for a core, since its start."""
        self._turns.append((at_s, ran_s, waited_s))

    def pause(self, began_s: float, ended_s: float = math.inf) -> None:
        """The daemon is stopped by a signal; again with its end once that is known."""
        _note(self._pauses, began_s, ended_s)

    def absence(self, began_s: float, ended_s: float = math.inf) -> None:
        """Note that the daemon is absent; call again with the end once it is known."""
        _note(self._absences, began_s, ended_s)

    def paused_s(self, begin_s: float, end_s: float) -> float:
        """Return for how long the daemon was stopped by signals in an interval."""
        return _overlap(self._pauses, begin_s, end_s)

    def refusing_s(self, begin_s: float, end_s: float) -> float:
        """Return for how long the daemon was stopped by signals or refused velocities after such a stop.

        After a pause of a lease it refuses what it reads within GRACE_S, which may have waited through the pause.
        """
        total_s, reached_s = 0.0, begin_s
        for began_s, ended_s in sorted(self._pauses):
            is_long = ended_s - began_s > STALL_S - BEAT_S  # the daemon counts from the beat before
            until_s = min(ended_s + GRACE_S * is_long, end_s)
            total_s += max(0.0, until_s - max(began_s, reached_s))
            reached_s = max(reached_s, until_s)
        return total_s

    def absent_s(self, begin_s: float, end_s: float) -> float:
        """Return for how long the daemon was absent in an interval."""
        return _overlap(self._absences, begin_s, end_s)

    def lag_s(self, begin_s: float, end_s: float) -> float:
        """The longest lateness in a time."""
        return max((lag_s for at_s, lag_s in self._lags if begin_s <= at_s <= end_s), default=0.0)

    def waited_s(self, begin_s: float, end_s: float) -> float:
        """Return for how long the daemon waited for a core in an interval."""
        return self._span(begin_s, end_s)[1]

    def stretch(self, begin_s: float, end_s: float) -> float:
        """Return the daemon's time in proportion to the time with a core of its own; at least 1."""
        ran_s, waited_s = self._span(begin_s, end_s)
        return min(self._stretch_most, 1.0 + waited_s / ran_s) if ran_s > 0 else 1.0

    def _span(self, begin_s: float, end_s: float) -> tuple[float, float]:
        """(ran, waited) between the samples around a time."""
        before = [turn for turn in self._turns if turn[0] <= begin_s][-1:]
        inside = [turn for turn in self._turns if begin_s < turn[0] <= end_s]
        after = [turn for turn in self._turns if turn[0] > end_s][:1]
        turns = before + inside + after
        if len(turns) < 2:
            return 0.0, 0.0
        return turns[-1][1] - turns[0][1], turns[-1][2] - turns[0][2]


def _note(spans: list[tuple[float, float]], began_s: float, ended_s: float) -> None:
    if spans and spans[-1][0] == began_s:
        spans.pop()
    spans.append((began_s, ended_s))


def _overlap(spans: list[tuple[float, float]], begin_s: float, end_s: float) -> float:
    return sum(max(0.0, min(ended_s, end_s) - max(began_s, begin_s)) for began_s, ended_s in spans)
