"""HostPauses: times when this process did not run, so that no device is blamed for them. Pure; times are arguments.

Measured need: without it, a pause of the host closed links, and doctor reported it as faults of the devices. No library
knows when an event loop read late.
"""

from collections import deque

MAX_KEPT = 64  # older pauses explain nothing now
MAX_UNSETTLED_S = 1.0  # after consecutive pauses: due work cannot be postponed for longer
RECOVERY_S = 2.0  # time in which waiting bytes are read on a busy machine, and new ones arrive


class HostPauses:
    """Recent times when the process was stopped, the computer slept, or the event loop was blocked.

    Bytes that a device sent meanwhile are read all at once afterwards. They are valid, but the time at which they are
    read shows nothing about the device. All times are of the event loop's clock.
    """

    def __init__(self) -> None:
        self._settled_at_s = float("-inf")  # the bytes that waited during the last pause were read by then
        self._unsettled_since_s = float("-inf")  # end of the first of several consecutive pauses
        self._pauses: deque[tuple[float, float]] = deque(maxlen=MAX_KEPT)

    def add(self, began_s: float, ended_s: float, *, settled_at_s: float) -> None:
        """Note a pause. `settled_at_s` is the time by which the waiting bytes are read."""
        self._pauses.append((began_s, ended_s))
        if began_s >= self._settled_at_s:
            self._unsettled_since_s = ended_s
        self._settled_at_s = settled_at_s

    def is_settled(self, now_s: float) -> bool:
        """Whether waiting bytes were read, so that due work may be done."""
        return now_s >= min(self._settled_at_s, self._unsettled_since_s + MAX_UNSETTLED_S)

    def was_paused(self, since_s: float) -> bool:
        """Whether a pause ended after `since_s`."""
        return bool(self._pauses) and self._pauses[-1][1] > since_s

    def has_recovered(self, now_s: float) -> bool:
        """Whether current observations of a device are unaffected by pauses."""
        return not self.was_paused(now_s - RECOVERY_S)

    def paused_s(self, since_s: float) -> float:
        """Sum of the pauses after `since_s`."""
        return sum(ended_s - max(began_s, since_s) for began_s, ended_s in self._pauses if ended_s > since_s)

    def awake_s(self, since_s: float, now_s: float) -> float:
        """Time from `since_s` to `now_s` without the pauses."""
        return now_s - since_s - self.paused_s(since_s)


def never_paused(_now_s: float) -> HostPauses:
    """Return no pauses, for a process that is not watched."""
    return HostPauses()
