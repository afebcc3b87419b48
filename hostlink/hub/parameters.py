"""The parameters that devices ask for, in the form that rosserial has for them."""

from collections.abc import Mapping, Sequence

from hostlink.config import ParameterValue
from hostlink.errors import WrongType
from hostlink.protocol.control import Parameter

_INT_MIN, _INT_MAX = -(2**31), 2**31 - 1


def find_parameter(parameters: Mapping[str, ParameterValue], name: str) -> Parameter | None:
    """The parameter of that name, with or without its leading `/` or `~`; None if there is none; WrongType if it
    cannot be sent."""
    wanted = name.lstrip("/~")
    value = next((value for key, value in parameters.items() if key.lstrip("/~") == wanted), None)
    return None if value is None else to_parameter(name, value)


def to_parameter(name: str, value: ParameterValue) -> Parameter:
    """A setting as ints, floats or strings; a list must be of one kind, ints among floats are floats."""
    items: Sequence[bool | int | float | str] = value if isinstance(value, list) else [value]
    if all(isinstance(item, str) for item in items):
        return Parameter(strings=tuple(str(item) for item in items))
    if any(isinstance(item, str) for item in items):
        raise WrongType(f"parameter {name}", "a list of one kind", "strings among numbers")
    if any(isinstance(item, float) for item in items):
        return Parameter(floats=tuple(float(item) for item in items))
    ints = tuple(int(item) for item in items)
    if any(not _INT_MIN <= item <= _INT_MAX for item in ints):
        raise WrongType(f"parameter {name}", "int32", f"{ints}")
    return Parameter(ints=ints)
