"""CommandEndpoint: topic of a board that commands a motion without being a robot's, and its view."""

from typing import NamedTuple

from hostlink.core.robot.views import CommandEndpointView


class CommandEndpoint(NamedTuple):
    """Endpoint that commands a motion and is not a robot's, after a stop or a lock. `topic` is its name in the graph.

    `is_guarded`: it has a gate. `reason`: why it was not sent a zero; empty if it was.
    """

    link: int
    peer: str
    robot: str | None  # of its board
    topic: str
    type_name: str
    is_guarded: bool
    is_locked: bool
    reason: str = ""
    host: str | None = None  # name of its daemon; None for this one


def command_endpoint_view(endpoint: CommandEndpoint) -> CommandEndpointView:
    """Return what became of a topic that is not a robot's after a stop or a lock."""
    return {
        "link": endpoint.link,
        "peer": endpoint.peer,
        "robot": endpoint.robot,
        "topic": endpoint.topic,
        "type": endpoint.type_name,
        "is_guarded": endpoint.is_guarded,
        "is_locked": endpoint.is_locked,
        "is_zero_sent": not endpoint.reason,
        "reason": endpoint.reason,
        "host": endpoint.host,
    }
