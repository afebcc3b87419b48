"""Attachment: what stands beside every message, request and answer of rmw_zenoh. Pure."""

import struct
from typing import Final, NamedTuple

GID_BYTES: Final = 16
_LAYOUT: Final = struct.Struct("<qqB16s")


class Attachment(NamedTuple):
    """`gid` names the endpoint that sent it; an answer repeats number and gid of its request."""

    sequence_number: int
    source_ns: int  # wall time of the sender
    gid: bytes

    def encode(self) -> bytes:
        """33 bytes."""
        return _LAYOUT.pack(self.sequence_number, self.source_ns, GID_BYTES, self.gid)

    @classmethod
    def decode(cls, data: bytes) -> "Attachment | None":
        """None: it is none, as that of a release of rmw_zenoh before April 2025."""
        if len(data) != _LAYOUT.size:
            return None
        sequence_number, source_ns, gid_bytes, gid = _LAYOUT.unpack(data)
        return cls(sequence_number, source_ns, gid) if gid_bytes == GID_BYTES else None
