"""Parse the text of .msg and .srv files by the rules of ROS 1. References to other types are not resolved."""

import re
from collections.abc import Iterator
from typing import Final, NamedTuple

from hostlink.core.messages.fields import (
    BUILT_IN,
    FLOATS,
    FORMATS,
    SCALAR,
    VARIABLE,
    Constant,
    Field,
    integer_range,
    range_text,
)
from hostlink.errors import ConfigError

ARRAY_LENGTH_MAX: Final = 65535  # no rosserial payload holds more elements

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_TYPE: Final = re.compile(r"([A-Za-z][A-Za-z0-9_]*(?:/[A-Za-z][A-Za-z0-9_]*)?)(?:\[([0-9]*)\])?")
# What ROS 2 calls ROS 1's time and duration, at the beginning of a field.
_ROS2_TIME: Final = re.compile(r"^([ \t]*)builtin_interfaces/(Time|Duration)(?=[ \t\[])", re.MULTILINE)


class Definition(NamedTuple):
    """One parsed message definition. `field_lines` are the line numbers of the fields."""

    name: str
    text: str
    constants: tuple[Constant, ...]
    fields: tuple[Field, ...]
    where: str
    field_lines: tuple[int, ...]

    def error(self, field: Field, problem: str) -> ConfigError:
        """Build an error that names the line of the field."""
        line = self.field_lines[self.fields.index(field)]
        return ConfigError(f"{self.where}:{line}", f"field {field.name}: {problem}")


def parse_message(name: str, text: str, where: str, *, first_line: int = 1) -> Definition:
    """Parse one message definition. Each ConfigError names `where` and the line.

    A field of the type builtin_interfaces/Time, as in the definitions of ROS 2, is a time, also in the text.
    """
    text = _ROS2_TIME.sub(lambda match: f"{match[1]}{match[2].lower()}", text)
    constants: dict[str, Constant] = {}
    fields: dict[str, tuple[Field, int]] = {}
    package = name.partition("/")[0]
    for number, line, code in _lines(text, first_line):
        try:
            entry = _constant(line, code) if "=" in code else _field(code, package)
            _check_name(entry.name, is_there=entry.name in constants or entry.name in fields)
        except ValueError as error:
            raise ConfigError(f"{where}:{number}", str(error)) from None
        if isinstance(entry, Constant):
            constants[entry.name] = entry
        else:
            fields[entry.name] = (entry, number)
    return Definition(
        name,
        f"{text.rstrip()}\n" if text.strip() else "",
        tuple(constants.values()),
        tuple(field for field, _ in fields.values()),
        where,
        tuple(number for _, number in fields.values()),
    )


def parse_service(name: str, text: str, where: str) -> tuple[Definition, Definition]:
    """Parse a service definition into request and response, with the names that ROS gives them."""
    lines = text.split("\n")
    cuts = [index for index, line in enumerate(lines) if line.startswith("---")]
    if len(cuts) != 1:
        raise ConfigError(where, f"a service definition needs exactly one line of ---, found {len(cuts)}")
    request, response = "\n".join(lines[: cuts[0]]), "\n".join(lines[cuts[0] + 1 :])
    return (
        parse_message(f"{name}Request", request, where),
        parse_message(f"{name}Response", response, where, first_line=cuts[0] + 2),
    )


def _lines(text: str, first_line: int) -> Iterator[tuple[int, str, str]]:
    """Yield number, text, and text without comment of every line that is not empty."""
    for number, line in enumerate(text.split("\n"), first_line):  # only \n ends a line, also in comments and strings
        if code := line.partition("#")[0].strip():
            yield number, line, code


def _constant(line: str, code: str) -> Constant:
    declaration, _, text = code.partition("=")
    type_name, name = _two_words(declaration, "TYPE NAME=VALUE", code)
    if type_name == "string":
        text = line.partition("=")[2]  # a # in a string constant does not start a comment
    elif type_name not in FORMATS:
        raise ValueError(f"a constant cannot have the type {type_name}")
    text = text.strip()
    _check_value(type_name, name, text)
    return Constant(name, type_name, text)


def _two_words(declaration: str, wanted: str, code: str) -> tuple[str, str]:
    match declaration.split():
        case [first, second]:
            return first, second
    raise ValueError(f"wanted {wanted}, got {code!r}{_ros2_hint(code)}")


def _ros2_hint(code: str) -> str:
    """Advice for a line with ROS 2 syntax that ROS 1 and rosserial lack."""
    if "<=" in code:
        return "; bounded types exist only in ROS 2; remove the bound"
    if len(code.split()) > len(("TYPE", "NAME")) and "=" not in code:
        return "; default values exist only in ROS 2; remove it"
    return ""


def _check_name(name: str, *, is_there: bool) -> None:
    if is_there:
        raise ValueError(f"{name} is defined twice")
    if not _NAME.fullmatch(name):
        raise ValueError(f"{name!r} is not a valid name; use letters, digits and _, and begin with a letter")


def _check_value(type_name: str, name: str, text: str) -> None:
    """Raise ValueError if the text is not a value of the type."""
    if type_name == "string":
        return
    if type_name == "bool" and text in {"True", "False", "true", "false"}:
        return
    kind, converted = ("number", float) if type_name in FLOATS else ("whole number", int)
    try:
        value = converted(text)
    except ValueError:
        raise ValueError(f"constant {name}: {text!r} is not a {kind}") from None
    if type_name not in FLOATS and int(value) not in integer_range(type_name):
        raise ValueError(f"constant {name}: {text} is outside {range_text(type_name)}")


def _field(code: str, package: str) -> Field:
    written, name = _two_words(code, "TYPE NAME", code)
    match = _TYPE.fullmatch(written)
    if match is None:
        raise ValueError(f"{written!r} is not a valid type")
    type_name, length = match.groups()
    if type_name == "wstring":
        raise ValueError("wstring exists only in ROS 2; use string")
    return Field(name, _full_type(type_name, package), _array_length(written, length))


def _full_type(type_name: str, package: str) -> str:
    if type_name == "Header":  # Header needs no package name
        return "std_msgs/Header"
    return type_name if "/" in type_name or type_name in BUILT_IN else f"{package}/{type_name}"


def _array_length(written: str, length: str | None) -> int:
    if length is None:
        return SCALAR
    if not length:
        return VARIABLE
    if length != "0" and length.startswith("0"):
        raise ValueError(f"{written}: an array length must not begin with 0")  # ROS includes the digit in its md5 sum
    if not 0 < int(length) <= ARRAY_LENGTH_MAX:
        raise ValueError(f"{written}: an array length must be 1 to {ARRAY_LENGTH_MAX}, or empty")
    return int(length)
