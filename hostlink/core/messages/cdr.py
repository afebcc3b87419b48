"""Compiled translation between CDR, the serialisation of ROS 2, and that of ROS 1, which the hub carries.

CDR is XCDR1, little endian: each value is aligned to its own size, counted from the start of the message. A payload of
XRCE (micro-ROS) is the message alone; a payload of DDS has the four bytes of ENCAPSULATION before it. A type has the
same values in both, with these differences in CDR: a header has no `seq`, a text ends with a NUL that its length
counts, and a message without fields has one byte. Values are copied; only lengths are read.
"""

import struct
from collections.abc import Callable
from typing import Any, Final, NamedTuple, cast
from weakref import WeakKeyDictionary

from hostlink.core.messages.codec import UNCOMMON_LAYOUT
from hostlink.core.messages.fields import (
    COUNT_BYTES,
    EMPTY_ELEMENTS_MAX,
    ENCODED_BYTES_MAX,
    SCALAR,
    SIZES,
    VARIABLE,
    Field,
    Layout,
)
from hostlink.core.messages.message_type import MessageType
from hostlink.errors import BadPayload, WrongType

ENCAPSULATION: Final = b"\x00\x01\x00\x00"  # CDR, little endian; the last two bytes are options
_REPRESENTATION: Final = ENCAPSULATION[:2]

# Types whose fields ROS 2 has changed, by the md5 sum of the definition of ROS 1. Another definition of such a name, as
# from a folder of the user's, is used unchanged.
_CHANGED: Final = {
    "rosgraph_msgs/Log": "acffd30cd6b6de30f120938c17c593fb",
    "shape_msgs/SolidPrimitive": "d8f8cbc74c5ff283fca29569ccefb45d",  # since Humble
    "visualization_msgs/Marker": "4048c9de2a16f4ae8e0538085ebf1b97",  # since Humble
}
# Bytes of a field more at the end, since Iron. Earlier ones ignore them, as ROS 2 does with all after a message.
_APPENDED: Final = {"sensor_msgs/Range": ("c005c34273dc426c67a020a87bc24148", SIZES["float32"])}

_ALIGNMENT_MAX: Final = 8
_PADDING_MAX: Final = 3  # DDS pads a message to 4 bytes
_SEQ: Final = ("std_msgs/Header", Field("seq", "uint32"))
_TEXT: Final = Layout("text", (Field("text", "string"),), {})
_COUNT: Final = struct.Struct("<I")
_ZEROS: Final = [bytes(count) for count in range(_ALIGNMENT_MAX)]

_Translate = Callable[[bytes, bool], bytes]


class Cdr:
    """Translation of one type. `is_copy`: a message of the type has the same bytes in both serialisations."""

    def __init__(self, type_: MessageType, *, appended_bytes: int = 0) -> None:
        """Compile the translation of a type whose fields are the same in ROS 2.

        `appended_bytes`: of a field that only ROS 2 has, at the end. It is zero in what is made, and ignored otherwise.
        """
        self.name: str = type_.name
        to_ros1, from_ros1 = _Module(reads_cdr=True), _Module(reads_cdr=False)
        self._to_ros1: _Translate = to_ros1.load(type_.layout, appended_bytes)
        self._from_ros1: _Translate = from_ros1.load(type_.layout, appended_bytes)
        self.is_copy: bool = to_ros1.is_copy

    def to_ros1(self, payload: bytes, *, is_encapsulated: bool = False) -> bytes:
        """Translate a message of ROS 2. The `seq` of a header is 0.

        `is_encapsulated`: the payload begins with ENCAPSULATION, and only padding may follow the message. Otherwise,
        what a board of micro-ROS leaves after a message is ignored, too.

        Raises:
            BadPayload: it is not a message of this type, or its encapsulation is not that of little-endian CDR.
        """
        if is_encapsulated:
            payload = without_encapsulation(self.name, payload)
        return self._translated(self._to_ros1, payload, is_exact=is_encapsulated)

    def from_ros1(self, payload: bytes, *, is_encapsulated: bool = False) -> bytes:
        """Translate a message of ROS 1.

        Raises:
            BadPayload: it is not a message of this type.
        """
        message = self._translated(self._from_ros1, payload, is_exact=True)
        return ENCAPSULATION + message if is_encapsulated else message

    def _translated(self, translate: _Translate, payload: bytes, *, is_exact: bool) -> bytes:
        try:
            return translate(payload, is_exact)
        except UNCOMMON_LAYOUT as error:
            raise BadPayload(self.name, f"{len(payload)} bytes are not such a message: {error}") from None


