"""Conversion of serialised messages: ROS 1's bytes, which the daemon has, and ROS 2's CDR. Pure; rosbags converts."""

from collections.abc import Mapping
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore

from hostlink.errors import BadPayload
from hostlink.graphs.ros2.layout import Fields

_STAMP = slice(4, 12)  # behind the head of CDR: the seconds and nanoseconds of a header that comes first
HEADER = "std_msgs/msg/Header"


class Conversion:
    """Of the types that were added, by their ROS 2 names."""

    def __init__(self) -> None:
        self._store = get_typestore(Stores.EMPTY)
        self._added: dict[str, bytes] = {}  # zeros that ROS 2 has behind ROS 1's fields

    def add(self, types: Mapping[str, Fields], type_name: str = "", *, added_bytes: int = 0) -> None:
        """Learn types; one that is known already stays. `type_name` has so many bytes more in ROS 2 than in ROS 1."""
        if added_bytes:
            self._added[type_name] = bytes(added_bytes)
        known = self._store.fielddefs
        new: Any = {name: ([], list(fields.items())) for name, fields in types.items() if name not in known}
        if new:
            self._store.register(new)

    def to_cdr(self, payload: bytes, type_name: str) -> bytes:
        """ROS 1's bytes as CDR.

        Raises:
            BadPayload: they are no message of the type.
        """
        try:
            return bytes(self._store.ros1_to_cdr(payload + self._added.get(type_name, b""), type_name))
        except (SerdeError, IndexError) as error:
            raise BadPayload(type_name, str(error)) from error

    def to_ros1(self, data: bytes, type_name: str) -> bytes:
        """CDR as ROS 1's bytes; a header's `seq` is 0.

        Raises:
            BadPayload: it is no message of the type.
        """
        try:
            payload = bytes(self._store.cdr_to_ros1(data, type_name))
        except (SerdeError, IndexError) as error:
            raise BadPayload(type_name, str(error)) from error
        return payload[: len(payload) - len(self._added.get(type_name, b""))]

    def begins_with_header(self, type_name: str) -> bool:
        """Whether the first field is a header."""
        fields = self._store.fielddefs[type_name][1]
        return bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)


def stamped(data: bytes, stamp: bytes) -> bytes:
    """CDR that begins with a header, with another stamp: its eight bytes, little-endian."""
    return data[: _STAMP.start] + stamp + data[_STAMP.stop :]
