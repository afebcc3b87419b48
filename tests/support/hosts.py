"""The interface of a component, in a hub of a test."""

from collections import Counter

from hostlink.core.host import Host
from hostlink.core.hub.hub import Hub


def part_of(hub: Hub, name: str = "gateway") -> Host:
    """Make that of a part of the daemon, whose tasks run as long as the hub."""
    return Host(hub, name, lambda work, part: hub.spawn(work, name=part), Counter())


def host_in(hub: Hub, name: str = "test") -> Host:
    """Make one that runs no tasks."""
    return Host(hub, name, lambda work, _: work.close(), Counter())
