"""The interface of a component, in a hub of a test."""

from collections import Counter

from hostlink.core.host import Host
from hostlink.core.hub.hub import Hub


def host_in(hub: Hub, name: str = "test") -> Host:
    """Make one that runs no tasks."""
    return Host(hub, name, lambda work, _: work.close(), Counter())
