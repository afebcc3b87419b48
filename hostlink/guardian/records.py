"""What the daemon sends to its guardian, and what it answers: packets on a pair of sockets. Pure; imports little."""

import struct

WATCH = b"W"  # with the connection's descriptor: this device is a robot, here is how to stop it
RELEASE = b"R"  # its connection has ended, or it is no robot any more
BEAT = b"B"  # the daemon runs; the numbers of the links whose robots may move now
PING = b"P"  # is answered with the number of connections that are guarded
GOODBYE = b"G"  # the daemon ends as it should: nothing is to be sent

MAX_TOPICS = 16  # of one device
MAX_DRIVEN = 1024  # links that a beat names; a beat with more means all of them
_RECORD = struct.Struct(f"<cQI{MAX_TOPICS}H")  # an id of 0 is none
_NONE = (0,) * MAX_TOPICS
_ANSWER = struct.Struct("<II")
_NUMBER_BYTES = 8
MAX_RECORD_BYTES = 1 + _NUMBER_BYTES * (MAX_DRIVEN + 1)
ANSWER_BYTES = _ANSWER.size
DESCRIPTOR_BYTES = 4  # of an int in SCM_RIGHTS


def encode_watch(number: int, topic_ids: tuple[int, ...], claim_bytes: int) -> bytes:
    """Link number, ids of the velocity topics, the longest frame that the device may have been sent."""
    return _RECORD.pack(WATCH, number, claim_bytes, *(topic_ids + _NONE)[:MAX_TOPICS])


def encode_release(number: int) -> bytes:
    """Link number."""
    return _RECORD.pack(RELEASE, number, 0, *_NONE)


def encode_beat(driven: set[int]) -> bytes:
    """Link numbers of what may move; none: the guardian expects no further beat."""
    numbers = sorted(driven)[: MAX_DRIVEN + 1]
    return BEAT + struct.pack(f"<{len(numbers)}Q", *numbers)


def decode_beat(record: bytes) -> tuple[int, ...] | None:
    """The link numbers; None: all links."""
    count = (len(record) - 1) // _NUMBER_BYTES
    return None if count > MAX_DRIVEN else struct.unpack(f"<{count}Q", record[1:])


def encode_ping() -> bytes:
    """A question that any living guardian answers."""
    return _RECORD.pack(PING, 0, 0, *_NONE)


def encode_goodbye() -> bytes:
    """The last record."""
    return _RECORD.pack(GOODBYE, 0, 0, *_NONE)


def decode(record: bytes) -> tuple[bytes, int, tuple[int, ...], int]:
    """(kind, link number, topic ids, claim) of everything but a beat; struct.error for what is no record."""
    kind, number, claim_bytes, *topic_ids = _RECORD.unpack(record)
    return kind, number, tuple(filter(None, topic_ids)), claim_bytes


def encode_answer(connections: int, stopped: int) -> bytes:
    """To a ping: how many connections are guarded; how many robots were stopped so far because no beat came."""
    return _ANSWER.pack(connections, stopped & 0xFFFFFFFF)


def decode_answer(answer: bytes) -> tuple[int, int]:
    """(guarded connections, robots that were stopped so far because no beat came)."""
    connections, stopped = _ANSWER.unpack(answer)
    return connections, stopped
