"""SimTime: the stamps of messages where the node has `use_sim_time`; the daemon's are this computer's time."""

import struct

from hostlink.graphs.ros2.node import Ros2Node

_STAMP = struct.Struct("<iI")


class SimTime:
    """`update` it now and then: a parameter of the node decides."""

    def __init__(self, node: Ros2Node) -> None:
        self._node = node.node
        self._is_used = False

    def update(self) -> None:
        """Read the parameter."""
        self._is_used = bool(self._node.get_parameter("use_sim_time").value)

    def stamp(self) -> bytes:
        """The time of /clock, as CDR has it; empty without `use_sim_time`."""
        if not self._is_used:
            return b""
        now = self._node.get_clock().now().to_msg()
        return _STAMP.pack(now.sec, now.nanosec)
