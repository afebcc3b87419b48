"""The device's side of rosserial's control payloads: what a device encodes, and the time answer that it decodes."""

import struct

from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.runtime.units import NS_PER_S


def encode_parameter_request(name: str) -> bytes:
    """Encode the payload of a parameter request."""
    return _encode_string(name)


def encode_log(log: Log) -> bytes:
    """Encode the payload of a log line."""
    return bytes([log.level]) + _encode_string(log.text)


def decode_time(payload: bytes) -> int:
    """Decode a time answer to nanoseconds since 1970."""
    seconds, nanoseconds = struct.unpack("<II", payload)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def _encode_string(text: str) -> bytes:
    data = text.encode()
    return struct.pack("<I", len(data)) + data
