"""The C++11 header of a message or service type, as ros_lib has one for each. Definition in, text out. Pure."""

import re
from collections.abc import Iterator
from itertools import groupby
from typing import Final, NamedTuple

from hostlink.board.identifiers import METHODS, Names, class_identifier, class_name, namespace
from hostlink.board.literals import fits_float32, literal
from hostlink.messages.fields import FLOATS, FORMATS, SCALAR, VARIABLE, Constant, Field
from hostlink.messages.message_type import MessageType, ServiceType

CPP_TYPES: Final = {
    "bool": "bool",
    "byte": "int8_t",
    "char": "uint8_t",
    "int8": "int8_t",
    "uint8": "uint8_t",
    "int16": "int16_t",
    "uint16": "uint16_t",
    "int32": "int32_t",
    "uint32": "uint32_t",
    "int64": "int64_t",
    "uint64": "uint64_t",
    "float32": "float",
    "float64": "double",
    "time": "::ros::Time",
    "duration": "::ros::Duration",
    "string": "const char*",
}
_INITIAL: Final = {**dict.fromkeys(FORMATS, " = 0"), "bool": " = false", "string": ' = ""'}
_ARRAYS: Final = {"string": "::ros::Texts", "float64": "::ros::Doubles"}  # that a sketch may have in two forms
SIZE_MAX: Final = 65535  # of a payload
_STATIC: Final = re.compile(r"  static constexpr (.+?) (\w+) =")


class _Member(NamedTuple):
    """A field with its C++ names; `length` is the member with the number of elements of a variable array."""

    field: Field
    name: str
    length: str
    minimum_bytes: int  # of one element on the wire

    @property
    def element(self) -> str:
        return CPP_TYPES.get(self.field.type) or class_name(self.field.type)


def message_header(message: MessageType) -> str:
    """The file <package>/<Type>.h."""
    base = message.name.partition("/")[2]
    return _file(message.name, _dependencies(message), list(_class(message, base, message.name)))


def service_header(service: ServiceType) -> str:
    """The file <package>/<Type>.h with the classes of request and response."""
    base = service.name.partition("/")[2]
    name = Names(("Request", "Response", *METHODS)).add(base)
    lines = [
        *_class(service.request, f"{base}Request", service.name),
        "",
        *_class(service.response, f"{base}Response", service.name),
        "",
        f"struct {name} {{",
        f"  typedef {base}Request Request;",
        f"  typedef {base}Response Response;",
        *_flash_texts(service.name, service.md5),
        "};",
    ]
    return _file(service.name, _dependencies(service.request) | _dependencies(service.response), lines)


def _dependencies(message: MessageType) -> set[str]:
    return {nested.name for nested in message.nested.values()}


def _file(name: str, included: set[str], body: list[str]) -> str:
    package = name.partition("/")[0]
    math = ["#include <math.h>", ""] if any("INFINITY" in line or "NAN" in line for line in body) else []
    lines = [
        f"// {name}: made by `hostlink arduino-library` from its definition; make it again instead of changing it.",
        "#pragma once",
        "",
        *math,
        '#include "ros/msg.h"',
        *(f'#include "{each}.h"' for each in sorted(included)),
        "",
        f"namespace {namespace(package)} {{",
        "",
        *body,
        "",
        f"}}  // namespace {namespace(package)}",
    ]
    return "\n".join(lines) + "\n"


def _class(message: MessageType, base: str, type_name: str) -> Iterator[str]:
    name = class_identifier(base)
    names = Names((*METHODS, name))
    members = list(_members(message, names))
    yield f"class {name} : public ::ros::Msg {{"
    yield " public:"
    constants = list(_constants(message.constants, names))
    yield from constants
    if constants:
        yield ""
    for member in members:
        yield from _declaration(member)
    if members:
        yield ""
    yield from _flash_texts(type_name, message.md5)
    yield f"  static constexpr ::ros::Size getSize() {{ return ::ros::Size({_size(message)}); }}"
    out, in_ = names.add("out"), names.add("in")
    yield from _method(f"bool serialize(::ros::Writer& {out}) const", out, [_put(member) for member in members])
    yield from _method(f"bool deserialize(::ros::Reader& {in_})", in_, [_get(member) for member in members])
    yield "};"
    yield from _definitions(name, constants)


