"""C++ headers of message types for the Arduino library. Pure."""

import math
import re
import struct
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.resources import files
from itertools import groupby
from typing import Final, NamedTuple

from hostlink.core.messages.fields import FLOATS, FORMATS, SCALAR, VARIABLE, Constant, Field, bool_value
from hostlink.core.messages.message_type import MessageType, ServiceType

# -- literals ---------------------------------------------------------------------------------------------------------

_INT64_LEAST: Final = -(2**63)
_INT32_BITS: Final = 31  # without the sign
_FLOAT32_LARGEST: Final = (2 - 2**-23) * 2.0**127
_FLOAT32_LEAST: Final = 2.0**-126
_PLAIN: Final = frozenset(range(0x20, 0x7F)) - frozenset(b'"\\?')  # "??=" is a trigraph

METHODS: Final = ("serialize", "deserialize", "getType", "getMD5", "getSize")  # methods of each message class

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

SIZE_MAX: Final = 65535  # bytes of a payload


def literal(constant: Constant) -> str:
    """Write the value as a C++ literal."""
    if constant.type == "string":
        return text_literal(constant.text)
    if constant.type in FLOATS:
        return _float_literal(constant.type, float(constant.text))
    if constant.type == "bool":
        return "true" if bool_value(constant.text) else "false"
    return _integer_literal(int(constant.text))


def text_literal(text: str) -> str:
    """Write the text's UTF-8 bytes as a C++ string; an octal escape has a fixed length."""
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
    """Whether a 4-byte double, as on AVR, accepts the literal without a warning."""
    return value == 0 or not math.isfinite(value) or _FLOAT32_LEAST <= abs(value) <= _FLOAT32_LARGEST


