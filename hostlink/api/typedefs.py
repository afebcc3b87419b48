"""TypeDef: how rosapi describes a message type; as rosbridge's own, down to the spelling of the examples."""

from typing import Any

from hostlink.messages.fields import BUILT_IN, FLOATS, SCALAR, Constant, bool_value
from hostlink.messages.message_type import MessageType

_TIMES = ("time", "duration")
_EXAMPLES = {"string": "", "bool": "False", "float32": "0.0", "float64": "0.0"}  # as Python prints the defaults


def describe(type_: MessageType) -> list[dict[str, Any]]:
    """The TypeDefs of a type and of all types in it: the root first, depth first, each once."""
    typedefs: dict[str, dict[str, Any]] = {}
    _add(type_, typedefs)
    return list(typedefs.values())


def _add(type_: MessageType, typedefs: dict[str, dict[str, Any]]) -> None:
    constants = sorted(type_.constants)
    typedefs[type_.name] = {
        "type": type_.name,
        "fieldnames": [field.name for field in type_.fields],
        "fieldtypes": [field.type for field in type_.fields],
        "fieldarraylen": [field.array_length for field in type_.fields],
        "examples": [_example(field.type, field.array_length) for field in type_.fields],
        "constnames": [constant.name for constant in constants],
        "constvalues": [_value(constant) for constant in constants],
    }
    for field in type_.fields:
        if field.type in typedefs:
            continue
        if field.type in _TIMES:
            typedefs[field.type] = _time(field.type)
        elif field.type in type_.nested:
            _add(type_.nested[field.type], typedefs)


def _time(name: str) -> dict[str, Any]:
    return {
        "type": name,
        "fieldnames": ["secs", "nsecs"],
        "fieldtypes": ["int32", "int32"],
        "fieldarraylen": [SCALAR, SCALAR],
        "examples": ["0", "0"],
        "constnames": [],
        "constvalues": [],
    }


def _example(type_name: str, array_length: int) -> str:
    if array_length != SCALAR:
        return "[]"
    if type_name in _TIMES or type_name not in BUILT_IN:
        return "{}"
    return _EXAMPLES.get(type_name, "0")


def _value(constant: Constant) -> str:
    """As Python prints the constant of the generated class."""
    if constant.type in FLOATS:
        return str(float(constant.text))
    if constant.type == "bool":
        return str(bool_value(constant.text))
    return constant.text if constant.type == "string" else str(int(constant.text))
