"""FoxgloveTime: the time that a client of Foxglove's protocol receives: this computer's, or that of /clock."""

import contextlib
import time

from hostlink.api.foxglove_frames import encode_message, encode_time
from hostlink.api.outgoing import ClientQueue, Outgoing
from hostlink.errors import BadRequest
from hostlink.hub.message import Message
from hostlink.hub.participant import Participant
from hostlink.hub.subscription import Subscription
from hostlink.hub.topic_graph import TopicGraph
from hostlink.messages.catalog import CLOCK, CLOCK_TYPE, decode_clock

INTERVAL_S = 0.1  # between two times while no message comes
STEP_S = 0.005  # between two times before messages: the app takes the newest time for when a message arrived
SLIGHT_NS = (
    1_000_000_000  # back by less is not sent: the app takes a step back for a seek, and drops what it has not shown
)
_QUEUED_AS = ""  # is no topic's name


class FoxgloveTime:
    """Messages bear the same time, as the protocol demands; /clock holds while a program or device publishes it."""

    def __init__(self, participant: Participant, topics: TopicGraph, queue: ClientQueue) -> None:
        self._participant, self._topics, self._queue = participant, topics, queue
        self._clock: Subscription | None = None
        self._simulated_ns: int | None = None  # None: nothing came on /clock
        self._sent_ns = 0
        self._sent_s = 0.0
        self._due_s = 0.0

    def follow_graph(self) -> None:
        """Subscribe to /clock while it is published."""
        topic = self._topics.find_or_none(CLOCK)
        is_published = topic is not None and bool(topic.publishers) and topic.type_name == CLOCK_TYPE
        if is_published and self._clock is None:
            with contextlib.suppress(BadRequest):  # it has as many subscriptions as it may have: the time stays ours
                self._clock = self._participant.subscribe(CLOCK, self._receive, type_name=CLOCK_TYPE)
        elif not is_published and self._clock is not None:
            self._clock.close()
            self._clock = self._simulated_ns = None

    def outgoing(self, message: Message, subscription_id: int) -> Outgoing:
        """A message with its time, which leaves before it where the client's newest is older."""
        stamp_ns = message.stamp_ns if self._simulated_ns is None else self._simulated_ns
        before = self._next(stamp_ns, message.at_s) if self._is_due(stamp_ns, message.at_s) else b""
        return Outgoing(encode_message(subscription_id, stamp_ns, message.payload), is_binary=True, before=before)

    def flush(self, now_s: float) -> float:
        """Send the time if it is due, unless the client has yet to read; returns when the next is."""
        if now_s >= self._due_s:
            self._put(time.time_ns() if self._simulated_ns is None else self._simulated_ns, now_s)
            self._due_s = now_s + INTERVAL_S
        return self._due_s

    def _receive(self, message: Message) -> None:
        now_ns = decode_clock(message.payload)
        if now_ns is not None:
            self._simulated_ns = now_ns
            if self._is_due(now_ns, message.at_s):
                self._put(now_ns, message.at_s)

    def _is_due(self, stamp_ns: int, at_s: float) -> bool:
        return at_s >= self._sent_s + STEP_S or abs(stamp_ns - self._sent_ns) >= SLIGHT_NS

    def _put(self, stamp_ns: int, now_s: float) -> None:
        if self._queue.waiting_messages == 0 or not self._sent_ns:
            frame = self._next(stamp_ns, now_s)
            if frame:
                self._queue.put_message(_QUEUED_AS, Outgoing(frame, is_binary=True))

    def _next(self, stamp_ns: int, now_s: float) -> bytes:
        """The time as a frame; empty if it is not to be sent."""
        if stamp_ns == self._sent_ns or 0 < self._sent_ns - stamp_ns < SLIGHT_NS:
            return b""
        self._sent_ns, self._sent_s = stamp_ns, now_s
        self._due_s = now_s + INTERVAL_S
        return encode_time(stamp_ns)
