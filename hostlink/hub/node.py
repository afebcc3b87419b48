"""Node: whatever has a place in the graph without being a device."""

from enum import IntEnum


class Role(IntEnum):
    """What a participant may do; each allows what is before it."""

    READ = 1  # subscribe, call services that change nothing, and stop robots
    DRIVE = 2  # and drive them, publish, serve, call services


class Node:
    """The key of what a program, or a part of the daemon, publishes, subscribes and serves."""

    def __init__(self, name: str, *, is_daemon: bool = False, group: str = "") -> None:
        """Make a key.

        `is_daemon`: a part of hostlink itself, whose types and services precede those of programs. `group`: the foreign
        graph for which it stands, with others; empty: none.
        """
        self.name, self.is_daemon, self.group = name, is_daemon, group

    def __str__(self) -> str:
        return self.name
