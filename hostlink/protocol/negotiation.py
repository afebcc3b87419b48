"""NegotiationScheduler: in which state the negotiation of topics is, and when the next request for topics is due."""

from collections import Counter
from enum import Enum, auto
from typing import Final

REQUEST_INTERVAL_S = 1.0  # docs/protocol.md#topic-negotiation: at most one request for topics a second
ANSWER_TIMEOUT_S = 2.0  # twice the longest burst of TopicInfos on a 38400 baud line
NEGOTIATION_QUIET_S = 0.5  # a device sends its TopicInfos without a pause; WiFi may put one in
CONFIRM_S = 2.0  # behind the last TopicInfo: what a device does when it is connected is over by then
LONGEST_CALL_S = 6.0  # of a service, by a device: the host's deadline, and the time for an answer that is late
ANSWER_WAY_S = 0.5  # from the host to the device, over a slow line behind the radio
SILENCE_S = 5.0  # two time requests missed: they come every 2.5 s
QUIET_S = 3.5  # not a byte, one time request missed: a device that restarted behind its radio waits for a request
TIME_PERIOD_S = (1.0, 4.0)  # between two time requests: 2.5 s, a slow loop later, never two at once as in a negotiation
MAX_PARTS = 8  # of one negotiation that are announced at once; what follows waits for a pause
MAX_SAME_REQUESTS = 3  # for one gap or one unknown id; a device that does not correct it never will


class SessionState(Enum):
    """What the host waits for."""

    REQUESTING = auto()  # for the first TopicInfo
    NEGOTIATING = auto()  # for the last TopicInfo
    READY = auto()  # for messages


class Step(Enum):
    """What moves a session from one state to the next."""

    REQUESTED = auto()  # a request for topics is queued
    TOPIC_INFO = auto()
    FINISHED = auto()  # another frame after the TopicInfos, or NEGOTIATION_QUIET_S without one


TRANSITIONS: Final = {
    SessionState.REQUESTING: {
        Step.REQUESTED: SessionState.REQUESTING,
        Step.TOPIC_INFO: SessionState.NEGOTIATING,
    },
    SessionState.NEGOTIATING: {
        Step.TOPIC_INFO: SessionState.NEGOTIATING,
        Step.FINISHED: SessionState.READY,
    },
    SessionState.READY: {
        Step.REQUESTED: SessionState.REQUESTING,
        Step.TOPIC_INFO: SessionState.NEGOTIATING,
    },
}


