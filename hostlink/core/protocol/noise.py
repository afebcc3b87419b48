"""Noise: bytes of a link that are not of its protocol, as evidence for a diagnosis. Pure."""

from typing import NamedTuple

UNEXPLAINED_BYTES = 32  # fewer bytes are the end of a cut message
JUDGED_S = 3.0  # a boot message and a first negotiation are over by then
EXCERPT_CHARS = 40
UNREADABLE_SHARE = 0.5  # a line that only loses bytes still has most of them in messages


class Noise(NamedTuple):
    """Counts of the last seconds of a link, and the bytes that were skipped."""

    age_s: float  # of the link
    is_negotiated: bool  # the device has announced its topics
    received_bytes: int
    skipped_bytes: int
    frames: int
    bad_checksums: int
    all_skipped_bytes: int  # since the link opened
    sample: bytes  # the last of the skipped bytes
    early: bytes  # the last bytes that were skipped before the first announcement
    baud: int | None  # at which a serial line is read
    is_outdated: bool  # the device speaks an older version of the protocol

    @property
    def is_unreadable(self) -> bool:
        """Whether hardly anything is of the protocol."""
        return (
            self.skipped_bytes >= UNEXPLAINED_BYTES
            and self.skipped_bytes >= UNREADABLE_SHARE * self.received_bytes
            and self.age_s >= JUDGED_S
        )

    @property
    def share(self) -> str:
        """Say how much was skipped."""
        return f"{self.skipped_bytes} of {self.received_bytes} bytes in no frame"


def explain_unreadable(noise: Noise) -> tuple[str, str] | None:
    """Return the code and the detail of the finding about skipped bytes; None if they need none. For any protocol."""
    return ("no_sync", noise.share) if noise.is_unreadable else None


def excerpt(sample: bytes) -> str:
    """Return the longest of the last lines, in printable characters."""
    lines = [line for line in sample.decode("ascii", "replace").splitlines() if line.strip()]
    longest = max(lines[-4:], key=len, default="")  # the first and the last line may be cut
    return "".join(char if char.isprintable() else "?" for char in longest)[:EXCERPT_CHARS]
