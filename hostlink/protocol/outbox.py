"""Outbox: what waits for one device, in which order it leaves, and when its UART can take it."""

from collections import deque

from hostlink.errors import DeviceBusy
from hostlink.protocol.control import encode_time
from hostlink.protocol.frame import FIRST_TOPIC_ID, HEADER, STOP_REQUEST, TOPICS_REQUEST, Id, encode

RING_BYTES = 128  # ROBOT.md: the receive ring of the Due's UART, so the largest burst that it takes
MAX_REPLIES = 32


class Outbox:
    """In this order: time answer, request for topics, urgent commands, replies and calls, other commands, stop.

    A command replaces the one of its topic that has not left yet. All is paced by a token bucket of one UART ring, so
    that nothing queues up behind the wire, where it could not be replaced.
    """

    def __init__(self, *, uart_bytes_s: int | None = None) -> None:
        self.replaced = 0
        self._uart_bytes_s = uart_bytes_s
        self._is_time_due = self._is_request_due = self._is_stop_due = self._is_stopped = False
        self._urgent: dict[int, bytes] = {}
        self._replies: deque[bytes] = deque()
        self._commands: dict[int, deque[bytes]] = {}
        self._credit_bytes = float(RING_BYTES)
        self._credit_at_s = 0.0

    def put_time(self) -> None:
        """Answer the time; the clock is read when the answer leaves."""
        self._is_time_due = True

    def put_topics_request(self) -> None:
        """Ask the device for its topics."""
        self._is_request_due = True

    def put_stop(self) -> None:
        """Tell the device to fall silent, after the urgent commands; nothing else is sent any more."""
        self._is_stop_due = self._is_stopped = True

    def put_urgent(self, topic_id: int, frame: bytes) -> None:
        """Queue a command that must not wait behind anything but the time: a velocity. After a stop it is too late."""
        if self._is_stopped:
            return
        if self._urgent.pop(topic_id, None) is not None:
            self.replaced += 1
        self._urgent[topic_id] = frame

    def put_reply(self, name: str, frame: bytes) -> None:
        """Queue an answer or a call; DeviceBusy when too many wait."""
        if len(self._replies) >= MAX_REPLIES:
            raise DeviceBusy(name, len(self._replies))
        self._replies.append(frame)

    def put_command(self, topic_id: int, frame: bytes, *, depth: int = 1) -> None:
        """Queue a message of a topic that keeps the newest `depth`; it takes its turn behind other topics."""
        waiting = self._commands.pop(topic_id, None) or deque()
        while len(waiting) >= depth:
            waiting.popleft()
            self.replaced += 1
        waiting.append(frame)
        self._commands[topic_id] = waiting

    def drop_messages(self) -> None:
        """Forget every command, call and response: the ids may mean other topics now. Parameters have no such id."""
        self._urgent.clear()
        self._commands.clear()
        self._replies = deque(frame for frame in self._replies if HEADER.unpack_from(frame)[3] < FIRST_TOPIC_ID)

    def take(self, *, now_s: float, wall_ns: int) -> bytes | None:
        """The next frame to write, or None: nothing waits, or the UART is still busy with the last ones."""
        if self.wait_s(now_s) != 0:
            return None
        frame = self._next(wall_ns)
        self._credit_bytes -= len(frame)
        return frame

    def wait_s(self, now_s: float) -> float | None:
        """Seconds until `take` gives a frame; None when nothing waits."""
        if not self._is_anything_due():
            return None
        if self._uart_bytes_s is None:
            return 0.0
        earned_bytes = (now_s - self._credit_at_s) * self._uart_bytes_s
        self._credit_bytes = min(float(RING_BYTES), self._credit_bytes + earned_bytes)
        self._credit_at_s = now_s
        if self._credit_bytes > -1:  # less than a byte short may be rounding, for which no clock can wait
            return 0.0
        return -self._credit_bytes / self._uart_bytes_s

    def _is_anything_due(self) -> bool:
        if self._is_stopped:
            return self._is_stop_due
        is_control_due = self._is_time_due or self._is_request_due
        return is_control_due or bool(self._urgent or self._replies or self._commands)

    def _next(self, wall_ns: int) -> bytes:
        if self._is_stopped:
            return self._next_of_the_last()
        if self._is_time_due:
            self._is_time_due = False
            return encode(Id.TIME, encode_time(wall_ns))
        if self._is_request_due:
            self._is_request_due = False
            return TOPICS_REQUEST
        if self._urgent:
            return self._urgent.pop(next(iter(self._urgent)))
        if self._replies:
            return self._replies.popleft()
        return self._next_command()

    def _next_of_the_last(self) -> bytes:
        if self._urgent:
            return self._urgent.pop(next(iter(self._urgent)))
        self._is_stop_due = False
        return STOP_REQUEST

    def _next_command(self) -> bytes:
        topic_id, waiting = next(iter(self._commands.items()))
        frame = waiting.popleft()
        del self._commands[topic_id]
        if waiting:
            self._commands[topic_id] = waiting
        return frame
