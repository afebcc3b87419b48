"""Messages of DDS-XRCE as bytes: header, submessages and their fields.

A message is a header and submessages, each aligned to 4 bytes. Any bytes decode to a value; what is damaged is None, or
is left out. Object ids and request ids are two bytes in the order of the wire, read as one number: object 0x0015 has
number 1 and kind 5.
"""

import struct
from enum import IntEnum
from typing import Final, NamedTuple

HEADER: Final = struct.Struct("<BBH")  # session, stream, number; a session below KEYLESS has the client's key behind it
KEYLESS: Final = 0x80
KEY_BYTES: Final = 4
SUBHEADER_BYTES: Final = 4
ALIGNMENT: Final = 4
LITTLE: Final = 0x01  # flag: integers of the submessage are little endian
REUSE: Final = 0x02  # flags of CREATE
REPLACE: Final = 0x04
LAST_FRAGMENT: Final = 0x02
FORMAT: Final = 0x0E  # flags of WRITE_DATA and DATA; 0: one plain sample
NO_STREAM: Final = 0x00
BEST_EFFORT: Final = 0x01  # the first of these streams
RELIABLE: Final = 0x80  # the first of these streams
COOKIE: Final = b"XRCE"
VERSION: Final = b"\x01\x00"
VENDOR: Final = b"\x01\x0f"
AGENT_ID: Final = 0xFFFD
CLIENT_ID: Final = 0xFFFE
UNLIMITED: Final = 0xFFFF  # samples of a READ_DATA
SAMPLE_IDENTITY_BYTES: Final = 24
REQUEST_BYTES: Final = 4  # request id and object id
STRING_BYTES_MAX: Final = 1024  # a client's XML has at most 512
SUBMESSAGES_MAX: Final = 1024  # of one message: their work is bounded
NUMBERS: Final = 0x10000  # sequence numbers

PROPERTIES_MAX: Final = 16


class Kind(IntEnum):
    """Kind of a submessage."""

    CREATE_CLIENT = 0
    CREATE = 1
    GET_INFO = 2
    DELETE = 3
    STATUS_AGENT = 4
    STATUS = 5
    INFO = 6
    WRITE_DATA = 7
    READ_DATA = 8
    DATA = 9
    ACKNACK = 10
    HEARTBEAT = 11
    RESET = 12
    FRAGMENT = 13
    TIMESTAMP = 14
    TIMESTAMP_REPLY = 15


_OF_CLIENTS: Final = frozenset(
    {Kind.CREATE, Kind.DELETE, Kind.WRITE_DATA, Kind.READ_DATA, Kind.ACKNACK, Kind.HEARTBEAT, Kind.FRAGMENT}
)


class ObjectKind(IntEnum):
    """Kind of an object: the low four bits of its id."""

    PARTICIPANT = 1
    TOPIC = 2
    PUBLISHER = 3
    SUBSCRIBER = 4
    DATAWRITER = 5
    DATAREADER = 6
    REQUESTER = 7
    REPLIER = 8
    TYPE = 10
    QOS_PROFILE = 11
    APPLICATION = 12
    AGENT = 13
    CLIENT = 14


class Status(IntEnum):
    """Result of a request of a client."""

    OK = 0x00
    MATCHED = 0x01  # the object exists as it was requested
    MISMATCH = 0x81
    ALREADY_EXISTS = 0x82
    UNKNOWN_REFERENCE = 0x84
    INVALID_DATA = 0x85
    INCOMPATIBLE = 0x86
    RESOURCES = 0x87


class Representation(IntEnum):
    """Form in which a client describes an object."""

    REFERENCE = 1
    XML = 2
    BINARY = 3


# -- messages ---------------------------------------------------------------------------------------------------------


class Submessage(NamedTuple):
    """One submessage. `kind` may be one that is not known."""

    kind: int
    flags: int
    payload: bytes


class Message(NamedTuple):
    """One message. `body` has the submessages; `key` is empty where the session id needs none."""

    session: int
    stream: int
    number: int
    key: bytes
    body: bytes


def decode_message(data: bytes) -> Message | None:
    """Decode the header of a message; None when it is not whole."""
    if len(data) < HEADER.size:
        return None
    session, stream, number = HEADER.unpack_from(data)
    if session >= KEYLESS:
        return Message(session, stream, number, b"", data[HEADER.size :])
    start = HEADER.size + KEY_BYTES
    return Message(session, stream, number, data[HEADER.size : start], data[start:]) if len(data) >= start else None


