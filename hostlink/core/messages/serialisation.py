"""Serialisations of messages, by their names in MCAP and in Foxglove's protocol.

The hub carries messages of a type with a definition as ROS1. Those of another type pass as their device's protocol has
them, and the topic says which of the two that is (`Topic.encoding`).
"""

from typing import Final

ROS1: Final = "ros1"  # of rosserial and ROS 1
CDR: Final = "cdr"  # of ROS 2 and micro-ROS, with its encapsulation
