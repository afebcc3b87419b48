"""Records between daemon and guardian: packets on a socket pair. Pure, with few imports."""

import struct

from hostlink.core.runtime.stop_frames import StopFrames

WATCH = b"W"  # guard this robot's connection; its descriptor is attached
RELEASE = b"R"  # the connection has ended, or is no longer a robot's
BEAT = b"B"  # the daemon runs; names the links whose robots may move
PING = b"P"  # answered with the number of guarded connections
GOODBYE = b"G"  # the daemon ends normally; nothing is to be sent

MAX_FRAMES_BYTES = 4096  # of the zeros and the end of a WATCH; sixteen stops of 100 bytes take half of it
MAX_DRIVEN = 1024  # link numbers in a beat; a beat with more means all links
_HEAD = struct.Struct("<cQIdH")  # kind, link number, claim, interval, number of parts; then their lengths, then these
_LENGTH = struct.Struct("<H")
_ANSWER = struct.Struct("<II")
_NUMBER_BYTES = 8
MAX_RECORD_BYTES = 1 + _NUMBER_BYTES * (MAX_DRIVEN + 1)
ANSWER_BYTES = _ANSWER.size
DESCRIPTOR_BYTES = 4  # size of the int in SCM_RIGHTS
_NOTHING = StopFrames()


def fitting(stop: StopFrames) -> StopFrames:
    """Return these frames without those for which a WATCH has no room: zeros in their order, then the end."""
    fitted: list[bytes] = []
    room_bytes = MAX_FRAMES_BYTES
    for frame in (*stop.zeros, stop.end):
        is_fitting = len(frame) + _LENGTH.size <= room_bytes
        room_bytes -= (len(frame) + _LENGTH.size) * is_fitting
        fitted.append(frame if is_fitting else b"")
    *kept, kept_end = fitted
    return stop.replace(tuple(filter(None, kept)), kept_end)


def encode(kind: bytes, number: int = 0, stop: StopFrames = _NOTHING) -> bytes:
    """Encode any record but a beat. `number`: of the link of WATCH and RELEASE. WATCH has what `fitting` returned."""
    parts = (stop.end, stop.lead, stop.separator, stop.acknowledger.encode(), *stop.zeros)
    lengths = b"".join([_LENGTH.pack(len(part)) for part in parts])
    return _HEAD.pack(kind, number, stop.claim_bytes, stop.interval_s, len(parts)) + lengths + b"".join(parts)


def encode_beat(driven: set[int]) -> bytes:
    """Encode the numbers of the links that may move. An empty set: the guardian expects no further beat."""
    numbers = sorted(driven)[: MAX_DRIVEN + 1]
    return BEAT + struct.pack(f"<{len(numbers)}Q", *numbers)


def decode_beat(record: bytes) -> tuple[int, ...] | None:
    """Decode the link numbers of a beat; None means all links."""
    count = (len(record) - 1) // _NUMBER_BYTES
    return None if count > MAX_DRIVEN else struct.unpack(f"<{count}Q", record[1:])


def decode(record: bytes) -> tuple[bytes, int, StopFrames]:
    """Decode any record but a beat: kind, link number, what stops the device.

    Raises:
        struct.error: the bytes are not a record.
    """
    kind, number, claim_bytes, interval_s, count = _HEAD.unpack_from(record)
    lengths = struct.unpack_from(f"<{count}H", record, _HEAD.size)
    parts = struct.unpack("".join([f"{length}s" for length in lengths]), record[_HEAD.size + _LENGTH.size * count :])
    end, lead, separator, acknowledger, *zeros = parts
    stop = StopFrames(
        tuple(zeros),
        end,
        claim_bytes=claim_bytes,
        lead=lead,
        separator=separator,
        interval_s=interval_s,
        acknowledger=acknowledger.decode(),
    )
    return kind, number, stop


def encode_answer(connections: int, stopped: int) -> bytes:
    """Encode the answer to a ping: guarded connections, and robots stopped so far because of missing beats."""
    return _ANSWER.pack(connections, stopped & 0xFFFFFFFF)


def decode_answer(answer: bytes) -> tuple[int, int]:
    """Decode an answer: guarded connections, and robots stopped so far because of missing beats."""
    connections, stopped = _ANSWER.unpack(answer)
    return connections, stopped
