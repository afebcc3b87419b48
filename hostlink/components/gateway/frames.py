"""WebSocket frames (RFC 6455, 5.2): the heads of those to a client, and where those of a client begin and end. Pure."""

import struct

FINAL_TEXT, FINAL_BINARY, PING, PONG = 0x81, 0x82, 0x89, 0x8A  # first bytes of whole, not compressed messages
_FINAL, _CONTROL = 0x80, 0x08  # bits of the first byte
_MASKED, _SIZE = 0x80, 0x7F  # of the second byte
_MEDIUM, _LARGE = 126, 127  # the size is in the next two bytes, or in the next eight
_MAX_SHORT, _MAX_MEDIUM = 125, 0xFFFF  # largest payloads whose size takes one byte and two bytes
_MASK_BYTES = 4


def frame_head(size_bytes: int, *, is_binary: bool) -> bytes:
    """Encode the head of a server's frame: a whole message, unmasked, not compressed."""
    first = FINAL_BINARY if is_binary else FINAL_TEXT
    if size_bytes <= _MAX_SHORT:
        return bytes((first, size_bytes))
    if size_bytes <= _MAX_MEDIUM:
        return struct.pack("!BBH", first, _MEDIUM, size_bytes)
    return struct.pack("!BBQ", first, _LARGE, size_bytes)


def control_frame(first: int, payload: bytes) -> bytes:
    """Encode a ping or a pong."""
    return bytes((first, len(payload))) + payload


class ClientFrames:
    """Bounds of the frames in the bytes of one client: finds out whether a read is one whole text message.

    Every read is either a message that `text_of` has returned, or is passed to `skip`.
    """

    __slots__ = ("_head", "_is_fragmented", "_rest_bytes")

    def __init__(self) -> None:
        self._head = b""  # an incomplete head
        self._rest_bytes = 0  # of an incomplete frame
        self._is_fragmented = False  # the frames of a message are incomplete

    def text_of(self, data: bytes) -> bytes | None:
        """Return the payload of a read that is one whole text message in one frame; None for any other read."""
        if data[0] != FINAL_TEXT or self._rest_bytes or self._head or self._is_fragmented or len(data) <= _MASK_BYTES:
            return None
        size, start = data[1] - _MASKED, 2  # every frame of a client is masked
        if size == _MEDIUM:
            size, start = data[2] << 8 | data[3], 4
        begin = start + _MASK_BYTES
        if not 0 < size <= _MAX_MEDIUM or len(data) - begin != size or data[1] - _MASKED == _LARGE:
            return None
        mask = data[start:begin] * (size // _MASK_BYTES + 1)
        masked = int.from_bytes(data[begin:], "little") ^ int.from_bytes(mask[:size], "little")
        return masked.to_bytes(size, "little")

    def skip(self, data: bytes) -> None:
        """Note the bounds in other bytes."""
        if self._head:
            data, self._head = self._head + data, b""
        at = self._rest_bytes
        while at < len(data):
            left = len(data) - at
            code = data[at + 1] & _SIZE if left > 1 else 0
            extra = 8 if code == _LARGE else 2 if code == _MEDIUM else 0
            begin = 2 + extra + (_MASK_BYTES if left > 1 and data[at + 1] & _MASKED else 0)
            if left < begin:
                self._head, self._rest_bytes = data[at:], 0
                return
            if not data[at] & _CONTROL:
                self._is_fragmented = not data[at] & _FINAL
            at += begin + (int.from_bytes(data[at + 2 : at + 2 + extra]) if extra else code)
        self._rest_bytes = at - len(data)
