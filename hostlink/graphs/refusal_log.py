"""RefusalLog: when the log of a graph has a line about refused velocities. Pure."""

INTERVAL_S = 10.0


class RefusalLog:
    """Refusals of one source: the first of each kind is a line at once, the others are one line in INTERVAL_S."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}  # by kind, since its last line
        self._due_s: dict[str, float] = {}

    def count(self, kind: str, now_s: float) -> int:
        """Count a refusal; returns how many the line reports that is due now, 0 if none is."""
        count = self._counts[kind] = self._counts.get(kind, 0) + 1
        if now_s < self._due_s.get(kind, float("-inf")):
            return 0
        self._counts[kind], self._due_s[kind] = 0, now_s + INTERVAL_S
        return count
