"""Values: messages of rclpy and the daemon's JSON. Pure: whatever has rclpy's field names and types will do."""

import array
import base64
import math
from collections.abc import Mapping, Sequence
from typing import Any

from hostlink.errors import HostlinkError

_TIMES = {"sec": "secs", "nanosec": "nsecs"}
_BYTE_TYPES = ("uint8", "octet", "char")


def to_json(message: Any) -> dict[str, Any]:
    """The fields of a message, as the daemon reads them."""
    fields = message.get_fields_and_field_types()
    if list(fields) == list(_TIMES):
        return {_TIMES[name]: getattr(message, name) for name in fields}
    return {name: _value_to_json(getattr(message, name)) for name in fields}


def _value_to_json(value: Any) -> Any:
    if hasattr(value, "get_fields_and_field_types"):
        return to_json(value)
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else base64.b64encode(value).decode()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, str | bool | int):
        return value
    if isinstance(value, array.array) and value.typecode == "B":
        return base64.b64encode(value.tobytes()).decode()
    items = value.tolist() if hasattr(value, "tolist") else value
    return [_value_to_json(item) for item in items]


def fill(message: Any, values: Mapping[str, Any]) -> None:
    """Set the fields of a message of rclpy; what is missing stays as it is, and ROS 1's `seq` is left out.

    Raises:
        HostlinkError: a value does not fit its field.
    """
    for name, type_name in message.get_fields_and_field_types().items():
        key = _TIMES.get(name, name) if name not in values else name
        if key in values:
            try:
                setattr(message, name, _value_of(getattr(message, name), type_name, values[key]))
            except (AssertionError, TypeError, ValueError, KeyError) as error:  # rclpy asserts the types of fields
                raise HostlinkError(f"{name}: {values[key]!r} is no {type_name}") from error


def _value_of(before: Any, type_name: str, value: Any) -> Any:
    if hasattr(before, "get_fields_and_field_types"):
        fill(before, value)
        return before
    if type_name in ("float", "double"):
        return math.nan if value is None else float(value)
    if type_name == "octet":
        return bytes([value])
    if isinstance(before, str | bool | int):
        return value
    return _items(before, type_name, value)


def _items(before: Any, type_name: str, value: Any) -> Sequence[Any]:
    item_type = type_name.removeprefix("sequence<").partition(">")[0].partition(",")[0].partition("[")[0]
    if item_type in _BYTE_TYPES and isinstance(value, str):
        value = list(base64.b64decode(value))
    if item_type in ("float", "double"):
        return [math.nan if item is None else float(item) for item in value]
    if item_type == "octet":
        return [bytes([item]) for item in value]
    if "/" in item_type:
        raise HostlinkError(f"a list of {item_type} in a service, which is not converted")
    del before
    return list(value)
