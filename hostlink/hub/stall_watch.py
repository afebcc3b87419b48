"""StallWatch: whether this process ran without a pause. What is read right after one has waited for an unknown time."""

import time
from collections.abc import Callable

import structlog

from hostlink.host_pauses import HostPauses
from hostlink.robot.admission import LEASE_S

log = structlog.get_logger()

BEAT_S = 0.1  # how often it must be called
STALL_S = LEASE_S  # a command that waited for longer means nothing
GRACE_S = LEASE_S / 2  # what waited through a pause is read by then


def slept_s() -> float:
    """For how long this computer has slept since its start: the event loop's clock stands still meanwhile."""
    boot_clock = getattr(time, "CLOCK_BOOTTIME", None)  # Linux alone has it
    return 0.0 if boot_clock is None else time.clock_gettime(boot_clock) - time.monotonic()


class StallWatch:
    """The process was stopped (SIGSTOP, a debugger, a virtual machine, a computer asleep), or its loop was blocked."""

    def __init__(self, slept_s: Callable[[], float] = slept_s) -> None:
        """`slept_s`: for how long the computer has slept so far."""
        self._slept_s = slept_s
        self._slept_before_s = slept_s()
        self._beat_s: float | None = None  # None: there was no beat yet
        self._due_s = float("inf")  # when the next beat comes, if the loop is in time
        self._late_s = 0.0  # of the newest beat
        self._paused_s = 0.0
        self._void_until_s = float("-inf")
        self._pause_began_s: float | None = None  # of one that nobody has popped
        self._pauses = HostPauses()

    def beat(self, now_s: float) -> None:
        """Note that the process runs; the next beat is due in BEAT_S, unless `expect` says otherwise."""
        slept_s = self._notice(now_s)
        self._late_s = max(0.0, now_s - self._due_s + slept_s)
        self._beat_s, self._due_s, self._slept_before_s = now_s, now_s + BEAT_S, self._slept_s()

    def expect(self, due_s: float) -> None:
        """The next beat is due then."""
        self._due_s = due_s

    def late_s(self, now_s: float) -> float:
        """How late the event loop is: what is read now may have waited for so long.

        A turn of the loop that takes long is noticed by the beat that it delays, or by the one that it has delayed.
        After a pause what waited is not all read at once.
        """
        return max(0.0, self._late_s, now_s - self._due_s, self._paused_s if now_s < self._void_until_s else 0.0)

    def _notice(self, now_s: float) -> float:
        """Note a pause that has ended since the last beat; return for how long the computer has slept since."""
        all_slept_s = self._slept_s()
        slept_s = all_slept_s - self._slept_before_s
        if self._beat_s is None:
            return slept_s
        gap_s = now_s - self._beat_s + slept_s
        if gap_s > STALL_S:
            self._paused_s, self._void_until_s, self._pause_began_s = gap_s, now_s + GRACE_S, self._beat_s
            self._pauses.add(self._beat_s, now_s, settled_at_s=self._void_until_s)
            self._beat_s, self._slept_before_s = now_s, all_slept_s
            log.warning("daemon.stalled", seconds=round(self._paused_s, 3))
        return slept_s

    def pauses(self, now_s: float) -> HostPauses:
        """The pauses until now: also one that has just ended, before the next beat."""
        self._notice(now_s)
        return self._pauses

    def pop_pause(self, now_s: float) -> float | None:
        """Return when a pause began that has ended since the last call; None: there was none."""
        self._notice(now_s)
        began_s, self._pause_began_s = self._pause_began_s, None
        return began_s
