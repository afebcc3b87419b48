"""RefusalLog: rate limit of log lines about refused messages. Pure."""

INTERVAL_S = 10.0


class RefusalLog:
    """Refusals of one source: the first of each kind is logged at once, later ones as one line in INTERVAL_S."""

    def __init__(self) -> None:
        self._counts: dict[str, int] = {}  # by kind, since its last line
        self._due_s: dict[str, float] = {}

    def count(self, kind: str, now_s: float) -> int:
        """Count a refusal. Return the number that the line due now reports, 0 if no line is due."""
        count = self._counts[kind] = self._counts.get(kind, 0) + 1
        if now_s < self._due_s.get(kind, float("-inf")):
            return 0
        self._counts[kind], self._due_s[kind] = 0, now_s + INTERVAL_S
        return count
