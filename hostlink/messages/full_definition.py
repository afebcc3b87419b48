"""A definition with all that it contains, as recordings and ROS 1's connections have it: text in, type out."""

import re

from hostlink.errors import ConfigError
from hostlink.messages.catalog import NESTING_MAX
from hostlink.messages.fields import BUILT_IN
from hostlink.messages.message_type import SEPARATOR, MessageType
from hostlink.messages.parsing import Definition, parse_message

_NEXT = re.compile(rf"^{re.escape(SEPARATOR)}\s*\nMSG: *(\S+) *\n", re.MULTILINE)


def read_full_definition(name: str, text: str) -> MessageType:
    """The type of that name, from a text that also has every type in it.

    Raises:
        ConfigError: the text is no definition, or lacks a type.
    """
    first, *rest = _NEXT.split(text)
    texts = {name: first} | dict(zip(rest[::2], rest[1::2], strict=True))
    definitions = {each: parse_message(each, part, each) for each, part in texts.items()}
    return _build(name, definitions, {}, ())


def _build(
    name: str, definitions: dict[str, Definition], built: dict[str, MessageType], outer: tuple[str, ...]
) -> MessageType:
    if name in built:
        return built[name]
    definition = definitions.get(name)
    if definition is None:
        raise ConfigError(outer[-1] if outer else name, f"the definition of {name} is not in it")
    if name in outer or len(outer) > NESTING_MAX:
        raise ConfigError(name, "contains itself")
    inner = {field.type for field in definition.fields if field.type not in BUILT_IN}
    nested = {each: _build(each, definitions, built, (*outer, name)) for each in sorted(inner)}
    built[name] = MessageType(definition, nested)
    return built[name]
