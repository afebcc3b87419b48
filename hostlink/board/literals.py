"""C++ literals for the values of a definition's constants. Pure."""

import math
import struct
from typing import Final

from hostlink.messages.fields import FLOATS, Constant, bool_value

_INT64_LEAST: Final = -(2**63)
_INT32_BITS: Final = 31  # without its sign
_FLOAT32_LARGEST: Final = (2 - 2**-23) * 2.0**127
_FLOAT32_LEAST: Final = 2.0**-126
_PLAIN: Final = frozenset(range(0x20, 0x7F)) - frozenset(b'"\\?')  # "??=" is one character to some compilers


def literal(constant: Constant) -> str:
    """The value as C++ writes it."""
    if constant.type == "string":
        return text_literal(constant.text)
    if constant.type in FLOATS:
        return _float_literal(constant.type, float(constant.text))
    if constant.type == "bool":
        return "true" if bool_value(constant.text) else "false"
    return _integer_literal(int(constant.text))


def text_literal(text: str) -> str:
    """The UTF-8 of the text in quotation marks; octal escapes end by themselves."""
    return '"' + "".join(chr(byte) if byte in _PLAIN else f"\\{byte:03o}" for byte in text.encode()) + '"'


def _integer_literal(value: int) -> str:
    if value == _INT64_LEAST:
        return f"({value + 1}LL - 1)"
    if value >= -_INT64_LEAST:
        return f"{value}ULL"
    return f"{value}LL" if value.bit_length() > _INT32_BITS else str(value)


def _float_literal(type_name: str, value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if type_name == "float32":
        value = _as_float32(value)
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    if type_name == "float32":
        return f"{value!r}f"
    return repr(value)


def fits_float32(value: float) -> bool:
    """Whether a double of 4 bytes, as AVR has it, accepts the literal without a warning."""
    return value == 0 or not math.isfinite(value) or _FLOAT32_LEAST <= abs(value) <= _FLOAT32_LARGEST


def _as_float32(value: float) -> float:
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)
