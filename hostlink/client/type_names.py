"""Type of a topic or service, as `publish`, `subscribe`, `advertise` and `serve` take it: a name or a class."""

from typing import Any

from hostlink.errors import BadRequest

TypeName = str | type[Any]  # "std_msgs/String", "std_msgs/msg/String", or a class of genpy, rclpy or rosbags

_NAMES = ("_type", "__msgtype__")  # of genpy and of rosbags
_ROS2_FOLDERS = ("msg", "srv")


def type_name_of(type_: TypeName) -> str:
    """Return the ROS name of a type; empty for the empty name.

    Raises:
        BadRequest: it is neither a name nor a class of messages or services.
    """
    if isinstance(type_, str):
        if type_ and "/" not in type_.strip("/"):
            raise BadRequest(f"{type_!r} is not a type; pass its name with its package, as in 'std_msgs/String'")
        return type_
    for attribute in _NAMES:
        if isinstance(name := getattr(type_, attribute, None), str):
            return name
    package, *folders = str(getattr(type_, "__module__", "")).split(".")
    if isinstance(type_, type) and folders[:1] and folders[0] in _ROS2_FOLDERS:
        return f"{package}/{folders[0]}/{type_.__name__}"
    raise BadRequest(f"{type_!r} is not a type of ROS; pass a name, as in 'std_msgs/String', or a message class")
