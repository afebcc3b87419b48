"""Participants of a hub, as tests have them: they stay until the hub ends."""

from collections.abc import Callable, Mapping

from hostlink.hub.hub import Hub
from hostlink.hub.message import PROGRAM_PRIORITY, Message
from hostlink.hub.subscription import Subscription


def publish(
    hub: Hub,
    topic: str,
    message: Mapping[str, object] | bytes,
    *,
    source: str = "test",
    type_name: str = "",
    priority: int = PROGRAM_PRIORITY,
) -> None:
    """Publish once, as whoever has this name."""
    participant = hub.join(source)
    type_ = participant.message_type(topic, type_name)
    payload = message if isinstance(message, bytes) else type_.encode(message)
    participant.publish(topic, payload, priority=priority)


def subscribe(hub: Hub, topic: str, receive: Callable[[Message], None], *, name: str = "test") -> Subscription:
    """Subscribe, as whoever has this name."""
    return hub.join(name).subscribe(topic, receive)
