"""MessageType and ServiceType: definition, md5 sum by the rule of ROS 1, and codec."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from hostlink.core.messages import validating_codec
from hostlink.core.messages.codec import UNCOMMON_LAYOUT, Decoder, Encoder, compile_decoder, compile_encoder
from hostlink.core.messages.fields import DURATION, TIME, Constant, Field, Layout
from hostlink.core.messages.parsing import Definition

SEPARATOR: Final = "=" * 80
_EMPTY: Final = "\n"


class MessageType:
    """One message type and its codec. The codec is compiled at its first use."""

    def __init__(self, definition: Definition, nested: "Mapping[str, MessageType]") -> None:
        """`nested`: the type of every field that is a message, by its full name."""
        layouts = {name: message.layout for name, message in nested.items()}
        self.name: str = definition.name
        self.definition: str = definition.text
        self.constants: tuple[Constant, ...] = definition.constants
        layouts |= {"time": TIME, "duration": DURATION}
        self.layout: Layout = Layout(definition.name, definition.fields, layouts)
        self.nested: Mapping[str, MessageType] = nested

    @property
    def fields(self) -> tuple[Field, ...]:
        return self.layout.fields

    @cached_property
    def least_bytes(self) -> int:
        """Size of the smallest message."""
        return self.layout.minimum_bytes

    @property
    def fixed_bytes(self) -> int | None:
        """Serialised size if every value has the same size, else None."""
        return self.layout.fixed_bytes

    @cached_property
    def has_time(self) -> bool:
        """Whether the type or a nested type has a time field."""
        return any(field.type == "time" for field in self.fields) or any(
            nested.has_time for nested in self.nested.values()
        )

    @cached_property
    def md5_text(self) -> str:
        """Input of the md5 sum: constants and fields; a nested message is represented by its own md5 sum."""
        lines = [f"{constant.type} {constant.name}={constant.text}" for constant in self.constants]
        for field in self.fields:
            nested = self.nested.get(field.type)
            lines.append(f"{nested.md5 if nested else field.type_text} {field.name}")
        return "\n".join(lines)

    @cached_property
    def md5(self) -> str:
        return _md5(self.md5_text)

    @cached_property
    def full_definition(self) -> str:
        """The definition followed by those of all nested types, each once, as `gendeps --cat` of ROS prints them.

        An empty definition becomes an empty line, because rospy needs a line end after the type's name.
        """
        dependencies: dict[str, str] = {}
        _collect_definitions(self, dependencies)
        return self.definition + "".join(
            f"{SEPARATOR}\nMSG: {name}\n{definition or _EMPTY}" for name, definition in dependencies.items()
        )

    def encode(self, message: Mapping[str, object]) -> bytes:
        """Encode a message. Missing fields are zero.

        Raises:
            BadRequest: a field is unknown or has a wrong value, or the message is too long.
        """
        encode = self._encoder  # outside the try: a failing compiler must not look like an uncommon message
        try:
            payload = encode(message)
        except UNCOMMON_LAYOUT:
            try:
                payload = encode(completed(message, self._zero))
            except UNCOMMON_LAYOUT:
                return validating_codec.encode(self.layout, message)
        validating_codec.check_size(len(payload), self.name)
        return payload

    def decode(self, payload: bytes | memoryview) -> dict[str, object]:
        """Decode a payload to a dict in field order.

        Text that is not UTF-8 gets replacement characters, so that every decoded message can be written as JSON.

        Raises:
            BadPayload: the payload is not exactly one message.
        """
        decode = self._decoder
        data = bytes(payload)
        try:
            return decode(data)
        except UNCOMMON_LAYOUT:
            return validating_codec.decode(self.layout, data)

    @cached_property
    def _zero(self) -> dict[str, object]:
        """The message whose fields are all zero."""
        return self.decode(validating_codec.encode(self.layout, {}))

    @cached_property
    def _encoder(self) -> Encoder:
        return compile_encoder(self.layout)

    @cached_property
    def _decoder(self) -> Decoder:
        return compile_decoder(self.layout)


@dataclass(frozen=True, slots=True)
class ServiceType:
    """Request and response type of a service."""

    name: str
    request: MessageType
    response: MessageType

    @property
    def md5(self) -> str:
        return _md5(self.request.md5_text + self.response.md5_text)


def completed(message: Mapping[str, object], zero: dict[str, object]) -> dict[str, object]:
    """Fill in zeros for missing fields. Raise one of UNCOMMON_LAYOUT if the message has unknown fields."""
    found = {**zero, **message}
    if len(found) != len(zero):
        raise LookupError("an unknown field")
    for name, value in message.items():
        default = zero[name]
        if isinstance(default, dict):
            found[name] = completed(value, default)  # type: ignore[arg-type]  # a TypeError if the value is not a mapping
    return found


def _collect_definitions(message: MessageType, definitions: dict[str, str]) -> None:
    """Add the definitions of all nested types, depth first."""
    for nested in message.nested.values():
        if nested.name not in definitions:
            definitions[nested.name] = nested.definition
            _collect_definitions(nested, definitions)


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
