"""Records between daemon and guardian: packets on a socket pair. Pure, with few imports."""

import struct

WATCH = b"W"  # guard this robot's connection; its descriptor is attached
RELEASE = b"R"  # the connection has ended, or is no longer a robot's
BEAT = b"B"  # the daemon runs; names the links whose robots may move
PING = b"P"  # answered with the number of guarded connections
GOODBYE = b"G"  # the daemon ends normally; nothing is to be sent

MAX_TOPICS = 16  # of one device
MAX_DRIVEN = 1024  # link numbers in a beat; a beat with more means all links
_RECORD = struct.Struct(f"<cQI{MAX_TOPICS}H")  # a topic id of 0 is unused
_NONE = (0,) * MAX_TOPICS
_ANSWER = struct.Struct("<II")
_NUMBER_BYTES = 8
MAX_RECORD_BYTES = 1 + _NUMBER_BYTES * (MAX_DRIVEN + 1)
ANSWER_BYTES = _ANSWER.size
DESCRIPTOR_BYTES = 4  # size of the int in SCM_RIGHTS


def encode(kind: bytes, number: int = 0, topic_ids: tuple[int, ...] = (), claim_bytes: int = 0) -> bytes:
    """Encode any record but a beat.

    `number`: of the link of WATCH and RELEASE. WATCH has the ids of the velocity topics too, and the longest frame that
    may have been sent to the device.
    """
    return _RECORD.pack(kind, number, claim_bytes, *(topic_ids + _NONE)[:MAX_TOPICS])


def encode_beat(driven: set[int]) -> bytes:
    """Encode the numbers of the links that may move. An empty set: the guardian expects no further beat."""
    numbers = sorted(driven)[: MAX_DRIVEN + 1]
    return BEAT + struct.pack(f"<{len(numbers)}Q", *numbers)


def decode_beat(record: bytes) -> tuple[int, ...] | None:
    """Decode the link numbers of a beat; None means all links."""
    count = (len(record) - 1) // _NUMBER_BYTES
    return None if count > MAX_DRIVEN else struct.unpack(f"<{count}Q", record[1:])


def decode(record: bytes) -> tuple[bytes, int, tuple[int, ...], int]:
    """Decode any record but a beat: kind, link number, topic ids, claim.

    Raises:
        struct.error: the bytes are not a record.
    """
    kind, number, claim_bytes, *topic_ids = _RECORD.unpack(record)
    return kind, number, tuple(filter(None, topic_ids)), claim_bytes


def encode_answer(connections: int, stopped: int) -> bytes:
    """Encode the answer to a ping: guarded connections, and robots stopped so far because of missing beats."""
    return _ANSWER.pack(connections, stopped & 0xFFFFFFFF)


def decode_answer(answer: bytes) -> tuple[int, int]:
    """Decode an answer: guarded connections, and robots stopped so far because of missing beats."""
    connections, stopped = _ANSWER.unpack(answer)
    return connections, stopped
