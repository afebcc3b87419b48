"""Message: one payload on one topic, decoded only when somebody asks, and then once for all who do."""

from functools import cached_property

import msgspec

from hostlink.errors import BadPayload
from hostlink.messages.message_type import MessageType


class Message:
    """Bytes on their way from a device or a client to everybody who subscribed."""

    def __init__(self, topic: str, type_name: str, type_: MessageType | None, payload: bytes, stamp_ns: int) -> None:
        self.topic = topic
        self.type_name = type_name
        self.type = type_  # None: a type that nobody has a definition of; the payload passes as it is
        self.payload = payload
        self.stamp_ns = stamp_ns  # wall time of arrival
        self.frames: dict[tuple[str, str], bytes] = {}  # what clients are sent, by form and the name that they use

    @cached_property
    def decoded(self) -> dict[str, object]:
        """The fields; BadPayload when the bytes do not fit the type, or the type is unknown."""
        if self.type is None:
            raise BadPayload(self.type_name, "no definition; put its .msg into a folder named in message_folders")
        return self.type.decode(self.payload)

    @cached_property
    def json(self) -> bytes:
        """The fields as JSON: NaN is null, uint8[] is base64."""
        return msgspec.json.encode(self.decoded)
