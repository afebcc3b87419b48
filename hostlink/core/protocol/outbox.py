"""Outbox: queues of frames for one device, their order, and pacing to the device's UART."""

import math
from collections import deque
from collections.abc import Callable, Hashable
from typing import NamedTuple

from hostlink.errors import DeviceBusy

LOOP_S = 1 / 30  # docs/paper-robot.md#numbers: one turn of the robot's loop, the longest that a stop may wait
RING_BYTES = 128  # docs/paper-robot.md#numbers: the receive ring of the Due's UART, its largest burst
VELOCITY_BYTES = 56
MAX_REPLIES = 32


class ControlFrames(NamedTuple):
    """Frames of a protocol that carry no message. An empty one is never sent.

    `time` returns the answer to a time request from the host's time in nanoseconds; its length is always the same.
    `request` asks the device to announce itself. `end` requests it to stop sending.
    """

    time: Callable[[int], bytes]
    request: bytes
    end: bytes


class OutgoingFrame(NamedTuple):
    """Frame to write now. `waiting_since_s` is set for a velocity only."""

    frame: bytes
    waiting_since_s: float | None = None


class _QueuedFrame:
    """Queued frame and the time since when it waits: infinite until `begin_waiting`."""

    __slots__ = ("frame", "is_awaited", "is_kept", "is_lasting", "since_s")

    def __init__(
        self, frame: bytes, *, is_awaited: bool = False, is_kept: bool = False, is_lasting: bool = False
    ) -> None:
        self.frame, self.is_awaited, self.is_kept, self.is_lasting = frame, is_awaited, is_kept, is_lasting
        self.since_s = math.inf


_Queues = dict[Hashable, deque[_QueuedFrame]]  # round robin: the first key is next


