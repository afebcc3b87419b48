"""SourceClock: how late a message of ROS 2 is, by the wall clock of who sent it. Pure."""

from hostlink.robot.freshness import Freshness

_NS_PER_S = 1_000_000_000


class SourceClock:
    """Of one publisher. A wall clock that is set back is no delay: a message that waits never has an earlier time."""

    def __init__(self) -> None:
        self._freshness = Freshness()
        self._newest = (0, 0)  # number and time of the newest message

    def late_s(self, sequence_number: int, source_ns: int, now_s: float) -> float:
        """Seconds that a message waited longer on its way than the quickest before it."""
        number, time_ns = self._newest
        if sequence_number > number and source_ns < time_ns:
            self._freshness = Freshness()
        self._newest = max(self._newest, (sequence_number, source_ns))
        return self._freshness.late_s(source_ns / _NS_PER_S, now_s)
