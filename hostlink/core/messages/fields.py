"""Fields, constants and the layout of a message type, as the codecs use them."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

SCALAR: Final = -1
VARIABLE: Final = 0
COUNT_BYTES: Final = 4  # a string and an array of variable length start with a uint32

FORMATS: Final = {
    "bool": "?",
    "byte": "b",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_BOOLS: Final = {"True": True, "true": True, "False": False, "false": False}
SIZES: Final = {name: struct.calcsize(f"<{code}") for name, code in FORMATS.items()}
FLOATS: Final = frozenset({"float32", "float64"})
OCTETS: Final = frozenset({"uint8", "char"})  # arrays of these are bytes
BUILT_IN: Final = frozenset({*FORMATS, "string", "time", "duration"})

# Limit for messages between programs; a device accepts far less. Omitted fields count too, so a short request can mean
# a long message.
ENCODED_BYTES_MAX: Final = 1024 * 1024

# A message without fields costs memory here but no bytes on the wire, so the payload does not bound the length of a
# list of them. This many elements cost about as much memory per payload byte as the smallest other messages.
EMPTY_ELEMENTS_MAX: Final = 16


class Constant(NamedTuple):
    """Named value in a definition. `text` is the part after the equals sign."""

    name: str
    type: str
    text: str


class Field(NamedTuple):
    """Field of a message. `array_length` is SCALAR (-1), VARIABLE (0) or the length."""

    name: str
    type: str
    array_length: int = SCALAR

    @property
    def type_text(self) -> str:
        """The type in the form of a definition: "float64[36]"."""
        if self.array_length == SCALAR:
            return self.type
        return f"{self.type}[{self.array_length or ''}]"

    @property
    def is_octets(self) -> bool:
        return self.array_length != SCALAR and self.type in OCTETS


@dataclass(frozen=True, eq=False)
class Layout:
    """Fields of one type in wire order, with the layouts of the nested types."""

    name: str
    fields: tuple[Field, ...]
    nested: Mapping[str, "Layout"]

    @cached_property
    def fixed_bytes(self) -> int | None:
        """Serialised size if every value has the same size, else None."""
        return self.minimum_bytes if all(map(self._is_fixed, self.fields)) else None

    @cached_property
    def minimum_bytes(self) -> int:
        """Size of the message whose fields are all zero. Its bytes are zeros too."""
        return sum(self.field_minimum_bytes(field) for field in self.fields)

    @cached_property
    def room(self) -> int:
        """Lower bound of the memory of a value: `minimum_bytes`, with one byte for each message without fields."""
        return max(1, sum(self._room(field) for field in self.fields))

    def element_minimum_bytes(self, field: Field) -> int:
        """Smallest size of one element of the field on the wire."""
        if field.type in SIZES:
            return SIZES[field.type]
        return COUNT_BYTES if field.type == "string" else self.nested[field.type].minimum_bytes

    def field_minimum_bytes(self, field: Field) -> int:
        if field.array_length == VARIABLE:
            return COUNT_BYTES
        return abs(field.array_length) * self.element_minimum_bytes(field)

    def _is_fixed(self, field: Field) -> bool:
        if field.array_length == VARIABLE or field.type == "string":
            return False
        return field.type not in self.nested or self.nested[field.type].fixed_bytes is not None

    def _room(self, field: Field) -> int:
        if field.type in self.nested and field.array_length != VARIABLE:
            return abs(field.array_length) * self.nested[field.type].room
        return self.field_minimum_bytes(field)


TIME: Final = Layout("time", (Field("secs", "uint32"), Field("nsecs", "uint32")), {})
DURATION: Final = Layout("duration", (Field("secs", "int32"), Field("nsecs", "int32")), {})


def bool_value(text: str) -> bool:
    """Value of a bool constant, written as `+1` or `True`."""
    return _BOOLS[text] if text in _BOOLS else int(text) == 1


def integer_range(type_name: str) -> range:
    """Range of values of a bool or an integer type."""
    if type_name == "bool":
        return range(2)
    bits = 8 * SIZES[type_name]
    return range(-(1 << bits - 1), 1 << bits - 1) if FORMATS[type_name].islower() else range(1 << bits)


def range_text(type_name: str) -> str:
    values = integer_range(type_name)
    return f"{values.start}..{values.stop - 1}"
