"""Node: whatever has a place in the graph without being a device."""

from collections.abc import Hashable
from enum import IntEnum


class Role(IntEnum):
    """What a participant may do; each allows what is before it."""

    READ = 1  # subscribe, call services that change nothing, and stop robots
    DRIVE = 2  # and drive them, publish, serve, call services


class Node:
    """The key of what a program, or a part of the daemon, publishes, subscribes and serves."""

    def __init__(self, name: str, *, is_daemon: bool = False, group: str = "") -> None:
        """Make a key.

        `is_daemon`: a part of hostlink itself, whose types and services precede those of programs. `group`: the bridge
        to another graph, as ROS 2, of which it is a part; empty: none.
        """
        self.name, self.is_daemon, self.group = name, is_daemon, group
        self.address = ""  # from which it connects, for readers of the API alone: no graph and no recording has it

    def __str__(self) -> str:
        return self.name


def is_of(key: Hashable, group: str) -> bool:
    """Whether a source, or a subscriber, belongs to the group; a link or a gate belongs to none."""
    return bool(group) and isinstance(key, Node) and key.group == group


def address_of(key: Hashable) -> str:
    """From which it connects; empty: it is no program, or a part of the daemon."""
    return key.address if isinstance(key, Node) else ""
