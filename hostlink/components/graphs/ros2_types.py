"""Types of ROS 2: names, hashes and payloads of the types that the catalog has by their ROS 1 definitions.

A distribution's own definition has precedence: its fields may differ (Range has one more). A type that it does not
have, such as a user's own, has the catalog's fields, with names in lower case as ROS 2 demands.
"""

import struct
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final, Literal

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.base import normalize_fieldname

from hostlink.components.graphs.wire_layout import PLACEHOLDER, ros1_layout, ros2_layout
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import Cdr
from hostlink.core.messages.fields import SCALAR, VARIABLE, Field
from hostlink.core.messages.message_type import MessageType
from hostlink.core.messages.ros2_names import ros2_type
from hostlink.errors import BadPayload

Distribution = Literal["humble", "iron", "jazzy", "kilted", "lyrical"]

NO_HASH: Final = "TypeHashNotSupported"  # what Humble has instead of hashes
SEQUENCE_MAX: Final = 1024 * 1024  # elements of one field

_STORES: Final[Mapping[Distribution, Stores]] = {
    "humble": Stores.ROS2_HUMBLE,
    "iron": Stores.ROS2_IRON,
    "jazzy": Stores.ROS2_JAZZY,
    "kilted": Stores.ROS2_KILTED,
    "lyrical": Stores.LATEST,
}
_LOG: Final = "rcl_interfaces/msg/Log"
_LOG_LEVELS: Final = {1: 10, 2: 20, 4: 30, 8: 40, 16: 50}  # ROS 1's are bits
_NESTED: Final = {"time": "builtin_interfaces/msg/Time", "duration": "builtin_interfaces/msg/Duration"}
_EMPTY: Final = (PLACEHOLDER, (Nodetype.BASE, ("uint8", 0)))
_SHADOW: Final = "hostlink_ros1/msg/"  # the catalog's fields of a type that ROS 2 has with others
_MALFORMED: Final = (SerdeError, ArithmeticError, AssertionError, LookupError, TypeError, ValueError, struct.error)

Convert = Callable[[bytes], bytes | memoryview]
_Desc = Any  # rosbags' description of a field, a nested tuple


class Ros2Message:
    """One message type, as ROS 2 has it."""

    def __init__(self, name: str, type_hash: str, to_cdr: Convert, from_cdr: Convert, *, is_flat: bool) -> None:
        """`to_cdr` and `from_cdr` may raise any of _MALFORMED for a malformed payload.

        `is_flat`: it has no list of messages or texts, so that a long one costs little more than a short one.
        """
        self.name, self.type_hash, self.is_flat = name, type_hash, is_flat
        self._to_cdr, self._from_cdr = to_cdr, from_cdr

    def to_cdr(self, payload: bytes) -> bytes:
        """Convert a payload of ROS 1 and rosserial to CDR.

        Raises:
            BadPayload: it is not a message of this type.
        """
        return self._converted(self._to_cdr, payload)

    def from_cdr(self, data: bytes) -> bytes:
        """Convert CDR to a payload of ROS 1, without fields that only ROS 2 has.

        Raises:
            BadPayload: it is not a message of this type.
        """
        return self._converted(self._from_cdr, data)

    def _converted(self, convert: Convert, data: bytes) -> bytes:
        try:
            return bytes(convert(data))
        except _MALFORMED as error:
            raise BadPayload(self.name, str(error) or type(error).__name__) from None


class Ros2Service:
    """One service type; its hash covers both messages."""

    def __init__(self, name: str, type_hash: str, request: Ros2Message, response: Ros2Message) -> None:
        self.name, self.type_hash = name, type_hash
        self.request, self.response = request, response


