"""Types as the client takes them: names, and classes of ROS 1, ROS 2 and rosbags."""

import pytest
from rosbags.typesys import Stores, get_typestore

from hostlink.client.type_names import type_name_of
from hostlink.errors import BadRequest


class GenpyString:
    """A message as genpy writes it."""

    _type = "std_msgs/String"


class SetBool:
    """A service as rosidl writes it."""

    __module__ = "std_srvs.srv._set_bool"


@pytest.mark.parametrize(
    ("type_", "name"),
    [
        ("", ""),
        ("std_msgs/String", "std_msgs/String"),
        ("std_msgs/msg/String", "std_msgs/msg/String"),
        (GenpyString, "std_msgs/String"),
        (SetBool, "std_srvs/srv/SetBool"),
        (get_typestore(Stores.ROS1_NOETIC).types["std_msgs/msg/String"], "std_msgs/msg/String"),
    ],
)
def test_type_is_a_name_or_a_class_of_messages(type_: str | type, name: str) -> None:
    assert type_name_of(type_) == name


@pytest.mark.parametrize("type_", ["String", "/String/", dict, GenpyString().__dict__, None, {"data": "hello"}])
def test_anything_else_as_a_type_is_refused_with_an_example(type_: object) -> None:
    with pytest.raises(BadRequest, match="as in 'std_msgs/String'"):
        type_name_of(type_)  # type: ignore[arg-type]