def _flash_texts(type_name: str, md5: str) -> Iterator[str]:
    for method, text in (("getType", type_name), ("getMD5", md5)):
        yield f"  static ::ros::FlashText {method}() {{"
        yield f'    static const char text[] ROS_IN_FLASH = "{text}";'
        yield "    return ::ros::FlashText(text);"
        yield "  }"


def _members(message: MessageType, names: Names) -> Iterator[_Member]:
    fields = {field: names.add(field.name) for field in message.fields}
    for field, name in fields.items():
        length = names.add(f"{field.name}_length") if field.array_length == VARIABLE else ""
        yield _Member(field, name, length, message.layout.element_minimum_bytes(field))


def _constants(constants: tuple[Constant, ...], names: Names) -> Iterator[str]:
    """Whole numbers as enumerators of their type, which need no definition elsewhere; others as static members."""
    for type_name, group in groupby(constants, lambda constant: constant.type):
        if type_name == "string" or type_name in FLOATS:
            for constant in group:
                yield from _static_constant(constant, names.add(constant.name))
            continue
        values = [f"    {names.add(constant.name)} = {literal(constant)}," for constant in group]
        yield f"  enum : {CPP_TYPES[type_name]} {{"
        yield from values
        yield "  };"


def _static_constant(constant: Constant, name: str) -> Iterator[str]:
    line = f"  static constexpr {CPP_TYPES[constant.type]} {name} = {literal(constant)};"
    if constant.type == "float64" and not fits_float32(float(constant.text)):
        replacement = "0" if abs(float(constant.text)) < 1 else "INFINITY" if float(constant.text) > 0 else "-INFINITY"
        yield from ("#if __SIZEOF_DOUBLE__ > 4", line, "#else")
        yield f"  static constexpr double {name} = {replacement};"
        yield "#endif"
    else:
        yield line


def _definitions(class_: str, constants: list[str]) -> Iterator[str]:
    """Of the static members, for whoever takes a reference of one, as std::max does; C++17 has them by itself."""
    found = dict.fromkeys(match.groups() for line in constants if (match := _STATIC.match(line)))
    if found:
        yield "#if __cplusplus < 201703L"
        yield from (f"constexpr {type_} {class_}::{name} __attribute__((weak));" for type_, name in found)
        yield "#endif"


def _declaration(member: _Member) -> Iterator[str]:
    field, name = member.field, member.name
    if field.array_length == VARIABLE:
        yield f"  uint32_t {member.length} = 0;"
        element = _ARRAYS.get(field.type) or f"{member.element}*"
        yield f"  {element} {name} = nullptr;"
    elif field.array_length != SCALAR:
        yield f"  {member.element} {name}[{field.array_length}] = {{}};"
    else:
        yield f"  {member.element} {name}{_INITIAL.get(field.type, '')};"


def _size(message: MessageType) -> str:
    """The least and the most that a payload has."""
    most = SIZE_MAX if message.fixed_bytes is None else message.fixed_bytes
    return f"{min(message.layout.minimum_bytes, SIZE_MAX)}, {min(most, SIZE_MAX)}"


def _put(member: _Member) -> str:
    if member.field.array_length == SCALAR:
        return f"put({member.name})"
    if member.field.array_length == VARIABLE:
        return f"put_variable({member.name}, {member.length})"
    return f"put_fixed({member.name})"


def _get(member: _Member) -> str:
    if member.field.array_length == SCALAR:
        return f"get({member.name})"
    if member.field.array_length == VARIABLE:
        return f"get_variable({member.name}, {member.length}, {member.minimum_bytes})"
    return f"get_fixed({member.name})"


def _method(head: str, stream: str, calls: list[str]) -> Iterator[str]:
    yield ""
    yield f"  {head} {{"
    yield from (f"    {stream}.{call};" for call in calls)
    yield f"    return {stream}.is_good();"
    yield "  }"