def decode_submessages(body: bytes) -> tuple[list[Submessage], int]:
    """Decode the whole submessages of a body. Also return how many bytes at the end are in none.

    A WRITE_DATA of more than 65,535 bytes has the length 0, or the low 16 bits of its length: it ends with the body.
    """
    size_bytes = len(body)
    if size_bytes >= SUBHEADER_BYTES:  # nearly always one
        kind, flags = body[0], body[1]
        length = body[2] | body[3] << 8 if flags & LITTLE else body[3] | body[2] << 8
        if length == size_bytes - SUBHEADER_BYTES:
            return [Submessage(kind, flags, body[SUBHEADER_BYTES:])], 0
    found: list[Submessage] = []
    at = 0
    while at + SUBHEADER_BYTES <= len(body) and len(found) < SUBMESSAGES_MAX:
        kind, flags = body[at], body[at + 1]
        length = int.from_bytes(body[at + 2 : at + 4], "little" if flags & LITTLE else "big")
        start = at + SUBHEADER_BYTES
        rest_bytes = len(body) - start
        if kind == Kind.WRITE_DATA and rest_bytes >= NUMBERS and length in {0, rest_bytes % NUMBERS}:
            length = rest_bytes
        if length > rest_bytes:
            return found, len(body) - at
        found.append(Submessage(kind, flags, body[start : start + length]))
        at = start + length
        at += -at % ALIGNMENT
    return found, max(len(body) - at, 0)


def encode_message(session: int, key: bytes, stream: int, number: int, body: bytes) -> bytes:
    """Encode a message. `key` is left out where the session id needs none."""
    return HEADER.pack(session, stream, number) + (key if session < KEYLESS else b"") + body


def encode_submessage(kind: int, payload: bytes, flags: int = LITTLE) -> bytes:
    """Encode a submessage without the padding behind it."""
    return bytes((kind, flags)) + (len(payload) & (NUMBERS - 1)).to_bytes(2, "little") + payload


def join_submessages(*submessages: bytes) -> bytes:
    """Join submessages, each aligned."""
    joined = b""
    for each in submessages:
        joined += bytes(-len(joined) % ALIGNMENT) + each
    return joined


def header_bytes(session: int) -> int:
    """Length of the header of a session's messages."""
    return HEADER.size if session >= KEYLESS else HEADER.size + KEY_BYTES


# -- fields -----------------------------------------------------------------------------------------------------------


class BadField(Exception):
    """A field is not whole, or has an impossible value. Raised and caught within this package."""


class Fields:
    """Cursor over the fields of a payload. Integers are aligned to the beginning."""

    __slots__ = ("_at", "_data", "_order")

    def __init__(self, data: bytes, *, is_little: bool = True) -> None:
        self._data, self._at = data, 0
        self._order = "<" if is_little else ">"

    def take(self, count: int) -> bytes:
        """Return the next bytes."""
        end = self._at + count
        if count < 0 or end > len(self._data):
            raise BadField
        taken = self._data[self._at : end]
        self._at = end
        return taken

    def rest(self) -> bytes:
        """Return all bytes that are left."""
        return self.take(len(self._data) - self._at)

    def u8(self) -> int:
        return self.take(1)[0]

    def flag(self) -> bool:
        return self.take(1) != b"\0"

    def id(self) -> int:
        """Return a request id or object id."""
        return int.from_bytes(self.take(2), "big")

    def u16(self) -> int:
        return self._integer(2)

    def u32(self) -> int:
        return self._integer(4)

    def string(self) -> str:
        """Return a string, whose last byte is 0. Bytes that are not UTF-8 become replacement characters."""
        return self.octets(STRING_BYTES_MAX).partition(b"\0")[0].decode(errors="replace")

    def octets(self, most_bytes: int) -> bytes:
        """Return a sequence of bytes."""
        length = self.u32()
        if length > most_bytes:
            raise BadField
        return self.take(length)

    def _integer(self, size: int) -> int:
        self._at += -self._at % size
        return int.from_bytes(self.take(size), "little" if self._order == "<" else "big")


