"""NegotiationScheduler: when a session asks for topics: the wish, its limits and the times that it depends on."""

from collections import Counter

ASK_INTERVAL_S = 1.0  # docs/protocol.md#topic-negotiation: at most one request for topics a second
ANSWER_TIMEOUT_S = 2.0  # twice the longest burst of TopicInfos on a 38400 baud line
SILENCE_S = 5.0  # two time requests missed: they come every 2.5 s
QUIET_S = 3.5  # not a byte, one time request missed: a device that restarted behind its radio waits to be asked
TIME_PERIOD_S = (1.0, 4.0)  # between two time requests: 2.5 s, a slow loop later, never two at once as in a negotiation
MAX_SAME_ASKS = 3  # for one gap or one unknown id; a device that does not mend it never will


class NegotiationScheduler:
    """All times are of one monotonic clock, in seconds."""

    def __init__(self) -> None:
        self.heard_at_s = 0.0
        self.told_at_s = 0.0
        self.is_answered = True
        self.is_negotiation_damaged = False
        self.is_asking_time = False  # at the usual period
        self._time_requested_at_s = 0.0  # or a request for topics took its place
        self._last_time_request_s = float("-inf")
        self._asked_at_s = float("-inf")
        self._wish: str | None = None
        self._same_asks: Counter[object] = Counter()

    def open(self, now_s: float) -> None:
        self.heard_at_s = self._time_requested_at_s = now_s
        self._wish = "connected"

    def take_time_request(self, now_s: float) -> None:
        shortest_s, longest_s = TIME_PERIOD_S
        self.is_asking_time |= shortest_s <= now_s - self._last_time_request_s <= longest_s
        self._time_requested_at_s = self._last_time_request_s = now_s

    def wish(self, reason: str, *, about: object) -> None:
        """Want to ask, unless it was asked for the same cause too often already."""
        if self._wish is None and self._same_asks[about] < MAX_SAME_ASKS:
            self._same_asks[about] += 1
            self._wish = reason

    def request(self, reason: str) -> None:
        """Want to ask, whatever was asked before."""
        self._wish = self._wish or reason

    def forget_same_asks(self) -> None:
        self._same_asks.clear()

    def finish(self, gap_at: int | None, *, is_short: bool = False) -> None:
        """A negotiation ended: earlier wishes are granted, what was lost in it is a new one."""
        self._wish = None
        if gap_at is not None:
            self.wish("gap", about="loss")
        elif self.is_negotiation_damaged:
            self.wish("damaged", about="loss")
        elif is_short:
            self.wish("missing", about="loss")
        else:
            self._same_asks.pop("loss", None)
        self.is_negotiation_damaged = False

    def tick(self, now_s: float) -> None:
        if not self.is_answered:
            if now_s >= self._asked_at_s + ANSWER_TIMEOUT_S:
                self._wish = self._wish or "no_answer"
        elif now_s >= self._silent_at_s():
            self._time_requested_at_s = now_s
            self._wish = self._wish or "no_time_requests"

    def take_wish(self, now_s: float) -> str | None:
        """The reason to ask now; None: nothing to ask, or asked less than a second ago."""
        if self._wish is None or now_s < self._asked_at_s + ASK_INTERVAL_S:
            return None
        reason, self._wish = self._wish, None
        self._asked_at_s = now_s
        self.is_answered = False
        return reason

    def deadline_s(self) -> float:
        if self._wish is not None:
            return self._asked_at_s + ASK_INTERVAL_S
        if not self.is_answered:
            return self._asked_at_s + ANSWER_TIMEOUT_S
        return self._silent_at_s()

    def _silent_at_s(self) -> float:
        """When its silence is a reason to ask."""
        silent_at_s = self._time_requested_at_s + SILENCE_S
        return min(silent_at_s, self.heard_at_s + QUIET_S) if self.is_asking_time else silent_at_s