class Ros2Types:
    """Types by their ROS 1 names, each built once."""

    def __init__(self, catalog: Catalog, distribution: Distribution) -> None:
        """`distribution`: whose definitions and hashes are used; most types have the same in all."""
        self._catalog = catalog
        self._has_hashes = distribution != "humble"
        self._store = get_typestore(_STORES[distribution])
        self._store.max_sequence_length = SEQUENCE_MAX
        for name, (constants, fields) in self._store.fielddefs.items():  # rosbags hashes a char as a char
            self._store.fielddefs[name] = (constants, [(each, _without_char(desc)) for each, desc in fields])
        self._messages: dict[str, Ros2Message | None] = {}
        self._services: dict[str, Ros2Service | None] = {}

    def message(self, name: str) -> Ros2Message | None:
        """The message type of that ROS 1 name; None: it has no definition."""
        if name not in self._messages:
            known = self._catalog.message(name)
            self._messages[name] = None if known is None else self._build(known, ros2_type(known.name))
        return self._messages[name]

    def service(self, name: str) -> Ros2Service | None:
        """The service type of that ROS 1 name; None: it has no definition."""
        if name not in self._services:
            self._services[name] = self._build_service(name)
        return self._services[name]

    # -- building -----------------------------------------------------------------------------------------------------

    def _build(self, known: MessageType, name: str) -> Ros2Message:
        store = self._store
        if name not in store.fielddefs:
            self._register(known, name)
        type_hash = store.hash_rihs01(name) if self._has_hashes else NO_HASH
        if self._is_same_on_wire(known, name):
            cdr = Cdr(known)
            to_cdr: Convert = partial(cdr.from_ros1, is_encapsulated=True)
            from_cdr: Convert = partial(cdr.to_ros1, is_encapsulated=True)
        else:
            shadow = f"{_SHADOW}{known.name.replace('/', '_')}"
            if shadow not in store.fielddefs:
                self._register(known, shadow)
            to_cdr = partial(self._to_other, shadow=shadow, name=name)
            from_cdr = partial(self._from_other, shadow=shadow, name=name)
        return Ros2Message(name, type_hash, to_cdr, from_cdr, is_flat=_is_flat(known))

    def _build_service(self, name: str) -> Ros2Service | None:
        known = self._catalog.service(name)
        if known is None:
            return None
        full_name = ros2_type(known.name, "srv")
        request = self._build(known.request, f"{full_name}_Request")
        response = self._build(known.response, f"{full_name}_Response")
        one = [(Nodetype.SEQUENCE, ((Nodetype.NAME, each.name), 1)) for each in (request, response)]
        info = (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")
        event = f"{full_name}_Event"
        parts = (("request", request.name), ("response", response.name), ("event", event))
        whole = [(f"{part}_message", (Nodetype.NAME, type_name)) for part, type_name in parts]
        type_hash = NO_HASH
        if self._has_hashes:
            self._add(event, [("info", info), ("request", one[0]), ("response", one[1])])
            self._add(full_name, whole)
            type_hash = self._store.hash_rihs01(full_name)
        return Ros2Service(full_name, type_hash, request, response)

    def _register(self, known: MessageType, name: str) -> None:
        """Add a type to the store, with those in it."""
        fields = []
        for field in known.fields:
            nested = known.nested.get(field.type)
            inner = _NESTED.get(field.type) if nested is None else ros2_type(nested.name)
            if nested is not None and inner not in self._store.fielddefs:
                self._register(nested, str(inner))
            fields.append((field.name.lower(), _described(field, inner)))
        self._add(name, fields or [_EMPTY])

    def _add(self, name: str, fields: list[tuple[str, _Desc]]) -> None:
        self._store.register({name: ([], fields)})

    def _is_same_on_wire(self, known: MessageType, name: str) -> bool:
        """Whether both types have the same fields, regardless of their names."""
        ros2 = ros2_layout(lambda each: dict(self._store.fielddefs[each][1]), name)
        return ros1_layout(_fields(known).get, known.name) == ros2

    # -- types with other fields --------------------------------------------------------------------------------------

    def _to_other(self, payload: bytes, *, shadow: str, name: str) -> memoryview:
        source: Any = self._store.deserialize_cdr(self._store.ros1_to_cdr(payload, shadow), shadow)
        made = self._copied(source, name)
        if name == _LOG:
            made.level = _LOG_LEVELS.get(source.level, 0)
            made.stamp = source.header.stamp
        return self._store.serialize_cdr(made, name, little_endian=True)

    def _from_other(self, data: bytes, *, shadow: str, name: str) -> memoryview:
        made = self._copied(self._store.deserialize_cdr(data, name), shadow)
        return self._store.cdr_to_ros1(self._store.serialize_cdr(made, shadow, little_endian=True), shadow)

    def _copied(self, source: object, name: str) -> Any:
        """A message of that type with the fields of the source that it has; the others are zero."""
        values = {
            key: self._value(getattr(source, key, None), desc)
            for key, desc in ((normalize_fieldname(each), desc) for each, desc in self._store.fielddefs[name][1])
        }
        return self._store.types[name](**values)

    def _value(self, value: Any, desc: _Desc) -> Any:
        if desc[0] == Nodetype.NAME:
            return self._copied(value, desc[1])
        if desc[0] == Nodetype.BASE:
            return _zero(desc[1][0]) if value is None else value
        (kind, inner), length = desc[1]
        count = length if desc[0] == Nodetype.ARRAY else 0
        if kind == Nodetype.NAME:
            return [self._copied(each, inner) for each in (value if value is not None else [None] * count)]
        if value is not None:
            return value
        return [""] * count if inner[0] == "string" else np.zeros(count, dtype=inner[0])


def _without_char(desc: _Desc) -> _Desc:
    """A char of ROS 2 is a uint8, in the type's hash too."""
    if desc[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return desc[0], (_without_char(desc[1][0]), desc[1][1])
    return (Nodetype.BASE, ("uint8", 0)) if desc == (Nodetype.BASE, ("char", 0)) else desc


def _fields(known: MessageType) -> dict[str, tuple[Field, ...]]:
    """Return the fields of a type and of all types in it, by name."""
    found = {known.name: known.fields}
    for nested in known.nested.values():
        found |= _fields(nested)
    return found


def _described(field: Field, nested: str | None) -> _Desc:
    """A field of the catalog as rosbags describes one."""
    inner = _without_char((Nodetype.BASE, (field.type, 0))) if nested is None else (Nodetype.NAME, nested)
    if field.array_length == SCALAR:
        return inner
    return (Nodetype.ARRAY if field.array_length else Nodetype.SEQUENCE, (inner, field.array_length))


def _is_flat(known: MessageType) -> bool:
    nested = known.nested.values()
    has_lists = any(
        field.array_length == VARIABLE and (field.type in known.nested or field.type == "string")
        for field in known.fields
    )
    return not has_lists and all(map(_is_flat, nested))


def _zero(base: str) -> object:
    return {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(base, 0)
