"""Freshness: how late a client's command is, without clocks that agree. Pure."""

DRIFT = 0.001  # two clocks drift far less; a route that became slower for good is accepted at this pace


class Freshness:
    """How much longer than the quickest of its kind something was on its way, by the sender's clock and ours."""

    def __init__(self) -> None:
        self._quickest_s = float("inf")  # the smallest difference of the clocks: no wait in it
        self._updated_at_s = 0.0

    def late_s(self, sent_s: float, now_s: float) -> float:
        """Seconds that it waited on the way; `sent_s` is of the sender's own clock, from any beginning."""
        difference_s = now_s - sent_s
        self._quickest_s = min(difference_s, self._quickest_s + DRIFT * (now_s - self._updated_at_s))
        self._updated_at_s = now_s
        return difference_s - self._quickest_s
