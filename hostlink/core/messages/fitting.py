"""Encode messages for a receiver with a small buffer, by shortening strings."""

from collections.abc import Mapping

from hostlink.core.messages.fields import SCALAR
from hostlink.core.messages.message_type import MessageType


def encode_within(type_: MessageType, message: Mapping[str, object], limit_bytes: int) -> bytes | None:
    """Encode the message, with its longest strings shortened to `limit_bytes`; None if it does not fit without them.

    Raises:
        BadRequest: the message does not fit the type.
    """
    payload = type_.encode(message)
    if len(payload) <= limit_bytes:
        return payload
    values = type_.decode(payload)
    texts = {
        field.name: str(values[field.name]).encode()
        for field in type_.fields
        if field.type == "string" and field.array_length == SCALAR
    }
    for name in sorted(texts, key=lambda name: len(texts[name]), reverse=True):
        kept_bytes = max(len(texts[name]) - (len(payload) - limit_bytes), 0)
        values[name] = texts[name][:kept_bytes].decode(errors="ignore")  # a character is never cut in two
        payload = type_.encode(values)
        if len(payload) <= limit_bytes:
            return payload
    return None
