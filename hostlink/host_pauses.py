"""HostPauses: when this process did not run, so that no device is blamed for it. Pure: times come in."""

from collections import deque

MAX_KEPT = 64  # pauses that are remembered: older ones explain nothing now
MAX_UNSETTLED_S = 1.0  # of one pause after another: what is due cannot wait for longer
RECOVERY_S = 2.0  # what waited is read by then on a busy machine, and a device's next bytes are there


class HostPauses:
    """The last times in which the process was stopped, the computer slept, or the event loop was blocked.

    What a device sent meanwhile waits, and is read all at once afterwards: its bytes are as good as ever, but the time
    at which they are read says nothing about the device. All times are of the event loop's clock.
    """

    def __init__(self) -> None:
        self._settled_at_s = float("-inf")  # what waited during the last pause has been read from then on
        self._unsettled_since_s = float("-inf")  # the end of the first of those pauses that followed closely
        self._pauses: deque[tuple[float, float]] = deque(maxlen=MAX_KEPT)

    def add(self, began_s: float, ended_s: float, *, settled_at_s: float) -> None:
        """The process runs again; `settled_at_s`: when what waits now has been read."""
        self._pauses.append((began_s, ended_s))
        if began_s >= self._settled_at_s:
            self._unsettled_since_s = ended_s
        self._settled_at_s = settled_at_s

    def is_settled(self, now_s: float) -> bool:
        """Whether what waited has been read, so that what is due may be done."""
        return now_s >= min(self._settled_at_s, self._unsettled_since_s + MAX_UNSETTLED_S)

    def was_paused(self, since_s: float) -> bool:
        """Whether a pause ended after `since_s`."""
        return bool(self._pauses) and self._pauses[-1][1] > since_s

    def has_recovered(self, now_s: float) -> bool:
        """Whether what is seen of a device now is the device's doing."""
        return not self.was_paused(now_s - RECOVERY_S)

    def awake_s(self, since_s: float, now_s: float) -> float:
        """For how long the process has run since then."""
        paused_s = sum(ended_s - max(began_s, since_s) for began_s, ended_s in self._pauses if ended_s > since_s)
        return now_s - since_s - paused_s


def never_paused(_now_s: float) -> HostPauses:
    """The pauses of a process that is not watched: none is known."""
    return HostPauses()
