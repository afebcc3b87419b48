"""Decoding of what a client sends: bodies and numbers of REST requests, fields of rosbridge operations, sizes of texts.

An unknown field is refused with the nearest known one: a field that is misspelled must not be ignored.
"""

import re
from collections.abc import Mapping
from typing import Any, TypeVar

import msgspec

from hostlink.errors import BadRequest, nearest_field

Body = TypeVar("Body", bound=msgspec.Struct)


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


def whole_number(text: str, max_digits: int) -> int | None:
    """Convert a number of a path or of a query; None for another text, or more digits."""
    return int(text) if text.isascii() and text.isdigit() and len(text) <= max_digits else None


def size_bytes_of(text: str) -> int:
    """Return the size of a text of a client, which may have lone surrogates."""
    return len(text.encode("utf-8", "surrogatepass"))


def _hint(problem: str, type_: type[msgspec.Struct]) -> str:
    found = re.search("unknown field `(.*?)`", problem)
    return "" if found is None else nearest_field(found[1], type_.__struct_encode_fields__)
