"""Inbox: what a client has sent and the daemon has not done yet; of velocities for one robot the newest alone."""

import base64
import binascii
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from hostlink.api.rosbridge_request import Request
from hostlink.errors import BadPayload
from hostlink.hub.topic_graph import TopicGraph
from hostlink.robot.velocity import Twist

_NUMBERS = frozenset((int, float))  # exactly: JSON's true and false are none
_NONE = (None, False)  # no velocity, or one that is wrong: that is refused, and not replaced


def velocity_of_request(request: Request, topics: TopicGraph) -> tuple[Hashable, bool]:
    """What an operation of rosbridge drives, with its priority (None: nothing), and whether it is a zero."""
    fields = request.fields
    priority = fields.get("priority")
    if not isinstance(priority, int | None):
        return _NONE
    if request.op == "drive":
        robot = fields.get("robot")
        x, y, yaw = fields.get("linear"), fields.get("linear_y", 0), fields.get("angular")
        if not (type(robot) is str and type(x) in _NUMBERS and type(y) in _NUMBERS and type(yaw) in _NUMBERS):
            return _NONE
        return ("drive", robot, priority), not (x or y or yaw)
    name = fields.get("topic")
    topic = topics.find_or_none(name) if request.op == "publish" and isinstance(name, str) else None
    if topic is None or not topic.is_gated:
        return _NONE
    is_zero = _is_zero_message(fields)
    return _NONE if is_zero is None else (("publish", topic.name, priority), is_zero)


def velocity_of_payload(topic_name: str, payload: bytes, topics: TopicGraph) -> tuple[Hashable, bool]:
    """The same of a serialised message."""
    topic = topics.find_or_none(topic_name)
    is_zero = _is_zero_payload(payload) if topic is not None and topic.is_gated else None
    return _NONE if is_zero is None else (("publish", topic_name), is_zero)


def _is_zero_message(fields: dict[str, Any]) -> bool | None:
    """Of a Twist or a TwistStamped, as JSON or, in base64, as bytes; None: it is neither."""
    raw, message = fields.get("raw"), fields.get("msg")
    if raw is not None:
        try:
            return _is_zero_payload(base64.b64decode(raw, validate=True))
        except (TypeError, ValueError, binascii.Error):
            return None
    if not isinstance(message, dict):
        return None
    twist = message.get("twist", message)
    if not isinstance(twist, dict):
        return None
    numbers: list[Any] = []
    for name in ("linear", "angular"):
        vector = twist.get(name, {})
        if not isinstance(vector, dict):
            return None
        numbers += vector.values()
    return not any(numbers) if _NUMBERS.issuperset(map(type, numbers)) else None


def _is_zero_payload(payload: bytes) -> bool | None:
    """Of a serialised Twist; of a TwistStamped the Twist is its end."""
    try:
        return Twist.decode(payload[-len(Twist().encode()) :]).is_zero
    except BadPayload:
        return None


MANY = 64  # messages that one who drives may send while the daemon is busy: more than a second's worth at 50 Hz
MAX_MESSAGES = 256  # that wait here; more wait in the socket
MAX_BYTES = 64 * 1024  # or one message that is larger

Content = TypeVar("Content")


@dataclass(slots=True)
class Operation(Generic[Content]):
    """One message of a client, decoded."""

    content: Content
    came_s: float  # when it came, at the earliest, by the loop's clock
    velocity_of: Hashable = None  # what it drives, with what priority; None: it is no velocity
    is_zero: bool = False
    replaced: list[Content] = field(default_factory=list)  # the velocities in the place of which it is done


class Program(Protocol[Content]):
    """What speaks the client's language. Neither raises what the client has done wrong."""

    def read(self, data: str | bytes, came_s: float) -> Operation[Content]: ...
    def do(self, operation: Operation[Content]) -> None: ...


class Inbox(Generic[Content]):
    """Operations are done in the order in which they came.

    A velocity takes the place of one before it that drives the same robot and that was not done: it stands where the
    newer one came, so that nothing overtakes a stop. A zero takes the place of others, and nothing takes its.
    """

    def __init__(self, program: Program[Content], on_replaced: Callable[[], None]) -> None:
        """`on_replaced` is called for each velocity in the place of which a newer one is done."""
        self._program, self._on_replaced = program, on_replaced
        self._messages: deque[tuple[str | bytes, float]] = deque()  # as they came, not decoded yet
        self._bytes = 0
        self._operations: dict[int, Operation[Content]] = {}  # by number, in their order
        self._velocities: dict[Hashable, int] = {}  # the numbers of those that may be replaced
        self._last_number = 0
        self.is_flooding = False  # too many have waited: they are done after the others' turns, until none is left
        self.has_room = True  # otherwise the rest waits in the socket
        self.is_behind = False  # the next message was there before it was waited for
        self._came_s: float | None = None  # of the newest message; None: there was none

    def __len__(self) -> int:
        return len(self._messages) + len(self._operations)

    def put(self, data: str | bytes, came_s: float) -> None:
        """A message came; one that was there before it was waited for may be as old as the one before it."""
        if self._came_s is None or not self.is_behind:
            self._came_s = came_s
        self._messages.append((data, self._came_s))
        self._bytes += len(data)
        waiting = len(self._messages) + len(self._operations)
        if waiting > MANY:
            self.is_flooding = True
        if waiting > MAX_MESSAGES or self._bytes > MAX_BYTES:
            self.has_room = False

    def note_wait(self) -> None:
        """The next message is not there yet."""
        self.is_behind = False

    def work(self) -> None:
        """Decode all that has come, and do what is next."""
        while self._messages:
            data, came_s = self._messages.popleft()
            self._add(self._program.read(data, came_s))
        number = next(iter(self._operations))
        operation = self._operations.pop(number)
        if operation.velocity_of is not None and self._velocities.get(operation.velocity_of) == number:
            del self._velocities[operation.velocity_of]
        try:
            self._program.do(operation)
        finally:
            if not self._operations:
                self._bytes, self.is_flooding = 0, False
            if len(self._operations) <= MAX_MESSAGES // 2 and (not self._operations or self._bytes <= MAX_BYTES):
                self.has_room = True

    def _add(self, new: Operation[Content]) -> None:
        self._last_number += 1
        if new.velocity_of is not None:
            older = self._velocities.pop(new.velocity_of, None)
            if older is not None:
                gone = self._operations.pop(older)
                new.replaced = [*gone.replaced, gone.content]
                self._on_replaced()
            if not new.is_zero:
                self._velocities[new.velocity_of] = self._last_number
        self._operations[self._last_number] = new
