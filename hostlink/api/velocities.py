"""Which messages of clients are velocities: a newer one for the same robot may take the place of one that waits."""

import base64
import binascii
from collections.abc import Hashable
from typing import Any

from hostlink.api.request import Request
from hostlink.errors import BadPayload
from hostlink.hub.topic_graph import TopicGraph
from hostlink.robot.velocity import Twist

_NONE = (None, False)  # no velocity, or one that is wrong: that is refused, and not replaced


def velocity_of_request(request: Request, topics: TopicGraph) -> tuple[Hashable, bool]:
    """What an operation of rosbridge drives, with its priority (None: nothing), and whether it is a zero."""
    fields = request.fields
    priority = fields.get("priority")
    if not isinstance(priority, int | None):
        return _NONE
    if request.op == "drive":
        robot, velocity = fields.get("robot"), (fields.get("linear"), fields.get("angular"), fields.get("linear_y", 0))
        if not (isinstance(robot, str) and all(map(_is_number, velocity))):
            return _NONE
        return ("drive", robot, priority), not any(velocity)
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
    return not any(numbers) if all(map(_is_number, numbers)) else None


def _is_zero_payload(payload: bytes) -> bool | None:
    """Of a serialised Twist; of a TwistStamped the Twist is its end."""
    try:
        return Twist.decode(payload[-len(Twist().encode()) :]).is_zero
    except BadPayload:
        return None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