def _as_float32(value: float) -> float:
    try:
        return float(struct.unpack("<f", struct.pack("<f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


# -- identifiers ------------------------------------------------------------------------------------------------------

_KEYWORDS: Final = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char16_t char32_t char8_t class
    co_await co_return co_yield compl concept const const_cast consteval constexpr constinit continue decltype default
    delete do double dynamic_cast else enum explicit export extern false float for friend goto if inline int long
    mutable namespace new noexcept not not_eq nullptr operator or or_eq private protected public register
    reinterpret_cast requires return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename union unsigned using virtual void volatile wchar_t while xor
    xor_eq
"""
# Macros without arguments of Arduino.h and its includes: a field or constant with such a name does not compile. Macros
# with arguments (min, max, abs) are harmless, because no "(" follows a member. macros.txt has the macros of AVR and of
# the C libraries, taken from their headers (tools/board_macros.py); these are of SAM, ESP8266, ESP32 and compilers.
_MACROS: Final = """
    ANALOG BIT0 BIT1 BIT2 BIT3 BIT4 BIT5 BIT6 BIT7 BIT8 BIT9 BIT10 BIT11 BIT12 BIT13 BIT14 BIT15 BIT16 BIT17 BIT18 BIT19
    BIT20 BIT21 BIT22 BIT23 BIT24 BIT25 BIT26 BIT27 BIT28 BIT29 BIT30 BIT31 CHIPID CPU2X ESP32 ESP8266 ESP_FAIL ESP_OK
    FUNCTION_0 FUNCTION_1 FUNCTION_2 FUNCTION_3 FUNCTION_4 FUNCTION_5 FUNCTION_6 GPC GPE GPF GPI GPIE GPMUX GPO
    ICACHE_FLASH_ATTR ICACHE_RAM_ATTR INPUT_PULLDOWN_16 IOSWAP IRAM_ATTR LOCAL MAC0 MAC1 ONHIGH ONHIGH_WE ONLOW ONLOW_WE
    OPEN_DRAIN PULLDOWN PULLUP PWMRANGE RTCCV RTCSV SPECIAL STORE_ATTR T1C T1I T1L T1V T2A T2C T2I T2L T2V TIM_EDGE
    TIM_LEVEL TIM_LOOP TIM_SINGLE U0A U0C0 U0C1 U0D U0F U0S U1A U1C0 U1C1 U1D U1F U1S UIS WAKEUP_PULLDOWN WAKEUP_PULLUP
    ROS_IN_FLASH
    DAC DISABLED DMAC EFC0 EFC1 FALSE GPBR I2C INPUT_PULLDOWN MATRIX OUTPUT_OPEN_DRAIN PIOA PIOB PIOC PIOD PMC PWM RSTC
    RTC RTT SMC SPI SUPC TC0 TC1 TC2 TRNG TRUE TWI0 TWI1 UART UNUSED UOTGHS USART0 USART1 USART2 USART3 WDT arm avr i386
    int16_t int32_t int64_t int8_t linux uint16_t uint32_t uint64_t uint8_t unix
"""
# Functions and classes of Arduino's cores and of C. A package's namespace cannot have such a name.
_GLOBALS: Final = """
    Client EEPROM ESP Ethernet Print Printable SPI Serial Serial_ Server Servo Stream String UDP WiFi Wire abort abs
    accept access alarm basename bind boolean byte ceil clock close connect crypt daemon delay div dup encrypt equals
    exit exp floor fork free gamma index init j0 j1 kill lgamma link listen log loop main malloc map micros millis mount
    nice open optarg pause pipe poll pow printf puts raise rand random read remainder remove rename revoke rewind round
    scanf select send setup shutdown signal sin sleep socket sqrt square stat stderr stdin stdout swab sync system tan
    time tone trunc truncate wait word write y0 y1 yield
"""


@cache
def _reserved() -> frozenset[str]:
    of_headers = files("hostlink.board").joinpath("macros.txt").read_text()
    return frozenset((_KEYWORDS + _MACROS + of_headers).split())


class CppNames:
    """Unique C++ names of one class. A used or reserved name gets a _ appended."""

    def __init__(self, used: Iterable[str] = ()) -> None:
        self._used = set(used)

    def add(self, name: str) -> str:
        """Add a name. Return its C++ form."""
        name = identifier(name)
        while name in self._used:
            name += "_"
        self._used.add(name)
        return name


def identifier(name: str) -> str:
    """Return the name, with a _ appended if it is a keyword or a macro."""
    return f"{name}_" if name in _reserved() else name


def class_identifier(base: str) -> str:
    """Return the C++ name of a class with METHODS, as `identifier` does."""
    return f"{base}_" if base in METHODS else identifier(base)


def namespace(package: str) -> str:
    """Return the C++ namespace of a package, as `identifier` does."""
    name = identifier(package)
    while name in _GLOBALS.split():
        name += "_"
    return name


def class_name(full_name: str) -> str:
    """Convert "std_msgs/Header" to "::std_msgs::Header"."""
    package, _, base = full_name.partition("/")
    return f"::{namespace(package)}::{class_identifier(base)}"


# -- headers ----------------------------------------------------------------------------------------------------------

_INITIAL: Final = {**dict.fromkeys(FORMATS, " = 0"), "bool": " = false", "string": ' = ""'}
_ARRAYS: Final = {"string": "::ros::Texts", "float64": "::ros::Doubles"}  # types that a sketch may have in two forms
_STATIC: Final = re.compile(r"  static constexpr (.+?) (\w+) =")


class _Member(NamedTuple):
    """Field with its C++ names. `length` names the member with the number of elements of a variable array."""

    field: Field
    name: str
    length: str
    minimum_bytes: int  # of one element on the wire

    @property
    def element(self) -> str:
        return CPP_TYPES.get(self.field.type) or class_name(self.field.type)


def message_header(message: MessageType) -> str:
    """Write the file <package>/<Type>.h of a message type."""
    base = message.name.partition("/")[2]
    return _file(message.name, _dependencies(message), list(_class(message, base, message.name)))


def service_header(service: ServiceType) -> str:
    """Write the file <package>/<Type>.h with the classes of request and response."""
    base = service.name.partition("/")[2]
    name = CppNames(("Request", "Response", *METHODS)).add(base)
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
    names = CppNames((*METHODS, name))
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
    put = [_transfer("put", member) for member in members]
    got = [_transfer("get", member, member.minimum_bytes) for member in members]
    yield from _method(f"bool serialize(::ros::Writer& {out}) const", out, put)
    yield from _method(f"bool deserialize(::ros::Reader& {in_})", in_, got)
    yield "};"
    yield from _definitions(name, constants)


def _flash_texts(type_name: str, md5: str) -> Iterator[str]:
    for method, text in (("getType", type_name), ("getMD5", md5)):
        yield f"  static ::ros::FlashText {method}() {{"
        yield f'    static const char text[] ROS_IN_FLASH = "{text}";'
        yield "    return ::ros::FlashText(text);"
        yield "  }"


def _members(message: MessageType, names: CppNames) -> Iterator[_Member]:
    fields = {field: names.add(field.name) for field in message.fields}
    for field, name in fields.items():
        length = names.add(f"{field.name}_length") if field.array_length == VARIABLE else ""
        yield _Member(field, name, length, message.layout.element_minimum_bytes(field))


def _constants(constants: tuple[Constant, ...], names: CppNames) -> Iterator[str]:
    """Declare whole numbers as enumerators, which need no definition, and other constants as static members."""
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
    """Define the static members for references to them, such as in std::max. C++17 needs no definitions."""
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
    """Smallest and largest size of a payload."""
    most = SIZE_MAX if message.fixed_bytes is None else message.fixed_bytes
    return f"{min(message.layout.minimum_bytes, SIZE_MAX)}, {min(most, SIZE_MAX)}"


def _transfer(verb: str, member: _Member, *bounds: int) -> str:
    """Call that puts or gets a field; `bounds` are those of a variable array."""
    if member.field.array_length == SCALAR:
        return f"{verb}({member.name})"
    if member.field.array_length == VARIABLE:
        return f"{verb}_variable({', '.join(map(str, (member.name, member.length, *bounds)))})"
    return f"{verb}_fixed({member.name})"


def _method(head: str, stream: str, calls: list[str]) -> Iterator[str]:
    yield ""
    yield f"  {head} {{"
    yield from (f"    {stream}.{call};" for call in calls)
    yield f"    return {stream}.is_good();"
    yield "  }"
