"""Names of ROS 2 and of rmw_zenoh: types, keys of data, and what may be a topic. Pure.

The formats are those of docs/ros2-zenoh.md#on-the-wire.
"""

import re
from typing import Final

NAME_CHARS_MAX: Final = 255
DOMAIN_MAX: Final = 232

_NAME: Final = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")
_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)/(msg|srv|action)/([A-Za-z][A-Za-z0-9_]*)")
_DDS_TYPE: Final = re.compile(r"([a-z][a-z0-9_]*)::(msg|srv|action)::dds_::([A-Za-z][A-Za-z0-9_]*)_")


def is_name(name: str) -> bool:
    """Whether ROS 2 allows it as the full name of a topic or service."""
    return len(name) <= NAME_CHARS_MAX and _NAME.fullmatch(name) is not None


def is_hidden(name: str) -> bool:
    """Whether a part of it begins with an underscore, as those of actions do; the tools of ROS 2 do not list it."""
    return "/_" in name


def to_dds_type(type_name: str) -> str:
    """ "std_msgs/msg/String" -> "std_msgs::msg::dds_::String_".

    Raises:
        ValueError: it is no type name of ROS 2.
    """
    match = _TYPE.fullmatch(type_name)
    if match is None:
        raise ValueError(f"{type_name!r} is no type of ROS 2, as std_msgs/msg/String is")
    package, kind, name = match.groups()
    return f"{package}::{kind}::dds_::{name}_"


def from_dds_type(dds_type: str) -> str | None:
    """ "std_msgs::msg::dds_::String_" -> "std_msgs/msg/String"; None: it is none."""
    match = _DDS_TYPE.fullmatch(dds_type)
    return None if match is None else "/".join(match.groups())


def mangle(name: str) -> str:
    """One part of a key for a name with slashes; Zenoh splits keys at them. Nothing and "/" become "%"."""
    return name.replace("/", "%") or "%"


def demangle(part: str) -> str:
    """The name that `mangle` changed."""
    return part.replace("%", "/")


def data_key(domain: int, name: str, type_name: str, type_hash: str) -> str:
    """The key on which the messages of a topic, or the requests of a service, are sent.

    Raises:
        ValueError: `type_name` is no type name of ROS 2.
    """
    return f"{domain}/{name.strip('/')}/{to_dds_type(type_name)}/{type_hash}"