class Outbox:
    """Send queues of one device.

    Order: time answer, topic request, urgent commands, answers of the protocol, replies and calls, commands, stop.

    A command replaces the queued command of its topic. A frame is sent when the device's UART has so few bytes left
    that a velocity queued after it is on the wire within one LOOP_S. A frame on the wire cannot be interrupted, and a
    device drops a frame that arrives in pieces (timeout of 20 ms). A frame that alone takes longer than LOOP_S
    therefore waits while the robot moves. Answers to the device's own requests are exempt: the device blocks until they
    arrive.

    The age of a frame counts from the first `begin_waiting` or `pop_frame` after it was queued; the link calls it at
    once.
    """

    __slots__ = (
        "_busy_until_s", "_commands", "_control_bytes", "_encode", "_is_request_due", "_is_stop_due",
        "_loop_bytes", "_new", "_replies", "_time_bytes", "_uart_bytes_s", "_urgent", "answers", "control",
        "is_stopped", "is_time_due", "prompt_bytes", "replaced", "robot_moves", "slowest_wait_s",
    )  # fmt: skip

    def __init__(
        self,
        control: ControlFrames,
        *,
        uart_bytes_s: int | None = None,
        encode: Callable[[bytes], bytes] | None = None,
    ) -> None:
        """`encode` makes the bytes to send of a queued frame, when it is sent; without it, the frame is these bytes."""
        self._encode = encode
        self.control, self._time_bytes = control, len(control.time(0))
        self._control_bytes = self._time_bytes + len(control.request)  # the most that is sent ahead of a velocity
        self.replaced = 0
        self.slowest_wait_s = 0.0  # of all frames sent
        self.robot_moves = False
        # Model of the device's UART: bytes that were sent and are not passed on yet. Without a speed it is never busy.
        self._uart_bytes_s = uart_bytes_s
        self._busy_until_s = float("-inf")
        self._loop_bytes = float("inf") if uart_bytes_s is None else min(RING_BYTES, uart_bytes_s * LOOP_S)
        # Length of the longest frame that may be sent while the robot moves. On a line so slow that a velocity alone
        # takes longer than LOOP_S, other frames may be as long as a velocity.
        self.prompt_bytes = max(self._loop_bytes - self._control_bytes, VELOCITY_BYTES)
        self.is_stopped = False  # only queued urgent commands and the stop are still sent
        self.is_time_due = self._is_request_due = self._is_stop_due = False
        self._urgent: _Queues = {}
        self.answers: _Queues = {}  # of the protocol itself, for which a device may wait
        self._replies: _Queues = {}
        self._commands: _Queues = {}
        self._new: list[_QueuedFrame] = []  # frames whose age is not counted yet

    @property
    def has_waiting(self) -> bool:
        """Whether any frame is queued."""
        return bool(
            self.is_time_due or self._is_request_due or self._is_stop_due
            or self._urgent or self.answers or self._replies or self._commands
        )  # fmt: skip

    @property
    def has_urgent(self) -> bool:
        """Whether a velocity is queued."""
        return bool(self._urgent)

    def put_time(self) -> None:
        """Queue a time answer. The clock is read when the answer is sent."""
        self.is_time_due = True

    def put_topics_request(self) -> None:
        """Queue a topic request."""
        self._is_request_due = True

    def put_stop(self) -> None:
        """Queue the stop request after the urgent commands. No other frame is sent from now on."""
        self._is_stop_due, self.is_stopped = bool(self.control.end), True

    def put_urgent(self, topic_id: int, frame: bytes, *, is_kept: bool = False) -> None:
        """Queue a velocity, ahead of everything but time answer and topic request. Ignore it after `put_stop`.

        Commands of its topic that wait are older, and are dropped.
        `is_kept`: a newer command does not replace this frame, such as the zero velocity that starts a session.
        """
        if self.is_stopped:
            return
        if self._commands:
            self.drop_commands(topic_id)
        new, waiting = _QueuedFrame(frame, is_kept=is_kept), self._urgent.get(topic_id)
        if waiting is None:
            self._urgent[topic_id] = deque((new,))
            self._new.append(new)
        else:
            self._put(self._urgent, topic_id, new, depth=2 if waiting[0].is_kept else 1)

    def drop_commands(self, topic_id: int) -> None:
        """Drop the commands of a topic that wait."""
        self.replaced += len(self._commands.pop(topic_id, ()))

    def drop_topic(self, topic_id: int) -> None:
        """Drop everything of a topic that waits, also velocities: its id has another meaning now."""
        self._urgent.pop(topic_id, None)
        self._commands.pop(topic_id, None)

    def put_answer(self, key: Hashable, frame: bytes, *, depth: int) -> None:
        """Queue a frame of the protocol itself, such as an acknowledgement. The newest `depth` of a key wait."""
        waiting = self.answers.setdefault(key, deque())
        while len(waiting) >= depth:
            waiting.popleft()
        new = _QueuedFrame(frame, is_awaited=True)
        waiting.append(new)
        self._new.append(new)

    def put_reply(self, name: str, frame: bytes, *, is_lasting: bool = False) -> None:
        """Queue an answer to a request of the device. `is_lasting`: it stays when messages are dropped.

        Raises:
            DeviceBusy: too many requests and answers wait.
        """
        self._put_reply(name, _QueuedFrame(frame, is_awaited=True, is_lasting=is_lasting))

    def put_call(self, name: str, frame: bytes) -> None:
        """Queue a call of a service of the device.

        Raises:
            DeviceBusy: too many requests and answers wait.
        """
        self._put_reply(name, _QueuedFrame(frame))

    def put_command(self, topic_id: int, frame: bytes, *, depth: int = 1) -> None:
        """Queue a message of a topic that keeps the newest `depth` messages. Topics are sent in turn."""
        self._put(self._commands, topic_id, _QueuedFrame(frame), depth=depth)

    def drop_messages(self) -> None:
        """Drop every command, call and response, because ids may have changed their meaning. Lasting replies stay."""
        self.robot_moves = False
        self._urgent.clear()
        self._commands.clear()
        for name, waiting in list(self._replies.items()):
            kept = deque(one for one in waiting if one.is_lasting)
            if kept:
                self._replies[name] = kept
            else:
                del self._replies[name]

    def begin_waiting(self, now_s: float) -> None:
        """Count the age of the frames queued since the last call from now on."""
        for waiting in self._new:
            waiting.since_s = now_s
        self._new.clear()

    def pop_frame(self, *, now_s: float, wall_ns: int) -> OutgoingFrame | None:
        """Remove and return the next frame. None: the queues are empty, or the UART is still busy.

        `wall_ns` is the time in a time answer. It is not read unless `is_time_due`.
        """
        if self._new:  # as `begin_waiting`
            for new in self._new:
                new.since_s = now_s
            self._new.clear()
        head = None
        if self.is_stopped or not (self.is_time_due or self._is_request_due):
            head = self._head()
            if head is None and not self._is_stop_due:
                return None
        if self._uart_bytes_s is not None and self.wait_s(now_s) != 0:
            return None
        since_s = None
        if self.is_time_due and not self.is_stopped:
            self.is_time_due = False
            frame = self.control.time(wall_ns)
        elif self._is_request_due and not self.is_stopped:
            self._is_request_due = False
            frame = self.control.request
        elif head is None:
            self._is_stop_due = False
            frame = self.control.end
        else:
            queues, key = head
            waiting = queues.pop(key)
            first = waiting.popleft()
            if waiting:
                queues[key] = waiting  # to the end of the turn order
            frame = first.frame
            self.slowest_wait_s = max(self.slowest_wait_s, now_s - first.since_s)
            if queues is self._urgent:
                since_s = first.since_s
        if self._encode is not None:
            frame = self._encode(frame)
        if self._uart_bytes_s is not None:
            self._busy_until_s = max(self._busy_until_s, now_s) + len(frame) / self._uart_bytes_s
        return OutgoingFrame(frame, since_s)

    def wait_s(self, now_s: float) -> float | None:
        """Seconds until `pop_frame` returns a frame.

        None: no frame is queued that may be sent while the robot moves.
        """
        size_bytes, spare_bytes = self._time_bytes, 0
        if self.is_stopped or not (self.is_time_due or self._is_request_due):
            head = self._head()
            if head is not None:
                queues, key = head
                size_bytes = len(queues[key][0].frame)
                spare_bytes = 0 if queues is self._urgent else self._control_bytes
            elif self._is_stop_due:
                size_bytes = len(self.control.end)
            else:
                return None
        if self._uart_bytes_s is None:
            return 0.0
        left_bytes = (self._busy_until_s - now_s) * self._uart_bytes_s  # with the frame they must fit into one LOOP_S
        allowed_bytes = max(self._loop_bytes - spare_bytes - size_bytes, 0.0)
        if left_bytes < allowed_bytes + 1:  # a difference below one byte may be rounding, which no clock can wait for
            return 0.0
        return (left_bytes - allowed_bytes) / self._uart_bytes_s

    def oldest_s(self, now_s: float) -> float:
        """Age of the oldest queued frame in seconds; 0 when the queues are empty."""
        queues = (self._urgent, self.answers, self._replies, self._commands)
        every = [waiting for each in queues for waiting in each.values()]
        return max((0.0, *(now_s - one.since_s for waiting in every for one in waiting)))

    def _put(self, queues: _Queues, key: Hashable, new: _QueuedFrame, *, depth: int) -> None:
        waiting = queues.pop(key, None) or deque()
        while len(waiting) >= depth:
            del waiting[int(waiting[0].is_kept)]
            self.replaced += 1
        waiting.append(new)
        queues[key] = waiting
        self._new.append(new)

    def _put_reply(self, name: str, new: _QueuedFrame) -> None:
        count = sum(map(len, self._replies.values()))
        if count >= MAX_REPLIES:
            raise DeviceBusy(name, count)
        self._replies.setdefault(name, deque()).append(new)
        self._new.append(new)

    def _head(self) -> tuple[_Queues, Hashable] | None:
        """Find the queue and key of the next frame."""
        waiting_queues = (self._urgent, self.answers, self._replies, self._commands)
        for queues in waiting_queues[:1] if self.is_stopped else waiting_queues:
            for key, waiting in queues.items():
                if queues is self._urgent or not self._is_delayed(waiting[0]):
                    return queues, key
        return None

    def _is_delayed(self, waiting: _QueuedFrame) -> bool:
        return self.robot_moves and not waiting.is_awaited and len(waiting.frame) > self.prompt_bytes