def without_encapsulation(type_name: str, payload: bytes) -> bytes:
    """Return the message alone of a payload that begins with ENCAPSULATION.

    Raises:
        BadPayload: its encapsulation is not that of little-endian CDR.
    """
    if len(payload) < len(ENCAPSULATION) or not payload.startswith(_REPRESENTATION):
        raise BadPayload(type_name, f"the payload begins with {payload[:4].hex()}, little-endian CDR with 0001")
    return payload[len(ENCAPSULATION) :]


_cdrs: Final[WeakKeyDictionary[MessageType, Cdr]] = WeakKeyDictionary()


def cdr_of(message_type: MessageType) -> Cdr:
    """Return the translation of a type. It is compiled once.

    Raises:
        WrongType: ROS 2 has other fields in this type or in one that it contains.
    """
    found = _cdrs.get(message_type)
    if found is None:
        _check_fields(message_type, message_type.name)
        found = _cdrs[message_type] = Cdr(message_type, appended_bytes=_appended_bytes(message_type))
    return found


def _appended_bytes(type_: MessageType) -> int:
    md5, size = _APPENDED.get(type_.name, ("", 0))
    return size if md5 == type_.md5 else 0


def _check_fields(type_: MessageType, outer: str) -> None:
    if _CHANGED.get(type_.name) == type_.md5 or (type_.name != outer and _appended_bytes(type_)):
        raise WrongType(outer, f"the fields that {type_.name} has in ROS 2", "those of ROS 1")
    for nested in type_.nested.values():
        _check_fields(nested, outer)


class _Module:
    """Source of the functions for one type and one direction, with those for the elements of lists."""

    def __init__(self, *, reads_cdr: bool) -> None:
        self.reads_cdr = reads_cdr
        self.is_copy = False
        self._functions: dict[Layout, str] = {}
        self._lines: list[str] = []

    def load(self, layout: Layout, appended_bytes: int) -> _Translate:
        """Compile the function that translates a whole message."""
        body = _Body(self, _ALIGNMENT_MAX)
        body.add_message(layout)
        self.is_copy = body.copied_bytes is not None
        shortcut = [f" if size == {body.copied_bytes}: return b"] * self.is_copy
        if not self.reads_cdr:
            body.add_zeros(appended_bytes)
        padding_bytes = _PADDING_MAX + appended_bytes if self.reads_cdr else 0
        is_exact = layout.fixed_bytes is not None or "is_exact"
        self._lines += ["def translate(b, is_exact):", " size = len(b)", *shortcut, " o = d = 0", " p = []"]
        self._lines += body.finish()
        self._lines += [f" if size - o > {padding_bytes}: check_rest(b, o, {is_exact})", " return b''.join(p)"]
        names: dict[str, Any] = {"UncommonLayout": ValueError, "zeros": _ZEROS, "check_rest": _check_rest}
        names |= {"unpack": _COUNT.unpack_from, "pack": _COUNT.pack}
        exec("\n".join(self._lines), names)  # noqa: S102 - the source has only numbers of a definition, no text
        return cast("_Translate", names["translate"])

    def element(self, layout: Layout) -> list[str]:
        """Return the body of a loop over elements. Messages have a function: Python limits how deep loops nest."""
        state = "o" if self.reads_cdr else "o, d"
        if layout in self._functions:
            return [f" {state} = {self._functions[layout]}(b, {state}, size, p)"]
        body = _Body(self, 1)
        body.add_message(layout)
        if layout is _TEXT:
            return body.finish()
        name = self._functions[layout] = f"element_{len(self._functions)}"
        self._lines += [f"def {name}(b, {state}, size, p):", *body.finish(), f" return {state}"]
        return self.element(layout)


