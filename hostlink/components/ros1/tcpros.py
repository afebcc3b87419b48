"""TCPROS: connection headers and messages, as bytes. Pure.

A header is a length and fields of a length and `key=value` each; a message is a length and a payload.
"""

from collections.abc import Iterator, Mapping
from struct import Struct

from hostlink.core.messages.message_type import MessageType, ServiceType
from hostlink.core.runtime.logs import printable

MAX_HEADER_BYTES = 256 * 1024  # it contains the full definition of a message
MAX_FIELDS = 64
LENGTH_BYTES = 4
ANY = "*"  # type and md5 sum in a request that wants to learn them
REQUIRED = ("callerid", "md5sum")  # header fields of a node that connects

_LENGTH = Struct("<I")

Header = Mapping[str, str]


class BadHeader(Exception):
    """Connection header that is malformed, over the bounds, or refused by the node that reads it."""


def encode_header(fields: Header) -> bytes:
    """Encode with a leading length."""
    parts = [f"{key}={value}".encode() for key, value in fields.items()]
    body = b"".join(_LENGTH.pack(len(part)) + part for part in parts)
    return _LENGTH.pack(len(body)) + body


def decode_header(body: bytes) -> dict[str, str]:
    """Decode the fields of a header, given without its length.

    Raises:
        BadHeader: it is malformed.
    """
    fields: dict[str, str] = {}
    at = 0
    while at < len(body):
        begin = at + LENGTH_BYTES
        if begin > len(body) or len(fields) >= MAX_FIELDS:
            raise BadHeader("a field is cut off, or there are too many")
        at = begin + int(_LENGTH.unpack_from(body, at)[0])
        part = body[begin:at]
        key, equals, value = part.partition(b"=")
        if at > len(body) or not equals or not key:
            raise BadHeader("a field is not of the form key=value")
        fields[key.decode(errors="replace")] = value.decode(errors="replace")
    return fields


def decode_answer_header(body: bytes) -> dict[str, str]:
    """Decode the header by which a node answers one.

    Raises:
        BadHeader: it is malformed, or an error.
    """
    header = decode_header(body)
    if "error" in header:
        raise BadHeader(header["error"])
    return header


def check_header(header: Header, name: str, type_: MessageType | ServiceType) -> None:
    """Check the header of a node that connects to the topic or service `name`.

    Raises:
        BadHeader: it does not fit.
    """
    for field in REQUIRED:
        if field not in header:
            raise BadHeader(f"missing field {field}")
    if header["md5sum"] not in (ANY, type_.md5):
        raise BadHeader(f"{name} is a {type_.name} with md5 {type_.md5}, not {printable(header['md5sum'])}")


def encode_message(payload: bytes) -> bytes:
    """Encode with a leading length."""
    return _LENGTH.pack(len(payload)) + payload


def encode_answer(payload: bytes) -> bytes:
    """Encode the answer of a service call that succeeded."""
    return b"\x01" + encode_message(payload)


def encode_failure(reason: str) -> bytes:
    """Encode the answer of a service call that failed."""
    return b"\x00" + encode_message(reason.encode())


class MessageStream:
    """Cuts a stream into messages; one over `max_bytes`, which may change between two, is passed over and counted.

    A connection header has the form of a message, and is the first.
    """

    def __init__(self, max_bytes: int) -> None:
        self.max_bytes = max_bytes
        self.too_large = 0
        self._buffer = bytearray()
        self._skipping_bytes = 0  # still to come of a message that is too large

    @property
    def missing_bytes(self) -> int:
        """Bytes that complete the current message; 0 without a message or before its length is known."""
        if self._skipping_bytes:
            return self._skipping_bytes
        if len(self._buffer) < LENGTH_BYTES:
            return 0
        return int(_LENGTH.unpack_from(self._buffer)[0]) + LENGTH_BYTES - len(self._buffer)

    def feed(self, data: bytes) -> Iterator[bytes]:
        """The payloads that are complete by now; all of them must be consumed."""
        self._buffer += data
        at = 0
        try:
            while True:
                skipped_bytes = min(self._skipping_bytes, len(self._buffer) - at)
                self._skipping_bytes -= skipped_bytes
                at += skipped_bytes
                if len(self._buffer) < at + LENGTH_BYTES:
                    return
                size = int(_LENGTH.unpack_from(self._buffer, at)[0])
                end = at + LENGTH_BYTES + size
                if size > self.max_bytes:
                    self.too_large += 1
                    self._skipping_bytes = LENGTH_BYTES + size
                elif end > len(self._buffer):
                    return
                else:
                    payload = bytes(self._buffer[at + LENGTH_BYTES : end])
                    at = end
                    yield payload
        finally:
            del self._buffer[:at]
