"""NonRosserialBytes: what came from a device and is no frame, as far as a diagnosis needs it."""

from hostlink.protocol.frame import PROTOCOL_1_MAX_BYTES, contains_protocol_1

KEPT_BYTES = 1024  # some boot messages, or a hundred lines of a counter's text


class NonRosserialBytes:
    """The last of the skipped bytes, and whether they were frames of protocol version 1."""

    def __init__(self) -> None:
        self.is_protocol_1 = False
        self.tail = b""

    def add(self, data: bytes) -> bool:
        """Keep skipped bytes; True the first time that they hold a frame of protocol version 1."""
        watched = self.tail[1 - PROTOCOL_1_MAX_BYTES :] + data
        self.tail = (self.tail + data)[-KEPT_BYTES:]
        if self.is_protocol_1 or not contains_protocol_1(watched):
            return False
        self.is_protocol_1 = True
        return True
