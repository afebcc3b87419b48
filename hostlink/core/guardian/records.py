"""Records between daemon and guardian: packets on a socket pair. Pure, with few imports."""

import struct

WATCH = b"W"  # guard this robot's connection; its descriptor is attached
RELEASE = b"R"  # the connection has ended, or is no longer a robot's
BEAT = b"B"  # the daemon runs; names the links whose robots may move
PING = b"P"  # answered with the number of guarded connections
GOODBYE = b"G"  # the daemon ends normally; nothing is to be sent

MAX_FRAMES_BYTES = 4096  # of a WATCH; sixteen stops of 100 bytes take half of it
MAX_DRIVEN = 1024  # link numbers in a beat; a beat with more means all links
_HEAD = struct.Struct("<cQIH")  # kind, link number, claim, number of frames; then their lengths, then the frames
_LENGTH = struct.Struct("<H")
_ANSWER = struct.Struct("<II")
_NUMBER_BYTES = 8
MAX_RECORD_BYTES = 1 + _NUMBER_BYTES * (MAX_DRIVEN + 1)
ANSWER_BYTES = _ANSWER.size
DESCRIPTOR_BYTES = 4  # size of the int in SCM_RIGHTS


def fitting(zeros: tuple[bytes, ...], end: bytes) -> tuple[tuple[bytes, ...], bytes]:
    """Return the frames of a WATCH for which there is room: zeros in their order without those too long, then the end.

    An end without room is empty.
    """
    fitted: list[bytes] = []
    room_bytes = MAX_FRAMES_BYTES
    for frame in (*zeros, end):
        is_fitting = len(frame) + _LENGTH.size <= room_bytes
        room_bytes -= (len(frame) + _LENGTH.size) * is_fitting
        fitted.append(frame if is_fitting else b"")
    *kept, kept_end = fitted
    return tuple(filter(None, kept)), kept_end


def encode(
    kind: bytes, number: int = 0, zeros: tuple[bytes, ...] = (), end: bytes = b"", claim_bytes: int = 0
) -> bytes:
    """Encode any record but a beat.

    `number`: of the link of WATCH and RELEASE. WATCH has the frames that `fitting` returned too, and the longest frame
    that may have been sent to the device.
    """
    frames = (end, *zeros)
    lengths = b"".join([_LENGTH.pack(len(frame)) for frame in frames])
    return _HEAD.pack(kind, number, claim_bytes, len(frames)) + lengths + b"".join(frames)


def encode_beat(driven: set[int]) -> bytes:
    """Encode the numbers of the links that may move. An empty set: the guardian expects no further beat."""
    numbers = sorted(driven)[: MAX_DRIVEN + 1]
    return BEAT + struct.pack(f"<{len(numbers)}Q", *numbers)


def decode_beat(record: bytes) -> tuple[int, ...] | None:
    """Decode the link numbers of a beat; None means all links."""
    count = (len(record) - 1) // _NUMBER_BYTES
    return None if count > MAX_DRIVEN else struct.unpack(f"<{count}Q", record[1:])


def decode(record: bytes) -> tuple[bytes, int, tuple[bytes, ...], bytes, int]:
    """Decode any record but a beat: kind, link number, zeros, end, claim.

    Raises:
        struct.error: the bytes are not a record.
    """
    kind, number, claim_bytes, count = _HEAD.unpack_from(record)
    lengths = struct.unpack_from(f"<{count}H", record, _HEAD.size)
    frames = struct.unpack("".join([f"{length}s" for length in lengths]), record[_HEAD.size + _LENGTH.size * count :])
    return kind, number, frames[1:], frames[0], claim_bytes


def encode_answer(connections: int, stopped: int) -> bytes:
    """Encode the answer to a ping: guarded connections, and robots stopped so far because of missing beats."""
    return _ANSWER.pack(connections, stopped & 0xFFFFFFFF)


def decode_answer(answer: bytes) -> tuple[int, int]:
    """Decode an answer: guarded connections, and robots stopped so far because of missing beats."""
    connections, stopped = _ANSWER.unpack(answer)
    return connections, stopped
