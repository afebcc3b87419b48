"""Names, types and quality of service of ROS 2, for both bridges to it. Pure."""

import re
from typing import Final, Literal, NamedTuple

NAME_CHARS_MAX: Final = 255
_NAME: Final = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


def is_ros2_name(name: str) -> bool:
    """Whether ROS 2 allows it as the full name of a topic or service.

    rosserial also allows parts that begin with a digit.
    """
    return len(name) <= NAME_CHARS_MAX and _NAME.fullmatch(name) is not None


class Qos(NamedTuple):
    """Policies of a publisher or a subscription. `depth`: messages that are kept; None: all."""

    is_reliable: bool = True
    is_latched: bool = False  # TRANSIENT_LOCAL
    depth: int | None = 10  # as `ros2 topic pub` and rclpy's examples have it


COMMANDS: Final = Qos(is_reliable=False, depth=1)  # every publisher matches it, and a newer velocity replaces an older

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
