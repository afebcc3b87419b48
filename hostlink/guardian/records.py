"""What the daemon says to its guardian, and what it answers: packets on a pair of sockets. Pure; imports little."""

import struct

WATCH = b"W"  # with the connection's descriptor: this device is a robot, here is how to stop it
RELEASE = b"R"  # its connection has ended, or it is no robot any more
PING = b"P"  # is answered with the number of connections that are held
GOODBYE = b"G"  # the daemon ends as it should: nothing is to be sent

_RECORD = struct.Struct("<cQHI")
_ANSWER = struct.Struct("<I")
RECORD_BYTES = _RECORD.size
ANSWER_BYTES = _ANSWER.size
DESCRIPTOR_BYTES = 4  # of an int in SCM_RIGHTS


def encode_watch(number: int, topic_id: int, claim_bytes: int) -> bytes:
    """Link number, id of the velocity topic, the longest frame that the device may have been sent."""
    return _RECORD.pack(WATCH, number, topic_id, claim_bytes)


def encode_release(number: int) -> bytes:
    """Link number."""
    return _RECORD.pack(RELEASE, number, 0, 0)


def encode_ping() -> bytes:
    """A question that any living guardian answers."""
    return _RECORD.pack(PING, 0, 0, 0)


def encode_goodbye() -> bytes:
    """The last record."""
    return _RECORD.pack(GOODBYE, 0, 0, 0)


def decode(record: bytes) -> tuple[bytes, int, int, int]:
    """(kind, link number, topic id, claim); struct.error for what is no record."""
    kind, number, topic_id, claim_bytes = _RECORD.unpack(record)
    return kind, number, topic_id, claim_bytes


def encode_answer(held: int) -> bytes:
    """To a ping: how many connections are held."""
    return _ANSWER.pack(held)


def decode_answer(answer: bytes) -> int:
    """How many connections are held."""
    return int(_ANSWER.unpack(answer)[0])
