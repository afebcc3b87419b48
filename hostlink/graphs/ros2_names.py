"""Names of message and service types in ROS 1 and in ROS 2. Pure."""

from typing import Final, Literal

_RENAMED: Final = {  # ROS 1's name -> ROS 2's, where it is not "pkg/msg/Type"
    "tf/tfMessage": "tf2_msgs/msg/TFMessage",
    "std_msgs/Time": "builtin_interfaces/msg/Time",
    "std_msgs/Duration": "builtin_interfaces/msg/Duration",
    "rosgraph_msgs/Log": "rcl_interfaces/msg/Log",
}
_ROS1_NAMES: Final = {ros2: ros1 for ros1, ros2 in _RENAMED.items() if ros1 != "tf/tfMessage"}


def ros2_type(type_name: str, kind: Literal["msg", "srv"] = "msg") -> str:
    """Convert "std_msgs/String" to "std_msgs/msg/String". Some types have other names in ROS 2."""
    package, _, name = type_name.partition("/")
    return _RENAMED.get(type_name, f"{package}/{kind}/{name}")


def ros1_type(type_name: str) -> str:
    """Convert "std_msgs/msg/String" to "std_msgs/String", also for services."""
    package, _, rest = type_name.partition("/")
    return _ROS1_NAMES.get(type_name, f"{package}/{rest.rpartition('/')[2]}")
