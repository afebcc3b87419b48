"""Quality of service: what the bridge offers and requests, so that what ROS 2 users expect matches. Pure."""

from collections.abc import Iterable
from typing import NamedTuple

DEPTH = 10  # as `ros2 topic pub` and rclpy's examples have it
COMMAND_DEPTH = 1  # an older velocity means nothing beside a newer one
STATIC_DEPTH = 100  # transforms of other nodes that never change: each is sent once


class Qos(NamedTuple):
    """The policies that decide whether two ends match."""

    is_reliable: bool
    is_latched: bool  # TRANSIENT_LOCAL
    depth: int = DEPTH


COMMAND = Qos(is_reliable=False, is_latched=False, depth=COMMAND_DEPTH)  # every publisher matches it


def publisher_qos(topic: str, *, is_latched: bool) -> Qos:
    """Reliable: a best-effort publisher reaches no subscription with default policies, and only a warning says so."""
    is_static = topic == "/tf_static"
    return Qos(is_reliable=True, is_latched=is_latched or is_static, depth=STATIC_DEPTH if is_static else DEPTH)


def subscription_qos(offers: Iterable[Qos]) -> Qos:
    """What matches every publisher of the topic, and loses no more than they allow."""
    offers = list(offers)
    is_latched = bool(offers) and all(offer.is_latched for offer in offers)
    is_reliable = bool(offers) and all(offer.is_reliable for offer in offers)
    return Qos(is_reliable, is_latched, STATIC_DEPTH if is_latched else DEPTH)
