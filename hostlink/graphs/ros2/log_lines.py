"""Log lines of devices, as lines of ROS 2's log: `hostlink.<device>` on /rosout and on the terminal."""

from collections.abc import Mapping
from typing import Any

from hostlink.client import Host
from hostlink.graphs.ros2.node import Ros2Node

_INFO, _WARN, _ERROR, _FATAL = 2, 4, 8, 16  # of rosgraph_msgs/Log
ROSOUT = "/rosout"


async def relay_log_lines(host: Host, node: Ros2Node) -> None:
    """Until cancelled.

    Raises:
        HostlinkError: there is no connection.
    """
    async with host.subscribe(ROSOUT, type_name="rosgraph_msgs/Log") as lines:
        async for line in lines:
            write(node.node.get_logger(), line)


def write(logger: Any, line: Mapping[str, Any]) -> None:
    """One line, at its level; rclpy allows a place in the code one level only."""
    level, text = line["level"], f"{line['name']}: {line['msg']}"
    if level >= _FATAL:
        logger.fatal(text)
    elif level >= _ERROR:
        logger.error(text)
    elif level >= _WARN:
        logger.warning(text)
    elif level >= _INFO:
        logger.info(text)
    else:
        logger.debug(text)
