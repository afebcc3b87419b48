"""StallWatch: detector of pauses of this process. Bytes that are read right after one have waited an unknown time."""

import time
from collections.abc import Callable
from functools import partial

import structlog

from hostlink.core.robot.admission import LEASE_S
from hostlink.core.runtime.host_pauses import HostPauses

log = structlog.get_logger()

BEAT_S = 0.1  # interval of the beats
STALL_S = LEASE_S  # a command that waited longer is void
GRACE_S = LEASE_S / 2  # bytes that waited through a pause are read by then


_BOOT_CLOCK = getattr(time, "CLOCK_BOOTTIME", None)  # only on Linux
_boot_s = partial(time.clock_gettime, 0 if _BOOT_CLOCK is None else _BOOT_CLOCK)
MAX_READINGS = 5  # of both clocks, on a busy machine
APART_S = 0.001  # longest time between the two clocks' readings


def slept_s(boot_s: Callable[[], float] = _boot_s, running_s: Callable[[], float] = time.monotonic) -> float:
    """Return for how long this computer has slept since its start. The event loop's clock does not count that time.

    Both clocks are read again if the process lost the processor between them: that time would appear as sleep.
    """
    if _BOOT_CLOCK is None:
        return 0.0
    found_s = 0.0
    for _ in range(MAX_READINGS):
        began_s = running_s()
        found_s = boot_s() - began_s
        if running_s() < began_s + APART_S:
            break
    return found_s


class StallWatch:
    """Detector of pauses: SIGSTOP, a debugger, a paused virtual machine, a sleeping computer, or a blocked loop."""

    def __init__(self, slept_s: Callable[[], float]) -> None:
        """`slept_s` returns for how long the computer has slept so far, which the times of the methods leave out."""
        self._slept_s = slept_s
        self._slept_before_s = slept_s()
        self._beat_s: float | None = None  # None before the first beat
        self._due_s = float("inf")  # time of the next beat, if the loop is in time
        self._late_s = 0.0  # delay of the newest beat
        self._paused_s = 0.0
        self._void_until_s = float("-inf")
        self._pause_began_s: float | None = None  # start of a pause that was not popped yet
        self.noticed = HostPauses()  # pauses so far, without reading the clocks again

    def beat(self, now_s: float) -> None:
        """Note that the process runs. The next beat is due in BEAT_S, or at the time of `expect`."""
        slept_s = self._notice(now_s)
        self._late_s = max(0.0, now_s - self._due_s + slept_s)
        self._beat_s, self._due_s, self._slept_before_s = now_s, now_s + BEAT_S, self._slept_s()

    def expect(self, due_s: float) -> None:
        """Set the time of the next beat."""
        self._due_s = due_s

    def late_s(self, now_s: float) -> float:
        """Return the delay of the event loop: bytes that are read now may have waited that long.

        A long turn of the loop is noticed by the beat that it delays, or by the one that it has delayed. After a pause,
        waiting bytes are not all read at once.
        """
        return max(0.0, self._late_s, now_s - self._due_s, self._paused_s if now_s < self._void_until_s else 0.0)

    def _notice(self, now_s: float) -> float:
        """Note a pause that ended since the last beat. Return for how long the computer slept since then."""
        all_slept_s = self._slept_s()
        slept_s = all_slept_s - self._slept_before_s
        if self._beat_s is None:
            return slept_s
        gap_s = now_s - self._beat_s + slept_s
        if gap_s > STALL_S:
            self._paused_s, self._void_until_s, self._pause_began_s = gap_s, now_s + GRACE_S, self._beat_s
            self.noticed.add(self._beat_s, now_s, settled_at_s=self._void_until_s)
            self._beat_s, self._slept_before_s = now_s, all_slept_s
            log.warning("daemon.stalled", seconds=round(self._paused_s, 3))
        return slept_s

    def pauses(self, now_s: float) -> HostPauses:
        """Return the pauses until now, including one that has just ended."""
        self._notice(now_s)
        return self.noticed

    def pop_pause(self, now_s: float) -> float | None:
        """Return the start of a pause that ended since the last call; None if there was none."""
        if self._beat_s is None or now_s - self._beat_s + self._slept_s() - self._slept_before_s > STALL_S:
            self._notice(now_s)
        began_s, self._pause_began_s = self._pause_began_s, None
        return began_s
