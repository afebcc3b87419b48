"""HostClock: whether this computer's own clock can be trusted for stamps. Pure: both times come in."""

MIN_WALL_NS = (
    1_735_689_600_000_000_000  # 2025: hostlink did not exist before; a computer without a battery is there at boot
)
STEP_S = 0.5  # NTP slews what is less (128 ms) and steps what is more
REMEMBERED_S = 30.0  # as long as any evidence
_NS_PER_S = 1_000_000_000


class HostClock:
    """Compares the wall clock with the monotonic one at each check."""

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._step_s = 0.0
        self._stepped_at_s = float("-inf")

    def check(self, now_s: float, wall_ns: int) -> str:
        """What is wrong with the clock; empty where nothing is."""
        offset_s = wall_ns / _NS_PER_S - now_s
        if self._offset_s is not None and abs(offset_s - self._offset_s) > STEP_S:
            self._step_s, self._stepped_at_s = offset_s - self._offset_s, now_s
        self._offset_s = offset_s
        if wall_ns < MIN_WALL_NS:
            return "its clock is not set"
        if now_s - self._stepped_at_s < REMEMBERED_S:
            return f"its clock was set by {self._step_s:+.1f} s"
        return ""
