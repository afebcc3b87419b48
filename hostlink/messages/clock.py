"""Messages of /clock: the time of a simulation or of a recording that is played. Pure."""

import struct
from typing import Final

CLOCK: Final = "/clock"
CLOCK_TYPE: Final = "rosgraph_msgs/Clock"
_TIME = struct.Struct("<II")
_NS_PER_S = 1_000_000_000


def decode_clock(payload: bytes) -> int | None:
    """The time in ns; None: the payload is not a message of CLOCK_TYPE."""
    if len(payload) != _TIME.size:
        return None
    secs, nsecs = _TIME.unpack(payload)
    return int(secs * _NS_PER_S + nsecs)
