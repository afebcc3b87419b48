"""Names of topics, services and types in ROS 2 and on DDS, for the bridges to ROS 2 and for boards of micro-ROS."""

import re
from enum import StrEnum
from typing import Final, Literal, NamedTuple

NAME_CHARS_MAX: Final = 255
_NAME: Final = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


def is_ros2_name(name: str) -> bool:
    """Whether ROS 2 allows it as the full name of a topic or service.

    rosserial also allows parts that begin with a digit.
    """
    return len(name) <= NAME_CHARS_MAX and _NAME.fullmatch(name) is not None


# -- types ------------------------------------------------------------------------------------------------------------

_RENAMED: Final = {  # ROS 1's name -> ROS 2's, where it is not "pkg/msg/Type"
    "tf/tfMessage": "tf2_msgs/msg/TFMessage",
    "std_msgs/Time": "builtin_interfaces/msg/Time",
    "std_msgs/Duration": "builtin_interfaces/msg/Duration",
    "rosgraph_msgs/Log": "rcl_interfaces/msg/Log",
}
_ROS1_NAMES: Final = {ros2: ros1 for ros1, ros2 in _RENAMED.items() if ros1 != "tf/tfMessage"}
_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]*)")
_DDS_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Za-z][A-Za-z0-9_]*)_")


def ros2_type(type_name: str, kind: Literal["msg", "srv"] = "msg") -> str:
    """Convert "std_msgs/String" to "std_msgs/msg/String". Some types have other names in ROS 2."""
    package, _, name = type_name.partition("/")
    return _RENAMED.get(type_name, f"{package}/{kind}/{name}")


def ros1_type(type_name: str) -> str:
    """Convert "std_msgs/msg/String" to "std_msgs/String", also for services."""
    package, _, rest = type_name.partition("/")
    return _ROS1_NAMES.get(type_name, f"{package}/{rest.rpartition('/')[2]}")


def to_dds_type(type_name: str) -> str:
    """ "std_msgs/msg/String" -> "std_msgs::msg::dds_::String_".

    Raises:
        ValueError: it is not a type name of ROS 2.
    """
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise ValueError(f"{type_name!r} is not a type name of ROS 2, such as std_msgs/msg/String")
    package, kind, name = match.groups()
    return f"{package}::{kind}::dds_::{name}_"


def from_dds_type(dds_type: str) -> str | None:
    """ "std_msgs::msg::dds_::String_" -> "std_msgs/msg/String"; None if it is malformed."""
    match = _DDS_TYPE.fullmatch(dds_type)
    return None if match is None else "/".join(match.groups())


# -- endpoints --------------------------------------------------------------------------------------------------------


class DdsKind(StrEnum):
    """Kind of a topic of DDS. The value begins the topic's name."""

    MESSAGES = "rt"
    REQUESTS = "rq"
    RESPONSES = "rr"


_TOPIC_SUFFIXES: Final = {DdsKind.MESSAGES: "", DdsKind.REQUESTS: "Request", DdsKind.RESPONSES: "Reply"}
_TYPE_SUFFIXES: Final = {
    DdsKind.MESSAGES: "",
    DdsKind.REQUESTS: "_Request",
    DdsKind.RESPONSES: "_Response",
}


class DdsEndpoint(NamedTuple):
    """A topic, or one half of a service, by its names in ROS 1."""

    kind: DdsKind
    name: str  # "/cmd_vel"
    type_name: str  # "geometry_msgs/Twist"; of a service, that of the whole

    @property
    def dds_topic(self) -> str:
        """The name on DDS, such as "rt/cmd_vel" or "rq/addRequest"."""
        return f"{self.kind.value}{self.name}{_TOPIC_SUFFIXES[self.kind]}"

    @property
    def dds_type(self) -> str:
        """The type on DDS, such as "geometry_msgs::msg::dds_::Twist_".

        Raises:
            ValueError: the type has no name in ROS 2, such as one whose package begins with a capital.
        """
        kind: Literal["msg", "srv"] = "msg" if self.kind is DdsKind.MESSAGES else "srv"
        return to_dds_type(ros2_type(self.type_name, kind) + _TYPE_SUFFIXES[self.kind])


def dds_endpoint(dds_topic: str, dds_type: str) -> DdsEndpoint | None:
    """Return the endpoint of that name and type on DDS; None if they are not those of a topic or service of ROS 2.

    The types that an action defines are neither.
    """
    kind = next((kind for kind in DdsKind if dds_topic.startswith(f"{kind.value}/")), None)
    type_name = from_dds_type(dds_type)
    if kind is None or type_name is None:
        return None
    topic_suffix, type_suffix = _TOPIC_SUFFIXES[kind], _TYPE_SUFFIXES[kind]
    wanted = "msg" if kind is DdsKind.MESSAGES else "srv"
    if not dds_topic.endswith(topic_suffix) or not type_name.endswith(type_suffix):
        return None
    name = dds_topic.removeprefix(kind.value).removesuffix(topic_suffix)
    if f"/{wanted}/" not in type_name or not is_ros2_name(name):
        return None
    return DdsEndpoint(kind, name, ros1_type(type_name.removesuffix(type_suffix)))
