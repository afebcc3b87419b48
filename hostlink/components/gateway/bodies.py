"""Decoding of what a client sends: bodies and numbers of REST requests, fields of rosbridge operations, sizes of texts.

An unknown field is refused with the nearest known one: a field that is misspelled must not be ignored.
"""

import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from hostlink.errors import BadRequest, nearest_field

Body = TypeVar("Body")

# A velocity may be sent as it was read: by the names that a robot's state and the answers have.
_AS_READ = {"linear_m_s": "linear", "linear_y_m_s": "linear_y", "angular_rad_s": "angular"}
_NUMBERS = frozenset(_AS_READ.values())
_SIDEWAYS = "linear_y"  # no hint names it: a misspelled field must not drive a robot sideways


def decode_body(data: bytes, type_: type[Body], shape: str) -> Body:
    """Decode the body of a request. `shape` is the example in the error.

    Raises:
        BadRequest: the body does not have this shape.
    """
    try:
        return msgspec.json.decode(data, type=type_)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BadRequest(f"the body must be {shape}: {error}{_hint(str(error), type_)}") from error


def convert_fields(fields: Mapping[str, Any], type_: type[Body], operation: str) -> Body:
    """Convert the fields of an operation, which the error names.

    Raises:
        BadRequest: a field is unknown, missing or has another type.
    """
    try:
        return msgspec.convert(fields, type_)
    except msgspec.ValidationError as error:
        raise BadRequest(f"{operation}: {error}{_hint(str(error), type_)}") from error


def convert_velocity(fields: Mapping[str, Any], type_: type[Body], operation: str) -> Body:
    """Convert the fields of an operation that has a velocity; one of its numbers is enough.

    Raises:
        BadRequest: as `convert_fields`; or none of the numbers is there, or one by both of its names.
    """
    if not _AS_READ.keys().isdisjoint(fields):
        named = {_AS_READ.get(name, name): value for name, value in fields.items()}
        if len(named) < len(fields):
            twice = next(f"{long} and {short}" for long, short in _AS_READ.items() if {long, short} <= fields.keys())
            raise BadRequest(f"{operation}: {twice} are one number: send one of them")
        fields = named
    found = convert_fields(fields, type_, operation)
    if not has_velocity(fields):
        raise BadRequest(f"{operation}: linear (m/s) or angular (rad/s) is missing")
    return found


def has_velocity(fields: Mapping[str, Any]) -> bool:
    """Whether fields have a number of a velocity."""
    return not _NUMBERS.isdisjoint(fields)


def whole_number(text: str, max_digits: int) -> int | None:
    """Convert a number of a path or of a query; None for another text, or more digits."""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= max_digits else None


def size_bytes_of(text: str) -> int:
    """Return the size of a text of a client, which may have lone surrogates."""
    return len(text.encode("utf-8", "surrogatepass"))


def _hint(problem: str, type_: type[Any]) -> str:
    found = re.search("unknown field `(.*?)`", problem)
    known = getattr(type_, "__struct_encode_fields__", ())
    return "" if found is None else nearest_field(found[1], (name for name in known if name != _SIDEWAYS))
