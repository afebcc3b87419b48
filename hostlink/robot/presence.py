"""Presence: how long a device has been silent, and whether that means anything: some send often, some seldom."""

from collections import deque
from statistics import median

SURE_S = 3.0  # docs/protocol.md#time: whatever lives requests the time every 2.5 s
SOONEST_S = 0.5  # longer than the project's passthrough waits before it dials again: 0.2 s
USUAL_GAPS = 5  # a radio makes one or two late, not five
_KEPT, _ENOUGH = 16, 8  # gaps; their median stands a few that are long


class Presence:
    """Of one link. Times are monotonic, in seconds."""

    __slots__ = ("_gaps_s", "received_at_s")

    def __init__(self, now_s: float) -> None:
        self.received_at_s = now_s
        self._gaps_s: deque[float] = deque(maxlen=_KEPT)

    def note_read(self, now_s: float) -> None:
        """The device sent something."""
        if now_s > self.received_at_s:
            self._gaps_s.append(now_s - self.received_at_s)
            self.received_at_s = now_s

    def is_surely_gone(self, now_s: float) -> bool:
        """Whether no device that lives is silent for so long."""
        return now_s - self.received_at_s >= SURE_S

    def is_probably_gone(self, now_s: float) -> bool:
        """Whether this one, as it used to send, would have sent by now."""
        if len(self._gaps_s) < _ENOUGH:
            return False
        return now_s - self.received_at_s >= max(SOONEST_S, USUAL_GAPS * median(self._gaps_s))
