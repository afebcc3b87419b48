"""LockedStreams: who has published velocities to a locked robot, and may not have noticed. Pure."""

from collections.abc import Hashable

MAX_STREAMS = 64  # that are kept apart; over it the one is forgotten that published the longest ago


class LockedStreams:
    """A stream that met a lock drives again after a zero, or a pause as long as a lease.

    | stream  | event                                | next    | then    |
    |---------|--------------------------------------|---------|---------|
    | any     | a velocity while the robot is locked | met     | refused |
    | met     | a velocity within a lease            | met     | refused |
    | met     | a zero, or a velocity after a lease  | not met | obeyed  |
    | not met | a velocity                           | not met | obeyed  |
    """

    def __init__(self) -> None:
        self._last_s: dict[Hashable, float] = {}  # by owner, of those that met a lock; the newest last

    def admit(self, owner: Hashable, *, is_zero: bool, is_locked: bool, now_s: float, lease_s: float) -> bool:
        """Whether a velocity that came now may drive."""
        last_s = self._last_s.pop(owner, float("-inf"))
        if is_zero or not (is_locked or now_s < last_s + lease_s):
            return True
        self._last_s[owner] = now_s
        if len(self._last_s) > MAX_STREAMS:
            del self._last_s[next(iter(self._last_s))]
        return False
