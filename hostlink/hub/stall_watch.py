"""StallWatch: whether this process ran without a pause. What comes right after one has waited for an unknown time."""

import structlog

from hostlink.errors import BadRequest
from hostlink.robot.velocity_gate import LEASE_S

log = structlog.get_logger()

BEAT_S = 0.1  # how often it must be called while something can be driven
STALL_S = LEASE_S  # a command that waited for longer holds no more
GRACE_S = LEASE_S / 2  # what waited meanwhile is read by then; whoever still drives commands again


class StallWatch:
    """The process was stopped (SIGSTOP, a debugger, a virtual machine, a computer asleep), or its loop was blocked."""

    def __init__(self) -> None:
        self._beat_s: float | None = None  # None: at rest, nothing is watched
        self._paused_s = 0.0
        self._void_until_s = float("-inf")

    def beat(self, now_s: float) -> None:
        """The process runs."""
        if self._beat_s is not None and now_s > self._beat_s + STALL_S:
            self._paused_s, self._void_until_s = now_s - self._beat_s, now_s + GRACE_S
            log.warning("daemon.stalled", seconds=round(self._paused_s, 3))
        self._beat_s = now_s

    def rest(self) -> None:
        """No beat comes until the next one, because nothing can be driven."""
        self._beat_s = None

    def check(self, now_s: float) -> None:
        """Whether a velocity that arrives now is obeyed.

        Raises:
            BadRequest: the process has just gone on after a pause.
        """
        if self._beat_s is not None:
            self.beat(now_s)
        if now_s < self._void_until_s:
            raise BadRequest(
                f"hostlink did not run for {self._paused_s:.1f} s, so this may be old: send it again if it is meant"
            )
