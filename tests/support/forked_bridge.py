"""`hostlink ros2` for fork_parent.py: rclpy and the bridge are imported."""

import rclpy
import rclpy.executors

from hostlink.cli import ros2
from hostlink.cli.main import main
from hostlink.components.ros2 import bridge, node

IMPORTED = (rclpy, ros2, bridge, node)
__all__ = ["main"]
