"""Stall: whether what was sent is still on its way because the network stands still. Pure.

What the kernel has cannot be replaced: commands that pile up there reach the device when the network moves
again, after the stop that came later. So nothing more is sent on a connection that makes no progress.
"""

STALL_S = 0.4  # longer than a peer may hold an acknowledgement back (lwIP, so an ESP8266: 0.25 s)


class Stall:
    """Compares how much was sent in all with how much of that the peer has not acknowledged."""

    def __init__(self) -> None:
        self._is_waiting = False
        self._acknowledged_bytes = 0
        self._since_s = 0.0  # of the last progress, or of the first byte that waits

    def is_stalled(self, *, sent_bytes: int, unacknowledged_bytes: int, now_s: float) -> bool:
        """Whether something waits, and nothing was acknowledged for STALL_S."""
        acknowledged_bytes = sent_bytes - unacknowledged_bytes
        if not self._is_waiting or acknowledged_bytes > self._acknowledged_bytes:
            self._acknowledged_bytes, self._since_s = acknowledged_bytes, now_s
        self._is_waiting = unacknowledged_bytes > 0
        return self._is_waiting and now_s >= self._since_s + STALL_S
