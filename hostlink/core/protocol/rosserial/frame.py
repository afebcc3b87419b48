"""Frame of rosserial protocol version 2: encoding, both checksums and the special ids.

The numbers are from the rosserial protocol (docs/protocol.md#frame, docs/protocol.md#special-ids).
"""

import re
import zlib
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

SYNC = b"\xff\xfe"
SYNC_WORD = 0xFEFF  # SYNC as a little-endian integer
HEADER = Struct("<HHBH")  # sync, payload length, its checksum, topic id
OVERHEAD_BYTES = 8  # seven bytes of header, one of checksum
MAX_PAYLOAD_BYTES = 0xFFFF
FIRST_TOPIC_ID = 100  # the first topic id of a device
ADLER_MAX_BYTES = 256  # this many bytes of 255 sum to less than Adler's modulus of 65521
SEPARATOR = b"\0"  # ignored between frames; without it, a frame that ends with FF would hide the next sync
LEAD = bytes(3)  # length and checksum of a header after the sync. A sync there could give it a length of 65 kB
_PROTOCOL_1_HEAD = re.compile(rb"(?=\xff\xff..(.)\x00)", re.DOTALL)  # a payload length below 256
PROTOCOL_1_MAX_BYTES = 262  # 255 of payload, two syncs, id, length and checksum


class Id(IntEnum):
    """Topic ids below FIRST_TOPIC_ID. Ids 0 to 5 are also the kinds of endpoint, named from the device's side."""

    PUBLISHER = 0
    SUBSCRIBER = 1
    SERVICE_SERVER_PUBLISHER = 2
    SERVICE_SERVER_SUBSCRIBER = 3
    SERVICE_CLIENT_PUBLISHER = 4
    SERVICE_CLIENT_SUBSCRIBER = 5
    PARAMETER = 6
    LOG = 7
    TIME = 10
    STOP = 11


class Frame(NamedTuple):
    """Frame with two correct checksums."""

    topic_id: int
    payload: bytes


def byte_sum(data: bytes | bytearray | memoryview) -> int:
    """Sum the bytes; only the lowest 8 bits are valid. Adler-32's lower half computes the sum in C."""
    if len(data) <= ADLER_MAX_BYTES:
        return zlib.adler32(data, 0)
    view = memoryview(data)
    total = 0
    for at in range(0, len(data), ADLER_MAX_BYTES):
        total += zlib.adler32(view[at : at + ADLER_MAX_BYTES], 0)
    return total


def encode(topic_id: int, payload: bytes) -> bytes:
    """Encode one frame.

    Raises:
        ValueError: the payload is longer than MAX_PAYLOAD_BYTES.
    """
    size = len(payload)
    if size > MAX_PAYLOAD_BYTES:
        raise ValueError(f"payload of {size} bytes, a frame holds at most {MAX_PAYLOAD_BYTES}")
    length_check = ~(size + (size >> 8)) & 0xFF
    body_check = ~(topic_id + (topic_id >> 8) + byte_sum(payload)) & 0xFF
    return b"%b%b%c" % (HEADER.pack(SYNC_WORD, size, length_check, topic_id), payload, body_check)


TOPICS_REQUEST = encode(Id.PUBLISHER, b"")
STOP_REQUEST = encode(Id.STOP, b"")


def contains_protocol_1(data: bytes) -> bool:
    """Whether the data contains a whole frame of protocol version 1 (before 2013).

    Layout: FF FF, id (2), length (2), payload, checksum = 255 - sum of all bytes after the FFs.
    """
    for head in _PROTOCOL_1_HEAD.finditer(data):
        size = head[1][0] + 5
        body = data[head.start() + 2 : head.start() + 2 + size]
        if len(body) == size and byte_sum(body) & 0xFF == 0xFF:  # noqa: PLR2004 - sum and checksum give 255
            return True
    return False
