"""NegotiationScheduler: state of the topic negotiation, and when the next topic request is due."""

from collections import Counter
from enum import Enum, auto
from typing import Final

REQUEST_INTERVAL_S = 1.0  # docs/protocol.md#topic-negotiation: at most one topic request a second
ANSWER_TIMEOUT_S = 2.0  # twice the longest burst of TopicInfos on a 38400 baud line
NEGOTIATION_QUIET_S = 0.5  # a device sends its TopicInfos without a pause; WiFi may add one
CONFIRM_S = 2.0  # after the last TopicInfo: the device has finished its start by then
LONGEST_TURN_S = 4.0  # of a device's loop: it sends half a frame in each, and a longer one looks like silence
LONGEST_CALL_S = 6.0  # longest service call of a device: the host's deadline plus the travel time of a late answer
ANSWER_WAY_S = 0.5  # from the host to the device, over a slow serial line behind a radio
SILENCE_S = 5.0  # two missed time requests: one is due every 2.5 s
QUIET_S = 3.5  # without a byte, one time request missed: a restarted device behind a radio waits for a topic request
TIME_PERIOD_S = (1.0, 4.0)  # between two time requests: 2.5 s, plus a slow loop; a negotiation sends two at once
MAX_PARTS = 8  # parts of one negotiation that are announced at once; further parts wait for a pause
PROBE = "probe"  # reason of a request whose answer shows that the device is alive
MAX_SAME_REQUESTS = 3  # for one gap or one unknown id; a device that has not corrected it by then never will


class SessionState(Enum):
    """State of the negotiation: what the host waits for."""

    REQUESTING = auto()  # the first TopicInfo
    NEGOTIATING = auto()  # the last TopicInfo
    READY = auto()  # messages


class NegotiationStep(Enum):
    """NegotiationStep that changes the SessionState."""

    REQUESTED = auto()  # a topic request is queued
    TOPIC_INFO = auto()
    FINISHED = auto()  # another frame after the TopicInfos, or none for NEGOTIATION_QUIET_S


TRANSITIONS: Final = {
    SessionState.REQUESTING: {
        NegotiationStep.REQUESTED: SessionState.REQUESTING,
        NegotiationStep.TOPIC_INFO: SessionState.NEGOTIATING,
    },
    SessionState.NEGOTIATING: {
        NegotiationStep.TOPIC_INFO: SessionState.NEGOTIATING,
        NegotiationStep.FINISHED: SessionState.READY,
    },
    SessionState.READY: {
        NegotiationStep.REQUESTED: SessionState.REQUESTING,
        NegotiationStep.TOPIC_INFO: SessionState.NEGOTIATING,
    },
}


