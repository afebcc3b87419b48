"""Messages for a reader whose buffer is small: texts are cut, nothing else is."""

from collections.abc import Mapping

from hostlink.messages.fields import SCALAR
from hostlink.messages.message_type import MessageType


def encode_within(type_: MessageType, message: Mapping[str, object], limit_bytes: int) -> bytes | None:
    """The message, its longest texts cut where it would be over the limit; None: without any text it still is.

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
        values[name] = texts[name][:kept_bytes].decode(errors="ignore")  # never in the middle of a character
        payload = type_.encode(values)
        if len(payload) <= limit_bytes:
            return payload
    return None
