"""Requests and responses of services: rclpy's objects and the daemon's JSON."""

import array
import math
from typing import Any, ClassVar

import numpy as np
import pytest

from hostlink.components.ros2.conversion import fill, to_json
from hostlink.errors import HostlinkError


class Message:
    """Has what a class of rclpy has: fields with types, and assertions of them."""

    types: ClassVar[dict[str, str]] = {}

    def __init__(self, **values: Any) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def get_fields_and_field_types(self) -> dict[str, str]:
        return self.types

    def __setattr__(self, name: str, value: Any) -> None:
        before = getattr(self, name)
        if not isinstance(before, list | array.array | np.ndarray):
            assert isinstance(value, type(before)), (name, value)
        object.__setattr__(self, name, value)


class Time(Message):
    types: ClassVar = {"sec": "int32", "nanosec": "uint32"}


class Header(Message):
    types: ClassVar = {"stamp": "builtin_interfaces/Time", "frame_id": "string"}


class Everything(Message):
    types: ClassVar = {
        "header": "std_msgs/Header",
        "success": "boolean",
        "count": "int64",
        "ratio": "double",
        "octet": "octet",
        "data": "sequence<uint8>",
        "ranges": "sequence<float>",
        "covariance": "double[4]",
        "names": "sequence<string>",
    }


def everything() -> Everything:
    return Everything(
        header=Header(stamp=Time(sec=1, nanosec=2), frame_id="a"),
        success=True,
        count=2**60,
        ratio=0.5,
        octet=b"\x07",
        data=array.array("B", b"\x01\x02"),
        ranges=array.array("f", [1.0, math.inf]),
        covariance=np.array([1.0, 2.0, 3.0, 4.0]),
        names=["x"],
    )


JSON = {
    "header": {"stamp": {"secs": 1, "nsecs": 2}, "frame_id": "a"},
    "success": True,
    "count": 2**60,
    "ratio": 0.5,
    "octet": 7,
    "data": "AQI=",
    "ranges": [1.0, None],
    "covariance": [1.0, 2.0, 3.0, 4.0],
    "names": ["x"],
}


def test_a_message_is_json_as_the_daemon_has_it() -> None:
    assert to_json(everything()) == JSON


def test_json_fills_a_message_and_seq_is_left_out() -> None:
    message: Any = everything()
    given = {
        **JSON,
        "header": {"seq": 9, "stamp": {"secs": 5, "nsecs": 6}, "frame_id": "b"},
        "data": "/w==",
        "ratio": 2,
    }
    fill(message, given)
    assert (message.header.stamp.sec, message.header.stamp.nanosec, message.header.frame_id) == (5, 6, "b")
    assert (list(message.data), message.ratio, message.octet) == ([255], 2.0, b"\x07")


def test_missing_value_leaves_the_field() -> None:
    message: Any = everything()
    fill(message, {"success": False})
    assert (message.success, message.count) == (False, 2**60)


@pytest.mark.parametrize("given", [{"success": "yes"}, {"count": "x"}, {"ratio": "x"}, {"octet": 256}, {"names": 3}])
def test_value_of_another_type_is_named(given: dict[str, Any]) -> None:
    with pytest.raises(HostlinkError, match=next(iter(given))):
        fill(everything(), given)
