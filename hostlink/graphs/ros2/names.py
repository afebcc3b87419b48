"""Names and types of the daemon's graph as ROS 2 has them, and back. Pure."""

import re

GLOBAL = frozenset({"/tf", "/tf_static", "/clock", "/diagnostics"})  # one for all namespaces, as in ROS 2
_TOKENS = re.compile(r"(/?[A-Za-z_][A-Za-z0-9_]*)(/[A-Za-z_][A-Za-z0-9_]*)*")
_MOVED = {  # ROS 1's messages that have another name in ROS 2
    "std_msgs/Duration": "builtin_interfaces/msg/Duration",
    "std_msgs/Time": "builtin_interfaces/msg/Time",
    "tf/tfMessage": "tf2_msgs/msg/TFMessage",
}
_PARTS = 3  # package, msg or srv, name


def ros2_name(name: str) -> str:
    """The name of a topic or service for rclpy: relative, so that the node's namespace and remappings count."""
    return name if name in GLOBAL else name.removeprefix("/")


def is_ros2_name(name: str) -> bool:
    """Whether ROS 2 allows it: rosserial also allows parts that begin with a digit, ROS 2 does not."""
    return _TOKENS.fullmatch(name) is not None


def ros2_type(type_name: str, kind: str = "msg") -> str:
    """`geometry_msgs/Twist` as `geometry_msgs/msg/Twist`; `kind` is `msg` or `srv`."""
    package, _, name = type_name.rpartition("/")
    return _MOVED.get(type_name, f"{package}/{kind}/{name}")


def ros1_type(type_name: str) -> str:
    """`geometry_msgs/msg/Twist` as `geometry_msgs/Twist`."""
    moved = next((old for old, new in _MOVED.items() if new == type_name and old.startswith("std_msgs")), None)
    parts = type_name.split("/")
    return moved or (f"{parts[0]}/{parts[2]}" if len(parts) == _PARTS else type_name)


def parameter_name(name: str) -> str:
    """`/robot_0/gain` as a parameter of the node: `robot_0.gain`."""
    return name.strip("/").replace("/", ".")
