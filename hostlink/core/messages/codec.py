"""Compiled codec, payload <-> dict. It is Python source with one struct for each run of fixed fields.

The compiled functions are fast and strict: they accept complete messages of plain values and intact payloads, and raise
one of UNCOMMON_LAYOUT for everything else. `validating_codec` then does the work slowly, accepts every permitted form,
or names what is wrong.
"""

import struct
from collections.abc import Callable, Mapping
from typing import Any, Final, cast

from hostlink.core.messages.fields import EMPTY_ELEMENTS_MAX, FORMATS, SCALAR, VARIABLE, Field, Layout

Encoder = Callable[[Mapping[str, object]], bytes]
Decoder = Callable[[bytes], dict[str, object]]

UNCOMMON_LAYOUT: Final = (ValueError, TypeError, LookupError, AttributeError, OverflowError, struct.error)


def compile_encoder(layout: Layout) -> Encoder:
    """Compile the function that encodes a complete message."""
    module = _Module()
    module.add_encoder(layout)
    return cast("Encoder", module.load()["encode_0"])


def compile_decoder(layout: Layout) -> Decoder:
    """Compile the function that decodes a whole payload to a dict."""
    module = _Module()
    module.add_decoder(layout)
    return cast("Decoder", module.load()["decode_0"])


class _Module:
    """Source of the functions for one type and for the element types of its arrays."""

    def __init__(self) -> None:
        self.names: dict[str, Any] = {"UncommonLayout": ValueError, "bools": frozenset({bool})}
        self.names |= {"pack": struct.pack, "unpack": struct.unpack_from}
        self._functions: dict[Layout, str] = {}
        self._lines: list[str] = []

    def add_encoder(self, layout: Layout) -> str:
        """Add the function that encodes the layout. Return its name."""
        if layout not in self._functions:
            self._functions[layout] = f"encode_{len(self._functions)}"
            body = _EncoderBody(self)
            body.write_message(layout, "m")
            self._lines += [f"def {self._functions[layout]}(m):", *body.finish()]
        return self._functions[layout]

    def add_decoder(self, layout: Layout) -> str:
        """Add the function that decodes a whole payload of the layout. Return its name."""
        name = self._functions[layout] = f"decode_{len(self._functions)}"
        body = _DecoderBody(self)
        value = body.read_message(layout)
        self._lines += [f"def {name}(b):", " o = 0", " size = len(b)", *body.finish()]
        self._lines += [" if o != size: raise UncommonLayout", f" return {value}"]
        return name

    def add_reader(self, layout: Layout) -> str:
        """Add the function that reads one element at an offset: (b, o, size) -> value, next offset. Return its name."""
        if layout not in self._functions:
            name = self._functions[layout] = f"read_{len(self._functions)}"
            body = _DecoderBody(self)
            value = body.read_message(layout)
            self._lines += [f"def {name}(b, o, size):", *body.finish(), f" return {value}, o"]
        return self._functions[layout]

    def add_struct(self, codes: list[str]) -> tuple[struct.Struct, int]:
        """Add a struct. Return it and the number in its names: p<n> packs, u<n> unpacks at an offset."""
        compiled, number = struct.Struct(f"<{''.join(codes)}"), len(self.names)
        self.names[f"p{number}"] = compiled.pack
        self.names[f"u{number}"] = compiled.unpack_from
        return compiled, number

    def load(self) -> dict[str, Any]:
        # From a definition, only names that the parser has checked reach the source, each as a quoted literal.
        exec("\n".join(self._lines), self.names)  # noqa: S102
        return self.names


class _Body:
    """Statements of one function, with a run of fixed fields that is still open."""

    def __init__(self, module: _Module) -> None:
        self._module = module
        self._lines: list[str] = []
        self._codes: list[str] = []  # of the open run
        self._locals = 0

    def _local(self, expression: str) -> str:
        self._locals += 1
        self._lines.append(f"v{self._locals} = {expression}")
        return f"v{self._locals}"


