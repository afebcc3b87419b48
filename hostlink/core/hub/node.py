"""Node: key of a participant in the graph, as a link is the key of a device."""

from collections.abc import Hashable
from enum import IntEnum


class Role(IntEnum):
    """Permission of a participant. Each includes the one before it."""

    READ = 1  # subscribe, call services that change nothing, stop robots
    DRIVE = 2  # drive robots, publish, provide and call services


class Node:
    """Key of the publishers, subscribers and services of a program, or of a part of the daemon."""

    def __init__(self, name: str, *, is_daemon: bool = False, group: str = "") -> None:
        """Create a key.

        `is_daemon` marks a part of hostlink, whose types and services precede those of programs. `group` is the bridge
        to another graph, such as ROS 2, to which the node belongs; empty if none.
        """
        self.name, self.is_daemon, self.group = name, is_daemon, group
        self.address = ""  # peer address of a program; only the API shows it, no graph and no recording

    def __str__(self) -> str:
        return self.name


def is_of(key: Hashable, group: str) -> bool:
    """Whether a publisher or subscriber belongs to the group. A link or a gate belongs to none."""
    return bool(group) and isinstance(key, Node) and key.group == group


def address_of(key: Hashable) -> str:
    """Return the peer address of a program; empty for others."""
    return key.address if isinstance(key, Node) else ""