def _check_rest(payload: bytes, end: int, is_exact: bool) -> None:
    """Raise ValueError if the payload continues after the message for longer than its writer may let it.

    Micro-ROS announces a byte more than it writes for each empty text, which may cost a whole alignment, and leaves the
    rest as it is. ROS 2 ignores what is after a message.
    """
    rest_bytes = len(payload) - end
    empty_texts = payload.count(_ZEROS[COUNT_BYTES], 0, end)  # or more: a length of 0 is four zeros
    if is_exact or rest_bytes >= _ALIGNMENT_MAX * (1 + empty_texts):
        raise ValueError(f"the message ends after {end} bytes")


class _Solid(NamedTuple):
    """A value whose bytes are the same in both serialisations, also in a list, once it is aligned."""

    alignment: int
    size: int


class _Body:
    """Statements of one function: b is the payload, o the offset in it, p the parts of the result.

    Where CDR is written, d is the position in it less o. What is known of the position in the CDR when the function is
    made: it is `phase`, modulo `modulus`.
    """

    def __init__(self, module: _Module, modulus: int) -> None:
        self._module = module
        self._modulus, self._phase = modulus, 0
        self._lines: list[str] = []
        self._run: list[tuple[int, bool, bool]] = []  # bytes, and whether CDR and ROS 1 have them; not yet written

    @property
    def copied_bytes(self) -> int | None:
        """Size of the message if all of it is copied, else None."""
        [(size, in_cdr, in_ros1), *others] = self._run or [(0, False, False)]
        return size if in_cdr and in_ros1 and not others and not self._lines else None

    def finish(self) -> list[str]:
        self._close_run()
        return [f" {line}" for line in self._lines]

    def add_message(self, layout: Layout) -> None:
        if not layout.fields:
            self.add_zeros(1)
        for field in layout.fields:
            if (layout.name, field) == _SEQ:
                self._extend_run(SIZES[field.type], in_cdr=False)
            else:
                self._add_field(layout, field)

    def add_zeros(self, size: int) -> None:
        """Add bytes that only CDR has."""
        self._add(size, in_ros1=False)

    def align(self, size: int) -> None:
        if size <= self._modulus:
            self.add_zeros(-self._phase % size)
            return
        self._close_run()
        self._align_by_statement(size)
        self._modulus, self._phase = size, 0

    def _add(self, size: int, *, in_ros1: bool = True) -> None:
        if size:
            self._extend_run(size, in_ros1=in_ros1)
            self._phase = (self._phase + size) % self._modulus

    def _add_field(self, layout: Layout, field: Field) -> None:
        solid = _solid(layout, field)
        if solid is not None and field.array_length == VARIABLE:
            self._add_sequence(solid)
        elif solid is not None:
            self.align(solid.alignment)
            self._add(solid.size * abs(field.array_length))
        elif field.array_length != SCALAR:
            self._add_elements(layout, field)
        elif field.type == "string":
            self._add_text()
        else:
            self.add_message(layout.nested[field.type])

    def _add_text(self) -> None:
        """Add a text. Micro-ROS writes one that was never set as a length of 0, without the NUL."""
        self._read_count()
        self._check_end("o + 4 + n")
        if self._module.reads_cdr:
            self._refuse_if("n and b[e - 1]", "the text at {o} has no NUL at its end")
            self._lines.append("p += (pack(n - 1), b[o + 4:e - 1]) if n else (zeros[4],)")
        else:
            self._lines += ["p += (pack(n + 1), b[o + 4:e], zeros[1])", "d += 1"]
        self._lines.append("o = e")
        self._modulus, self._phase = 1, 0

    def _add_sequence(self, solid: _Solid) -> None:
        """Add a list of values to copy. An empty one has no padding after its count."""
        self._read_count()
        if solid.alignment > COUNT_BYTES:
            self._lines += ["p.append(b[o:o + 4])", "o += 4", "if n:"]
            self._align_by_statement(solid.alignment, indent=" ")
            self._check_end(f"o + n * {solid.size}")
        else:
            self._check_end(f"o + 4 + n * {solid.size}")
        self._lines += ["p.append(b[o:e])", "o = e"]
        self._modulus, self._phase = min(COUNT_BYTES, solid.size & -solid.size), 0

    def _add_elements(self, layout: Layout, field: Field) -> None:
        """Add a list or an array of texts, or of messages that are not only copied."""
        element = _TEXT if field.type == "string" else layout.nested[field.type]
        count = str(field.array_length)
        if field.array_length == VARIABLE:
            self._read_count()
            least_bytes = 1 if self._module.reads_cdr else element.minimum_bytes
            self._refuse_if(f"n * {least_bytes} > size - o - 4", "{n} elements at {o}")
            if element.minimum_bytes == 0:
                self._refuse_if(f"n > {EMPTY_ELEMENTS_MAX}", "{n} elements without fields")
            self._lines += ["p.append(b[o:o + 4])", "o += 4"]
            count = "n"
        self._close_run()
        self._lines += [f"for _ in range({count}):", *self._module.element(element)]
        has_empty = element.room > element.minimum_bytes  # messages without fields, each of which is a byte in CDR
        if has_empty and not self._module.reads_cdr:
            self._refuse_if(f"o + d > {ENCODED_BYTES_MAX}", f"more than {ENCODED_BYTES_MAX} bytes in CDR", indent=" ")
        self._modulus, self._phase = 1, 0

    def _read_count(self) -> None:
        self.align(COUNT_BYTES)
        self._close_run()
        self._lines.append("n, = unpack(b, o)")

    def _check_end(self, end: str) -> None:
        self._lines.append(f"e = {end}")
        self._refuse_if("e > size", "{e - size} bytes are missing at {o}")

    def _refuse_if(self, condition: str, text: str, *, indent: str = "") -> None:
        """Write the statement that refuses the payload. `text` is that of an f-string."""
        self._lines.append(f"{indent}if {condition}: raise UncommonLayout(f'{text}')")

    def _align_by_statement(self, size: int, *, indent: str = "") -> None:
        if self._module.reads_cdr:
            self._lines.append(f"{indent}o = (o + {size - 1}) & -{size}")
        else:
            lines = (f"k = -(o + d) & {size - 1}", "p.append(zeros[k])", "d += k")
            self._lines += [f"{indent}{line}" for line in lines]

    def _extend_run(self, size: int, *, in_cdr: bool = True, in_ros1: bool = True) -> None:
        if self._run and self._run[-1][1:] == (in_cdr, in_ros1):
            size += self._run.pop()[0]
        self._run.append((size, in_cdr, in_ros1))

    def _close_run(self) -> None:
        """Write the statements that copy the open run."""
        parts: list[str] = []
        at = grown = 0  # offset in what is read; bytes by which the result is longer
        for size, in_cdr, in_ros1 in self._run:
            is_read, is_written = (in_cdr, in_ros1) if self._module.reads_cdr else (in_ros1, in_cdr)
            if is_read and is_written:
                parts.append(f"b[o + {at}:o + {at + size}]")
            elif is_written:
                parts.append(f"zeros[{size}]" if size < _ALIGNMENT_MAX else f"bytes({size})")
            at += size * is_read
            grown += size * (is_written - is_read)
        if at:
            self._check_end(f"o + {at}")
        if parts:
            self._lines.append(f"p += ({', '.join(parts)},)")
        if at:
            self._lines.append("o = e")
        if grown and not self._module.reads_cdr:
            self._lines.append(f"d += {grown}")
        self._run = []


def _solid(layout: Layout, field: Field) -> _Solid | None:
    """Return the value of a field, or the element of a list, as one to copy; None if it is not."""
    if field.type in SIZES:
        return _Solid(SIZES[field.type], SIZES[field.type])
    if field.type == "string" or not layout.nested[field.type].fields:
        return None
    inner = layout.nested[field.type]
    alignment = size = 0
    for part in inner.fields:
        is_copied = part.array_length != VARIABLE and (inner.name, part) != _SEQ
        solid = _solid(inner, part) if is_copied else None
        if solid is None:
            return None
        alignment = alignment or solid.alignment  # that of the first part
        if solid.alignment > alignment or size % solid.alignment:
            return None
        size += solid.size * abs(part.array_length)
    return None if size % alignment else _Solid(alignment, size)
