"""Allowance: how much may be sent to an address that somebody else may have written into a datagram. Pure."""

from collections.abc import Sequence

HEADER_BYTES = 28  # of IPv4 and UDP, for each datagram


class Allowance:
    """Never more than came from there, with headers and without: nobody can have a flood sent to somebody else."""

    def __init__(self, *, is_limited: bool) -> None:
        self.is_limited = is_limited
        self._payload_bytes = self._wire_bytes = 0

    def earn(self, size_bytes: int) -> None:
        """A datagram came."""
        self._payload_bytes += size_bytes
        self._wire_bytes += size_bytes + HEADER_BYTES

    def allows(self, datagrams: Sequence[bytes]) -> bool:
        """Whether all of these may be sent."""
        if not self.is_limited:
            return True
        payload_bytes = sum(map(len, datagrams))
        wire_bytes = payload_bytes + HEADER_BYTES * len(datagrams)
        return payload_bytes <= self._payload_bytes and wire_bytes <= self._wire_bytes

    def spend(self, size_bytes: int) -> None:
        """A datagram was sent."""
        self._payload_bytes -= size_bytes
        self._wire_bytes -= size_bytes + HEADER_BYTES
