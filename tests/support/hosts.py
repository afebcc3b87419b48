"""The interface of a component, in a hub of a test."""

from collections import Counter

from hostlink.core.host import Host
from hostlink.core.hub.hub import Hub


def host_in(hub: Hub, name: str = "test") -> Host:
    """Make one that runs no tasks."""
    return Host(hub, name, lambda work, _: work.close(), Counter())


def working_host(hub: Hub, name: str = "test") -> Host:
    """Make one whose tasks the hub runs. A failure ends only its task."""
    return Host(hub, name, lambda work, part: hub.spawn(work, name=part), Counter())
