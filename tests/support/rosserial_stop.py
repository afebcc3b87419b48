"""StopFrames of a session of rosserial, from plain frames."""

from collections.abc import Iterable

from hostlink.core.protocol.rosserial.frame import LEAD, SEPARATOR, STOP_REQUEST
from hostlink.core.runtime.stop_frames import StopFrames


def rosserial_stop(zeros: Iterable[bytes], claim_bytes: int = 0, end: bytes = STOP_REQUEST) -> StopFrames:
    """Return these zeros as tests/unit/core/protocol/rosserial/test_session.py finds them."""
    return StopFrames(tuple(zeros), end, claim_bytes=claim_bytes, lead=LEAD, separator=SEPARATOR)