class NegotiationScheduler:
    """The state of one session. All times are of one monotonic clock, in seconds.

    | state       | requests topics                                                                                   |
    |-------------|---------------------------------------------------------------------------------------------------|
    | REQUESTING  | at once after `open`, then after every 2 s without an answer                                      |
    | NEGOTIATING | never                                                                                             |
    | READY       | unknown id, gap or damage (3 times each); no time request for 5 s, or not a byte for 3.5 s from a |
    |             | device that requests the time; 2 s after other topics than before, where frames are lost whole,   |
    |             | but not while the device waits for a service                                                      |

    A request waits until the last one is REQUEST_INTERVAL_S old.
    """

    __slots__ = (
        "_calls_until_s", "_is_damaged", "_is_unconfirmed", "_last_time_request_s", "_parts", "_pending",
        "_requested_at_s", "_same_requests", "_time_requested_at_s", "_topic_info_at_s", "is_regular", "received_at_s",
        "state",
    )  # fmt: skip

    def __init__(self) -> None:
        self.state = SessionState.REQUESTING
        self.received_at_s = 0.0  # the last byte
        self.is_regular = False  # it requests the time at the usual period
        self._calls_until_s = float("-inf")  # till then a device may wait for a service
        self._is_damaged = False  # bytes were skipped in this negotiation
        self._is_unconfirmed = False  # the last negotiation, one more is to say the same
        self._topic_info_at_s = 0.0
        self._parts = 1  # of this negotiation, each with messages behind it
        self._time_requested_at_s = 0.0  # or a request for topics took its place
        self._last_time_request_s = float("-inf")
        self._requested_at_s = float("-inf")
        self._pending: str | None = None  # why topics are to be requested
        self._same_requests: Counter[object] = Counter()

    def open(self, now_s: float) -> None:
        """The connection is open."""
        self.received_at_s = self._time_requested_at_s = now_s
        self._pending = "connected"

    def time_requested(self, now_s: float) -> None:
        """The device requested the time."""
        shortest_s, longest_s = TIME_PERIOD_S
        self.is_regular |= shortest_s <= now_s - self._last_time_request_s <= longest_s
        self._time_requested_at_s = self._last_time_request_s = now_s

    def called(self, now_s: float) -> None:
        """The device calls a service: a request for topics would end ros_lib's call, and not the answer to it."""
        self._calls_until_s = now_s + LONGEST_CALL_S

    def answered(self, now_s: float) -> None:
        """The answer to its call leaves."""
        self._calls_until_s = now_s + ANSWER_WAY_S

    def topic_info_received(self, now_s: float, *, may_go_on: bool = False) -> bool:
        """A TopicInfo came; whether it is the first of a negotiation.

        A device announces its topics when they are requested: behind messages of its other tasks and without a request
        between them it goes on, with an id that it has not announced yet (`may_go_on`).
        """
        goes_on = may_go_on and now_s < self._topic_info_at_s + NEGOTIATION_QUIET_S
        is_first = self.state is SessionState.REQUESTING or (self.state is SessionState.READY and not goes_on)
        if self.state is not SessionState.NEGOTIATING:
            self._parts = 1 if is_first else self._parts + 1
            self._is_unconfirmed &= not is_first
        self._topic_info_at_s = now_s
        self._step(Step.TOPIC_INFO)
        return is_first

    def mark_damaged(self) -> None:
        """Bytes were lost: in a negotiation they may have been a TopicInfo."""
        self._is_damaged |= self.state is SessionState.NEGOTIATING

    def request(self, reason: str) -> None:
        """Request the topics, whatever was requested before."""
        self._pending = self._pending or reason

    def request_about(self, cause: object, reason: str) -> None:
        """Request the topics, unless that was done too often for the same cause."""
        if self._pending is None and self._same_requests[cause] < MAX_SAME_REQUESTS:
            self._same_requests[cause] += 1
            self._pending = reason

    def forget_causes(self) -> None:
        """The topics are others now: count anew."""
        self._same_requests.clear()

    def finish(self, gap_at: int | None, *, is_short: bool = False, is_unconfirmed: bool = False) -> None:
        """The negotiation ended: it grants earlier requests, and what was lost in it is the cause of a new one."""
        self._step(Step.FINISHED)
        self._pending = None
        self._is_unconfirmed |= is_unconfirmed
        if gap_at is not None:
            self.request_about("loss", "gap")
        elif self._is_damaged:
            self.request_about("loss", "damaged")
        else:
            self._same_requests.pop("loss", None)
        if is_short:  # also where a gap never closes
            self.request_about("short", "missing")
        else:
            self._same_requests.pop("short", None)
        self._is_damaged = False

    @property
    def may_finish(self) -> bool:
        """Whether a frame of another kind ends the negotiation that there is, if any.

        Each end costs as much as all topics so far: one behind each of them would keep the daemon busy by a few bytes.
        """
        return self.state is SessionState.NEGOTIATING and self._parts <= MAX_PARTS

    def is_quiet(self, now_s: float) -> bool:
        """Whether a negotiation ends because no TopicInfo came for long enough."""
        return self.state is SessionState.NEGOTIATING and now_s >= self._topic_info_at_s + NEGOTIATION_QUIET_S

    def tick(self, now_s: float) -> None:
        """Request the topics of a device that does not answer, or is silent."""
        if self.state is SessionState.REQUESTING and now_s >= self._requested_at_s + ANSWER_TIMEOUT_S:
            self.request("no_answer")
        elif self.state is SessionState.READY and self._is_unconfirmed and now_s >= self._confirm_at_s():
            self._is_unconfirmed = False
            self.request("unconfirmed")
        elif self.state is SessionState.READY and now_s >= self._silent_at_s():
            self._time_requested_at_s = now_s
            self.request("no_time_requests")

    def pop_request(self, now_s: float) -> str | None:
        """The reason to request topics now; None: there is none, or the last request is too young."""
        if self._pending is None or self.state is SessionState.NEGOTIATING:
            return None
        if now_s < self._requested_at_s + REQUEST_INTERVAL_S:
            return None
        reason, self._pending = self._pending, None
        self._requested_at_s = now_s
        self._step(Step.REQUESTED)
        return reason

    def deadline_s(self) -> float:
        """When something is due if nothing comes before."""
        if self.state is SessionState.NEGOTIATING:
            return self._topic_info_at_s + NEGOTIATION_QUIET_S
        if self._pending is not None:
            return self._requested_at_s + REQUEST_INTERVAL_S
        if self.state is SessionState.REQUESTING:
            return self._requested_at_s + ANSWER_TIMEOUT_S
        if self._is_unconfirmed:
            return min(self._confirm_at_s(), self._silent_at_s())
        return self._silent_at_s()

    def _step(self, step: Step) -> None:
        self.state = TRANSITIONS[self.state][step]

    def _confirm_at_s(self) -> float:
        return max(self._topic_info_at_s + CONFIRM_S, self._calls_until_s)

    def _silent_at_s(self) -> float:
        """When its silence is a reason to request the topics."""
        silent_at_s = self._time_requested_at_s + SILENCE_S
        return min(silent_at_s, self.received_at_s + QUIET_S) if self.is_regular else silent_at_s
