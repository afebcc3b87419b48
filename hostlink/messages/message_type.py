"""One message type, one service type: the definition, its md5 sum by the rule of ROS 1, and its codec."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from hostlink.messages import validating_codec
from hostlink.messages.codec import UNCOMMON_LAYOUT, Decoder, Encoder, compile_decoder, compile_encoder
from hostlink.messages.fields import DURATION, TIME, Constant, Field, Layout
from hostlink.messages.parsing import Definition

SEPARATOR: Final = "=" * 80
_EMPTY: Final = "\n"


class MessageType:
    """What the payloads of one type mean. The codec is compiled when it is first used."""

    def __init__(self, definition: Definition, nested: "Mapping[str, MessageType]") -> None:
        """`nested`: the type of every field that is a message, by its full name."""
        layouts = {name: message.layout for name, message in nested.items()}
        self.name: str = definition.name
        self.definition: str = definition.text
        self.constants: tuple[Constant, ...] = definition.constants
        layouts |= {"time": TIME, "duration": DURATION}
        self.layout: Layout = Layout(definition.name, definition.fields, layouts)
        self.nested: Mapping[str, MessageType] = nested
        self.fallbacks = 0  # messages and payloads that the compiled codec left to the validating one

    @property
    def fields(self) -> tuple[Field, ...]:
        return self.layout.fields

    @property
    def fixed_bytes(self) -> int | None:
        """The serialised size where every value has the same, else None."""
        return self.layout.fixed_bytes

    @cached_property
    def has_time(self) -> bool:
        """Whether a time stands anywhere in it."""
        return any(field.type == "time" for field in self.fields) or any(
            nested.has_time for nested in self.nested.values()
        )

    @cached_property
    def md5_text(self) -> str:
        """What the md5 sum is the sum of: constants, fields; a message in it is the md5 sum of its type."""
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
        """The definition and those of all types in it, each once, as `gendeps --cat` of ROS prints them.

        An empty one is an empty line: rospy, which reads such texts, needs an end of the line behind its name.
        """
        dependencies: dict[str, str] = {}
        _collect_definitions(self, dependencies)
        return self.definition + "".join(
            f"{SEPARATOR}\nMSG: {name}\n{definition or _EMPTY}" for name, definition in dependencies.items()
        )

    def encode(self, message: Mapping[str, object]) -> bytes:
        """The payload; missing fields are zero.

        Raises:
            BadRequest: a field is unknown or has a wrong value, or the message is too long.
        """
        encode = self._encoder  # compiled before the fallback is near: a compiler that fails is no uncommon message
        try:
            payload = encode(message)
        except UNCOMMON_LAYOUT:
            try:
                payload = encode(_completed(message, self._zero))
            except UNCOMMON_LAYOUT:
                self.fallbacks += 1
                return validating_codec.encode(self.layout, message)
        validating_codec.check_size(len(payload), self.name)
        return payload

    def decode(self, payload: bytes | memoryview) -> dict[str, object]:
        """A dict in field order.

        Text that is not UTF-8 gets replacement characters, so that every decoded message can become JSON.

        Raises:
            BadPayload: the payload is not exactly one message.
        """
        decode = self._decoder
        data = bytes(payload)
        try:
            return decode(data)
        except UNCOMMON_LAYOUT:
            self.fallbacks += 1
            return validating_codec.decode(self.layout, data)

    @cached_property
    def _zero(self) -> dict[str, object]:
        """A message of nothing but zeros."""
        return self.decode(validating_codec.encode(self.layout, {}))

    @cached_property
    def _encoder(self) -> Encoder:
        return compile_encoder(self.layout)

    @cached_property
    def _decoder(self) -> Decoder:
        return compile_decoder(self.layout)


@dataclass(frozen=True, slots=True)
class ServiceType:
    """The two message types of a service."""

    name: str
    request: MessageType
    response: MessageType

    @property
    def md5(self) -> str:
        return _md5(self.request.md5_text + self.response.md5_text)


def _completed(message: Mapping[str, object], zero: dict[str, object]) -> dict[str, object]:
    """The message with zeros for the fields that are missing; one of UNCOMMON_LAYOUT if it has others."""
    completed = {**zero, **message}
    if len(completed) != len(zero):
        raise LookupError("an unknown field")
    for name, value in message.items():
        default = zero[name]
        if isinstance(default, dict):
            completed[name] = _completed(value, default)  # type: ignore[arg-type]  # a TypeError if it is none
    return completed


def _collect_definitions(message: MessageType, definitions: dict[str, str]) -> None:
    """Add the definitions of all types in the message, depth first."""
    for nested in message.nested.values():
        if nested.name not in definitions:
            definitions[nested.name] = nested.definition
            _collect_definitions(nested, definitions)


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()