class NegotiationScheduler:
    """State machine of the topic negotiation. All times are of one monotonic clock, in seconds.

    | state       | requests topics                                                                                   |
    |-------------|---------------------------------------------------------------------------------------------------|
    | REQUESTING  | at once after `open`, then after every 2 s without an answer                                      |
    | NEGOTIATING | never                                                                                             |
    | READY       | unknown id, gap, damage or another meaning of an id (3 times each); no time request for 5 s, or   |
    |             | no byte for 3.5 s from a device that requests the time; on a lossy transport 2 s after changed    |
    |             | topics, but not while the device waits for a service                                              |

    A request waits until the last one is REQUEST_INTERVAL_S old. A probe waits only for the last probe.
    """

    __slots__ = (
        "_calls_until_s", "_is_damaged", "_is_unconfirmed", "_last_time_request_s", "_parts", "_probed_at_s",
        "_requested_at_s", "_same_requests", "_time_requested_at_s", "_topic_info_at_s", "_turn_s", "is_regular",
        "pending", "received_at_s", "state",
    )  # fmt: skip

    def __init__(self) -> None:
        self.state = SessionState.REQUESTING
        self.received_at_s = 0.0  # time of the last byte
        self.is_regular = False  # the device requests the time at the usual period
        self._calls_until_s = float("-inf")  # the device may wait for a service until then
        self._is_damaged = False  # bytes were skipped during this negotiation
        self._is_unconfirmed = False  # the last negotiation has to be confirmed by a second one
        self._topic_info_at_s = 0.0
        self._turn_s = 0.0  # of a device's loop, if it sends frames in pieces
        self._parts = 1  # parts of this negotiation; messages follow each part
        self._time_requested_at_s = 0.0  # last time request or TopicInfo, or the topic request that replaced it
        self._last_time_request_s = float("-inf")
        self._requested_at_s = self._probed_at_s = float("-inf")
        self.pending: str | None = None  # reason of the next topic request
        self._same_requests: Counter[object] = Counter()

    def open(self, now_s: float) -> None:
        """Start the timers and schedule the first topic request."""
        self.received_at_s = self._time_requested_at_s = now_s
        self.pending = "connected"

    def time_requested(self, now_s: float) -> None:
        """Note a time request of the device."""
        shortest_s, longest_s = TIME_PERIOD_S
        self.is_regular |= shortest_s <= now_s - self._last_time_request_s <= longest_s
        self._time_requested_at_s = self._last_time_request_s = now_s

    def note_pause(self, pause_s: float) -> None:
        """Note the pause inside a frame: a device whose loop is slow needs longer for everything."""
        if pause_s > NEGOTIATION_QUIET_S:
            self._turn_s = min(max(self._turn_s, pause_s), LONGEST_TURN_S)

    @property
    def _quiet_s(self) -> float:
        return max(NEGOTIATION_QUIET_S, 1.5 * self._turn_s)

    @property
    def _answer_s(self) -> float:
        return max(ANSWER_TIMEOUT_S, 3 * self._turn_s)

    def called(self, now_s: float) -> None:
        """Note a service call of the device. A topic request would end ros_lib's call, but not the response to it."""
        self._calls_until_s = now_s + LONGEST_CALL_S

    def answered(self, now_s: float) -> None:
        """Note that the response to the device's service call was sent."""
        self._calls_until_s = now_s + ANSWER_WAY_S

    def topic_info_received(self, now_s: float, *, may_go_on: bool = False) -> bool:
        """Note a TopicInfo. Return whether it is the first of a negotiation.

        Without a topic request in between, a device may continue its announcement after messages of its other tasks.
        The continuation starts with an id that it has not announced yet (`may_go_on`).
        """
        goes_on = may_go_on and now_s < self._topic_info_at_s + self._quiet_s
        is_first = self.state is SessionState.REQUESTING or (self.state is SessionState.READY and not goes_on)
        if self.state is not SessionState.NEGOTIATING:
            self._parts = 1 if is_first else self._parts + 1
            self._is_unconfirmed &= not is_first
        self._topic_info_at_s = self._time_requested_at_s = now_s  # a device that announces is alive
        self._step(NegotiationStep.TOPIC_INFO)
        return is_first

    def mark_damaged(self) -> None:
        """Note that bytes were lost. During a negotiation they may have been a TopicInfo."""
        self._is_damaged |= self.state is SessionState.NEGOTIATING

    def request(self, reason: str) -> None:
        """Schedule a topic request, without a limit on repetitions."""
        self.pending = self.pending or reason

    def probe(self) -> None:
        """Schedule a topic request to find out whether the device is alive."""
        self.pending = PROBE

    def request_about(self, cause: object, reason: str) -> None:
        """Schedule a topic request, at most MAX_SAME_REQUESTS times for one cause."""
        if self.pending is None and self._same_requests[cause] < MAX_SAME_REQUESTS:
            self._same_requests[cause] += 1
            self.pending = reason

    def forget_causes(self) -> None:
        """Reset the request counts of all causes but `altered`, because the topics changed."""
        self._same_requests = Counter({"altered": self._same_requests["altered"]})

    def finish(
        self, gap_at: int | None, *, is_short: bool = False, is_altered: bool = False, is_unconfirmed: bool = False
    ) -> None:
        """End the negotiation. It satisfies earlier requests; a loss during it causes a new one.

        So does another meaning of an id (`is_altered`), because a checksum lets some damage pass: a robot whose
        velocity topic was announced with damage cannot be driven.
        """
        self._step(NegotiationStep.FINISHED)
        self.pending = None
        self._is_unconfirmed |= is_unconfirmed
        if gap_at is not None:
            self.request_about("loss", "gap")
        elif self._is_damaged:
            self.request_about("loss", "damaged")
        else:
            self._same_requests.pop("loss", None)
        if is_short:  # also for a device whose gap never closes
            self.request_about("short", "missing")
        else:
            self._same_requests.pop("short", None)
        if is_altered:
            self.request_about("altered", "altered")
        else:
            self._same_requests.pop("altered", None)
        self._is_damaged = False

    @property
    def may_finish(self) -> bool:
        """Whether a frame of another kind may end the current negotiation.

        Finishing a negotiation costs time in proportion to the number of topics. Without the limit MAX_PARTS, a device
        that sends a frame after each TopicInfo would keep the daemon busy with few bytes.
        """
        return self._parts <= MAX_PARTS

    def is_quiet(self, now_s: float) -> bool:
        """Whether the negotiation ends because no TopicInfo arrived for NEGOTIATION_QUIET_S, or a slow turn."""
        return self.state is SessionState.NEGOTIATING and now_s >= self._topic_info_at_s + self._quiet_s

    def tick(self, now_s: float) -> None:
        """Schedule a topic request for a device that does not answer or is silent."""
        if self.state is SessionState.REQUESTING and now_s >= self._requested_at_s + self._answer_s:
            self.request("no_answer")
        elif self.state is SessionState.READY and self._is_unconfirmed and now_s >= self._confirm_at_s():
            self._is_unconfirmed = False
            self.request("unconfirmed")
        elif self.state is SessionState.READY and now_s >= self._silent_at_s():
            self._time_requested_at_s = now_s
            self.request("no_time_requests")

    def pop_request(self, now_s: float) -> str | None:
        """Return the reason to request topics now. None: no request is scheduled, or the last one is too recent."""
        if self.pending is None or self.state is SessionState.NEGOTIATING:
            return None
        if now_s < self._may_request_at_s():
            return None
        reason, self.pending = self.pending, None
        self._requested_at_s = now_s
        if reason == PROBE:
            self._probed_at_s = now_s
        self._step(NegotiationStep.REQUESTED)
        return reason

    def deadline_s(self) -> float:
        """Time at which `tick` must be called if no byte arrives before."""
        if self.state is SessionState.NEGOTIATING:
            return self._topic_info_at_s + self._quiet_s
        if self.pending is not None:
            return self._may_request_at_s()
        if self.state is SessionState.REQUESTING:
            return self._requested_at_s + self._answer_s
        if self._is_unconfirmed:
            return min(self._confirm_at_s(), self._silent_at_s())
        return self._silent_at_s()

    def _step(self, step: NegotiationStep) -> None:
        self.state = TRANSITIONS[self.state][step]

    def _may_request_at_s(self) -> float:
        is_prompt = self.pending == PROBE and self.state is SessionState.READY  # it has answered the last request
        return (self._probed_at_s if is_prompt else self._requested_at_s) + REQUEST_INTERVAL_S

    def _confirm_at_s(self) -> float:
        return max(self._topic_info_at_s + CONFIRM_S, self._calls_until_s)

    def _silent_at_s(self) -> float:
        """Time at which the device's silence causes a topic request."""
        silent_at_s = self._time_requested_at_s + max(SILENCE_S, 3 * self._turn_s)
        is_regular = self.is_regular and not self._turn_s
        return min(silent_at_s, self.received_at_s + QUIET_S) if is_regular else silent_at_s