class Builder:
    """Payload under construction. Integers are aligned to the beginning and little endian."""

    __slots__ = ("data",)

    def __init__(self) -> None:
        self.data = b""

    def raw(self, data: bytes) -> "Builder":
        self.data += data
        return self

    def id(self, number: int) -> "Builder":
        return self.raw(number.to_bytes(2, "big"))

    def u8(self, number: int) -> "Builder":
        return self.raw(bytes((number,)))

    def u16(self, number: int) -> "Builder":
        return self._integer(number, 2)

    def u32(self, number: int) -> "Builder":
        return self._integer(number, 4)

    def octets(self, data: bytes) -> "Builder":
        return self.u32(len(data)).raw(data)

    def string(self, text: str) -> "Builder":
        return self.octets(text.encode() + b"\0")

    def _integer(self, number: int, size: int) -> "Builder":
        return self.raw(bytes(-len(self.data) % size) + number.to_bytes(size, "little"))


def fields_of(submessage: Submessage) -> Fields:
    """Return a cursor over the fields of a submessage, in its byte order."""
    return Fields(submessage.payload, is_little=bool(submessage.flags & LITTLE))


# -- payloads from a client -------------------------------------------------------------------------------------------


class ClientInfo(NamedTuple):
    """CREATE_CLIENT: a client, its session and the longest message that it can take."""

    version: bytes
    vendor: bytes
    key: bytes
    session: int
    properties: tuple[tuple[str, str], ...]
    mtu: int


class ReadRequest(NamedTuple):
    """READ_DATA: what a client wants from a reader, replier or requester."""

    request: int
    object_id: int
    stream: int
    data_format: int
    samples: int  # UNLIMITED, or 0: no more
    seconds: int  # 0: for ever
    bytes_s: int  # 0: unlimited
    pace_ms: int


class Range(NamedTuple):
    """ACKNACK and HEARTBEAT: first number, last number or bitmap of the missing ones, stream."""

    first: int
    second: int
    stream: int


def decode_client(submessage: Submessage) -> ClientInfo | None:
    """Decode a CREATE_CLIENT; None when it is damaged or not one."""
    fields = fields_of(submessage)
    try:
        if fields.take(4) != COOKIE:
            return None
        version, vendor, key, session = fields.take(2), fields.take(2), fields.take(KEY_BYTES), fields.u8()
        properties: list[tuple[str, str]] = []
        if fields.flag():
            count = fields.u32()
            if count > PROPERTIES_MAX:
                return None
            properties += [(fields.string(), fields.string()) for _ in range(count)]
        return ClientInfo(version, vendor, key, session, tuple(properties), fields.u16())
    except BadField:
        return None


def decode_request(submessage: Submessage) -> tuple[int, int] | None:
    """Decode the request id and the object id with which a payload begins; None when it is damaged."""
    payload = submessage.payload
    if len(payload) < REQUEST_BYTES:
        return None
    return int.from_bytes(payload[:2], "big"), int.from_bytes(payload[2:4], "big")


def decode_read(submessage: Submessage) -> ReadRequest | None:
    """Decode a READ_DATA; None when it is damaged. Without limits a client wants one sample."""
    fields = fields_of(submessage)
    try:
        request, object_id, stream, data_format = fields.id(), fields.id(), fields.u8(), fields.u8()
        if fields.flag():
            fields.string()  # a filter, which no known client has
        samples, seconds, bytes_s, pace_ms = 1, 0, 0, 0
        if fields.flag():
            samples, seconds, bytes_s, pace_ms = fields.u16(), fields.u16(), fields.u16(), fields.u16()
    except BadField:
        return None
    return ReadRequest(request, object_id, stream, data_format, samples, seconds, bytes_s, pace_ms)


def decode_acknack(submessage: Submessage) -> Range | None:
    """Decode an ACKNACK: the first number that is missing, and a bitmap of the missing ones from there on."""
    fields = fields_of(submessage)
    try:
        return Range(fields.u16(), fields.id(), fields.u8())
    except BadField:
        return None


def decode_heartbeat(submessage: Submessage) -> Range | None:
    """Decode a HEARTBEAT: the first and the last number that wait for an acknowledgement."""
    fields = fields_of(submessage)
    try:
        return Range(fields.u16(), fields.u16(), fields.u8())
    except BadField:
        return None


def decode_timestamp(submessage: Submessage) -> bytes | None:
    """Decode a TIMESTAMP: the client's time unchanged, little endian; None when it is damaged."""
    fields = fields_of(submessage)
    try:
        return Builder().u32(fields.u32()).u32(fields.u32()).data
    except BadField:
        return None


# -- payloads to a client ---------------------------------------------------------------------------------------------

_ACKNACK: Final = struct.Struct("<BBHHBBB")
_HEARTBEAT: Final = struct.Struct("<BBHHHB")
_REQUEST: Final = struct.Struct(">HH")
_NS_PER_S: Final = 1_000_000_000
_AVAILABLE: Final = bytes((0, 1, ObjectKind.AGENT, 0, 1, 0)) + bytes(6)  # no configuration; activity: 1, no addresses