class _DecoderBody(_Body):
    """Statements that read fields in wire order, and the expression that builds a dict of them."""

    def __init__(self, module: _Module) -> None:
        super().__init__(module)
        self._values = 0  # values in the tuple of the open run
        self._tuples = 0

    def finish(self) -> list[str]:
        self._close_run()
        return [f" {line}" for line in self._lines]

    def read_message(self, layout: Layout) -> str:
        items = [f"{field.name!r}: {self._read_field(layout, field)}" for field in layout.fields]
        return f"{{{', '.join(items)}}}"

    def _read_field(self, layout: Layout, field: Field) -> str:
        if field.array_length != SCALAR:
            return self._read_array(layout, field)
        if field.type == "string":
            return self._read_string()
        if field.type in FORMATS:
            return self._read_value(FORMATS[field.type])
        return self.read_message(layout.nested[field.type])

    def _read_array(self, layout: Layout, field: Field) -> str:
        if field.array_length != VARIABLE and field.type in FORMATS:
            return self._read_fixed_array(field)
        count = self._read_value("I") if field.array_length == VARIABLE else str(field.array_length)
        self._close_run()
        if field.type in FORMATS:
            return self._read_variable_array(field, count)
        if field.type == "string":
            return self._read_strings(count)
        return self._read_messages(layout.nested[field.type], field, count)

    def _read_fixed_array(self, field: Field) -> str:
        if field.is_octets:
            return self._read_value(f"{field.array_length}s")
        first = self._values
        self._read_value(f"{field.array_length}{FORMATS[field.type]}", field.array_length)
        return f"list(t{self._tuples}[{first}:{self._values}])"

    def _read_variable_array(self, field: Field, count: str) -> str:
        code = FORMATS[field.type]
        self._check_end(f"{count} * {struct.calcsize(f'<{code}')}")
        value = self._local("b[o:e]" if field.is_octets else f"list(unpack(f'<{{{count}}}{code}', b, o))")
        self._lines.append("o = e")
        return value

    def _read_string(self) -> str:
        length = self._read_value("I")
        self._close_run()
        self._check_end(length)
        value = self._local("b[o:e].decode('utf-8', 'replace')")
        self._lines.append("o = e")
        return value

    def _read_strings(self, count: str) -> str:
        value = self._local("[]")
        self._lines += [f"if {count} * 4 > size - o: raise UncommonLayout", f"for _ in range({count}):"]
        self._lines += [" e = o + 4 + unpack('<I', b, o)[0]", " if e > size: raise UncommonLayout"]
        self._lines += [f" {value}.append(b[o + 4:e].decode('utf-8', 'replace'))", " o = e"]
        return value

    def _read_messages(self, layout: Layout, field: Field, count: str) -> str:
        if layout.minimum_bytes == 0 and field.array_length == VARIABLE:
            self._lines.append(f"if {count} > {EMPTY_ELEMENTS_MAX}: raise UncommonLayout")
        value, reader = self._local("[]"), self._module.add_reader(layout)
        self._lines += [
            f"if {count} * {layout.minimum_bytes} > size - o: raise UncommonLayout",
            f"for _ in range({count}):",
        ]
        self._lines += [f" x, o = {reader}(b, o, size)", f" {value}.append(x)"]
        return value

    def _read_value(self, code: str, values: int = 1) -> str:
        """Add a value to the open run. Return the expression of its first value."""
        self._codes.append(code)
        self._values += values
        return f"t{self._tuples}[{self._values - values}]"

    def _close_run(self) -> None:
        if self._codes:
            compiled, number = self._module.add_struct(self._codes)
            self._lines += [f"t{self._tuples} = u{number}(b, o)", f"o += {compiled.size}"]
            self._codes, self._values = [], 0
            self._tuples += 1

    def _check_end(self, length: str) -> None:
        self._lines += [f"e = o + {length}", "if e > size: raise UncommonLayout"]


