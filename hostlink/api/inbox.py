"""Inbox: operations that a client has sent and that are not executed yet; for each robot only the newest velocity."""

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

_NUMBERS = frozenset((int, float))  # exact types: JSON's true and false are not numbers
_NONE = (None, False)  # not a velocity, or an invalid one, which is refused and not replaced


def velocity_of_request(request: Request, topics: TopicGraph) -> tuple[Hashable, bool]:
    """Return the key of a velocity (None: not a velocity) and whether it is zero. The key has robot and priority."""
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
    """Return the same for a serialised message: the key of a velocity, and whether it is zero."""
    topic = topics.find_or_none(topic_name)
    is_zero = _is_zero_payload(payload) if topic is not None and topic.is_gated else None
    return _NONE if is_zero is None else (("publish", topic_name), is_zero)


def _is_zero_message(fields: dict[str, Any]) -> bool | None:
    """Whether a Twist or a TwistStamped (JSON, or bytes in base64) is zero; None for another message."""
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
    """Whether a serialised Twist, or the Twist at the end of a TwistStamped, is zero; None for other bytes."""
    try:
        return Twist.decode(payload[-len(Twist().encode()) :]).is_zero
    except BadPayload:
        return None


MANY = 64  # messages of one client while the loop is busy: more than a second of commands at 50 Hz
MAX_MESSAGES = 256  # decoded or not; more wait in the socket
MAX_BYTES = 64 * 1024  # or one larger message

Content = TypeVar("Content")


@dataclass(slots=True)
class Operation(Generic[Content]):
    """One decoded message of a client."""

    content: Content
    came_s: float  # earliest time of arrival by the loop's clock
    velocity_of: Hashable = None  # robot or topic, and priority; None: not a velocity
    is_zero: bool = False
    replaced: list[Content] = field(default_factory=list)  # velocities that this one replaces


class Program(Protocol[Content]):
    """Protocol of a client. Errors of the client are never raised."""

    def read(self, data: str | bytes, came_s: float) -> Operation[Content]: ...
    def do(self, operation: Operation[Content]) -> None: ...


class Inbox(Generic[Content]):
    """Operations of one client, executed in their order of arrival.

    A velocity replaces a pending one of the same robot and priority. It is executed at the newer one's place, so that
    it does not overtake a stop. A zero replaces other velocities and is never replaced.
    """

    def __init__(self, program: Program[Content], on_replaced: Callable[[], None]) -> None:
        """Create an empty inbox. `on_replaced` is called for each replaced velocity."""
        self._program, self._on_replaced = program, on_replaced
        self._messages: deque[tuple[str | bytes, float]] = deque()  # in order of arrival, not decoded
        self._bytes = 0
        self._operations: dict[int, Operation[Content]] = {}  # by number, in order of arrival
        self._velocities: dict[Hashable, int] = {}  # numbers of velocities that may be replaced
        self._last_number = 0
        self.is_flooding = False  # more than MANY wait: executed after other clients' turns until none waits
        self.has_room = True  # otherwise the rest waits in the socket
        self.is_behind = False  # whether the next message was available before it was waited for
        self._came_s: float | None = None  # of the newest message; None: none yet

    def __len__(self) -> int:
        return len(self._messages) + len(self._operations)

    def put(self, data: str | bytes, came_s: float) -> None:
        """Add a message. One that was available without waiting may be as old as the message before it."""
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
        """Note that the next message is not available yet."""
        self.is_behind = False

    def work(self) -> None:
        """Decode all messages, and execute the next operation."""
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
