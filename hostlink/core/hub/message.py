"""Message: one payload on one topic, as received. It is decoded at the first request for its fields, once for all."""

from collections.abc import Callable, Hashable

from hostlink.core.messages.message_type import MessageType
from hostlink.core.messages.serialisation import ROS1
from hostlink.errors import BadPayload

PROGRAM_PRIORITY = 50  # of a program that gives none


class Message:
    """Bytes on their way from a device or a participant to every subscriber.

    `stamp_ns` and `at_s` are wall time and loop time of the arrival. `priority` and `epoch` are those of a
    `Command`, and matter to a velocity gate alone.
    """

    __slots__ = (
        "_decoded", "_made", "at_s", "encoding", "epoch", "payload", "priority", "source", "stamp_ns", "topic", "type",
        "type_name",
    )  # fmt: skip

    def __init__(
        self,
        topic: str,
        type_name: str,
        type_: MessageType | None,
        payload: bytes,
        *,
        source: Hashable,
        stamp_ns: int,
        at_s: float,
        priority: int = PROGRAM_PRIORITY,
        epoch: int | None = None,
        encoding: str = ROS1,
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        self.type = type_  # None: the type has no definition here; the payload passes unchanged
        self.encoding = encoding  # serialisation of the payload: ROS1, or CDR of a type without a definition
        self.payload = payload
        self.source = source
        self.stamp_ns = stamp_ns
        self.at_s = at_s
        self.priority = priority
        self.epoch = epoch
        self._decoded: dict[str, object] | None = None
        self._made: dict[Hashable, bytes] | None = None

    @property
    def decoded(self) -> dict[str, object]:
        """Decoded fields.

        Raises:
            BadPayload: the bytes do not fit the type, or the type is unknown.
        """
        if self._decoded is None:
            if self.type is None:
                raise BadPayload(self.type_name, "no definition; put its .msg into a folder named in message_folders")
            self._decoded = self.type.decode(self.payload)
        return self._decoded

    def made(self, form: Hashable, make: Callable[["Message"], bytes]) -> bytes:
        """Return the message in another form, which is made once for all subscribers."""
        if self._made is None:
            self._made = {}
        if form not in self._made:
            self._made[form] = make(self)
        return self._made[form]