class _EncoderBody(_Body):
    """Statements that check and convert fields in wire order, and the parts of the payload."""

    def __init__(self, module: _Module) -> None:
        super().__init__(module)
        self._arguments: list[str] = []
        self._parts: list[str] = []

    def finish(self) -> list[str]:
        self._close_run()
        parts = self._parts
        payload = parts[0] if len(parts) == 1 else f"b''.join(({', '.join(parts)}))"
        return [f" {line}" for line in [*self._lines, f"return {payload}"]]

    def write_message(self, layout: Layout, message: str) -> None:
        """Write all fields of the message that the expression names. More or fewer fields raise UncommonLayout."""
        self._lines.append(f"if len({message}) != {len(layout.fields)}: raise UncommonLayout")
        for field in layout.fields:
            self._write_field(layout, field, f"{message}[{field.name!r}]")

    def _write_field(self, layout: Layout, field: Field, value: str) -> None:
        if field.array_length != SCALAR:
            self._write_array(layout, field, value)
        elif field.type == "string":
            self._write_octets(self._local(f"{value}.encode()"))
        elif field.type == "bool":
            name = self._local(value)
            self._lines.append(f"if {name} is not True and {name} is not False: raise UncommonLayout")
            self._add("?", name)
        elif field.type in FORMATS:
            name = self._local(value)
            self._lines.append(f"if {name} is True or {name} is False: raise UncommonLayout")
            self._add(FORMATS[field.type], name)
        else:
            self.write_message(layout.nested[field.type], self._local(value))

    def _write_array(self, layout: Layout, field: Field, value: str) -> None:
        name = self._local(value)
        self._lines.append(f"if type({name}) is not {'bytes' if field.is_octets else 'list'}: raise UncommonLayout")
        if field.array_length != VARIABLE:
            self._lines.append(f"if len({name}) != {field.array_length}: raise UncommonLayout")
        if field.type == "bool":
            self._lines.append(f"if not bools.issuperset(map(type, {name})): raise UncommonLayout")
        elif field.type in FORMATS and not field.is_octets:
            self._lines.append(f"if bool in map(type, {name}): raise UncommonLayout")
        if field.array_length != VARIABLE and field.type in FORMATS:
            self._write_fixed_array(field, name)
        elif field.is_octets:
            self._write_octets(name)
        else:
            self._write_elements(layout, field, name)

    def _write_fixed_array(self, field: Field, name: str) -> None:
        code = "s" if field.is_octets else FORMATS[field.type]
        self._add(f"{field.array_length}{code}", name if field.is_octets else f"*{name}")

    def _write_octets(self, name: str) -> None:
        self._add("I", f"len({name})")
        self._close_run()
        self._parts.append(name)

    def _write_elements(self, layout: Layout, field: Field, name: str) -> None:
        if field.array_length == VARIABLE:
            self._add("I", f"len({name})")
        self._close_run()
        if field.type in FORMATS:
            self._parts.append(f"pack(f'<{{len({name})}}{FORMATS[field.type]}', *{name})")
        elif field.type == "string":
            self._lines.append(f"{name} = [x.encode() for x in {name}]")
            self._parts.append(f"b''.join([pack('<I', len(x)) + x for x in {name}])")
        else:
            self._write_messages(layout.nested[field.type], field, name)

    def _write_messages(self, layout: Layout, field: Field, name: str) -> None:
        if layout.minimum_bytes == 0 and field.array_length == VARIABLE:
            self._lines.append(f"if len({name}) > {EMPTY_ELEMENTS_MAX}: raise UncommonLayout")
        self._parts.append(f"b''.join([{self._module.add_encoder(layout)}(x) for x in {name}])")

    def _add(self, code: str, argument: str) -> None:
        self._codes.append(code)
        self._arguments.append(argument)

    def _close_run(self) -> None:
        if self._codes or not self._parts:
            _, number = self._module.add_struct(self._codes)
            self._parts.append(f"p{number}({', '.join(self._arguments)})")
            self._codes, self._arguments = [], []