def encode_client(info: ClientInfo) -> bytes:
    """Encode a CREATE_CLIENT without properties."""
    head = Builder().raw(COOKIE + info.version + info.vendor + info.key).u8(info.session).u8(0)
    return encode_submessage(Kind.CREATE_CLIENT, head.u16(info.mtu).data)


def encode_read(request: int, object_id: int, stream: int) -> bytes:
    """Encode a READ_DATA for every sample from now on."""
    wanted = Builder().id(request).id(object_id).u8(stream).u8(0).u8(0).u8(1).u16(UNLIMITED)
    return encode_submessage(Kind.READ_DATA, wanted.u16(0).u16(0).u16(0).data)


def encode_status_agent(status: int) -> bytes:
    """Encode the answer to CREATE_CLIENT."""
    return encode_submessage(Kind.STATUS_AGENT, bytes((status, 0)) + COOKIE + VERSION + VENDOR + b"\0")


def encode_status(request: int, object_id: int, status: int) -> bytes:
    """Encode the answer to a request about an object."""
    return encode_submessage(Kind.STATUS, Builder().id(request).id(object_id).u8(status).u8(0).data)


def encode_info(request: int, object_id: int, *, is_in_session: bool) -> bytes:
    """Encode the answer to a ping."""
    return encode_submessage(
        Kind.INFO, Builder().id(request).id(object_id).u8(0).u8(int(is_in_session)).raw(_AVAILABLE).data
    )


def encode_acknack(first: int, missing: int, stream: int) -> bytes:
    """Encode an ACKNACK."""
    return _ACKNACK.pack(Kind.ACKNACK, LITTLE, 5, first, missing >> 8, missing & 0xFF, stream)


def encode_heartbeat(first: int, last: int, stream: int) -> bytes:
    """Encode a HEARTBEAT."""
    return _HEARTBEAT.pack(Kind.HEARTBEAT, LITTLE, 5, first, last, stream)


def encode_data(request: int, object_id: int, payload: bytes) -> bytes:
    """Encode a message for a reader, replier or requester."""
    return encode_submessage(Kind.DATA, _REQUEST.pack(request, object_id) + payload)


def encode_time(wall_ns: int) -> bytes:
    """Encode a time: seconds, nanoseconds."""
    seconds, nanoseconds = divmod(wall_ns, _NS_PER_S)
    return Builder().u32(seconds & 0xFFFFFFFF).u32(nanoseconds).data


def encode_timestamp_reply(wall_ns: int, originated: bytes) -> bytes:
    """Encode the answer to a TIMESTAMP. `originated`: the client's time in it."""
    now = encode_time(wall_ns)
    return encode_submessage(Kind.TIMESTAMP_REPLY, now + now + originated)


# -- sequence numbers -------------------------------------------------------------------------------------------------


def number_after(number: int, count: int = 1) -> int:
    """Return the number that is `count` after another."""
    return (number + count) % NUMBERS


def distance(first: int, second: int) -> int:
    """Return how far the second number is after the first; negative if it is before."""
    apart = (second - first) % NUMBERS
    return apart if apart < NUMBERS // 2 else apart - NUMBERS


# -- without a session ------------------------------------------------------------------------------------------------


def is_create_client(data: bytes) -> bool:
    """Whether a message creates a client: the greeting of the protocol."""
    message = decode_message(data)
    if message is None or message.stream != NO_STREAM:
        return False
    return any(each.kind == Kind.CREATE_CLIENT and decode_client(each) is not None
               for each in decode_submessages(message.body)[0])  # fmt: skip


def is_in_session(data: bytes) -> bool:
    """Whether a message is one that only a client sends that was created: whole submessages, and no ping."""
    message = decode_message(data)
    if message is None:
        return False
    found, rest_bytes = decode_submessages(message.body)
    return bool(found) and not rest_bytes and all(each.kind in _OF_CLIENTS for each in found)


def answer_ping(data: bytes) -> bytes | None:
    """Return the answer to a ping without a session; None if the message has no ping."""
    message = decode_message(data)
    if message is None or message.stream != NO_STREAM:
        return None
    for each in decode_submessages(message.body)[0]:
        request = decode_request(each) if each.kind == Kind.GET_INFO else None
        if request is not None:
            info = encode_info(*request, is_in_session=False)
            return encode_message(message.session, message.key, NO_STREAM, 0, info)
    return None
