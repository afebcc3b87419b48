"""LinkEvidence: what a protocol judges of a link: its counts, and the bytes that are not of the protocol. Pure.

Codes and texts of the findings are in hostlink/core/diagnosis/findings.toml.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from hostlink.core.protocol.line_speed import LineSpeed

UNEXPLAINED_BYTES = 32  # fewer bytes are the end of a cut message
JUDGED_S = 3.0  # a boot message and a first negotiation are over by then
UNKNOWN_MESSAGES = 3  # one or two may be late ones of a session that has ended
UNKNOWN_S = 5.0  # a device that begins anew by itself has done so by then
EXCERPT_CHARS = 40
UNREADABLE_SHARE = 0.5  # a line that only loses bytes still has most of them in messages
WENT_SILENT_S = 6.0  # rosserial: two missing time requests (2.5 s), and a second for the radio
BAD_CHECKSUMS = 3  # in the last minute; an intact line has none
BURST_BYTES = 64  # before the first frame: the shortest boot message is longer, half a frame of a robot is shorter
TEXT_SHARE = 0.9  # 38 % of random bytes are printable, 88 % of a TopicInfo of rosserial, and all of a program's text
BOOT_WORDS = (b"ets Jan", b"ets Jun", b"rst cause", b"rst:0x", b"boot mode", b"boot:0x", b"Brownout")
_TEXT_BYTES = frozenset(b"\t\n\r\x1b") | frozenset(range(0x20, 0x7F))


class Tally(NamedTuple):
    """Counts over some time. Evidence has one since the link opened and one of the last 30 s."""

    bytes_from_device: int = 0
    frames: int = 0
    skipped_bytes: int = 0
    unknown_ids: int = 0  # since the last negotiation, which explained the earlier ones
    bad_checksums: int = 0
    wrong_sizes: int = 0


NO_COUNTS = Tally()


class LinkEvidence(NamedTuple):
    """Evidence of one link for the rules of its protocol.

    Times are in seconds before the moment of the evidence; None if something did not happen.
    """

    age_s: float
    silent_s: float = 0.0
    total: Tally = NO_COUNTS
    recent: Tally = NO_COUNTS
    own: tuple[int, ...] = ()  # the session's `own_counts` of the last 30 s
    baud: int | None = None  # at which a serial line is read
    requests: int = 0  # number of topic requests
    negotiated_s: float | None = None  # since the first announcement of the topics
    time_requested_s: float | None = None  # since the last time request that the host did not provoke
    never_requests_time: bool = False  # not even with its topics
    time_intervals_s: tuple[float, ...] = ()  # between unprovoked time requests
    sample: bytes = b""  # the last of the skipped bytes
    early: bytes = b""  # the last bytes that were skipped before the first announcement
    is_outdated: bool = False  # the device speaks an older version of the protocol
    is_shared: bool = False  # another program is at the serial port, and damages what is left
    refused: tuple[str, ...] = ()  # reasons of refused topics, one text each
    too_small: tuple[str, ...] = ()  # messages that exceed a buffer, one text each

    @property
    def is_unreadable(self) -> bool:
        """Whether hardly anything is of the protocol."""
        skipped_bytes = self.recent.skipped_bytes
        return (
            skipped_bytes >= UNEXPLAINED_BYTES
            and skipped_bytes >= UNREADABLE_SHARE * self.recent.bytes_from_device
            and self.age_s >= JUDGED_S
        )

    @property
    def share(self) -> str:
        """Say how much was skipped."""
        return f"{self.recent.skipped_bytes} of {self.recent.bytes_from_device} bytes in no frame"


Explain = Callable[[LinkEvidence], Mapping[str, str]]  # the details of what is wrong, by the code of their finding
GuessSpeed = Callable[[bytes, int | None], LineSpeed | None]  # from skipped bytes and the reader's baud rate


def explain_unreadable(evidence: LinkEvidence) -> Mapping[str, str]:
    """Say whether most bytes were skipped. For any protocol."""
    return {"no_sync": evidence.share} if evidence.is_unreadable and not evidence.is_shared else {}


def explain_skipped(evidence: LinkEvidence, guess_speed: GuessSpeed) -> Mapping[str, str]:
    """Say what recently skipped bytes are: text, a boot message, another baud rate, damage. For any serial protocol."""
    if evidence.negotiated_s is None and evidence.age_s < JUDGED_S:
        return {}  # the first bytes of a running device are the middle of a frame
    recent = evidence.recent
    if recent.skipped_bytes >= UNEXPLAINED_BYTES:
        if is_text(evidence.sample):
            is_boot = any(word in evidence.sample for word in BOOT_WORDS)
            return {"boot_noise" if is_boot else "text_on_line": f'"{excerpt(evidence.sample)}"'}
        if recent.skipped_bytes >= UNREADABLE_SHARE * recent.bytes_from_device:
            if not evidence.is_unreadable:
                return {}
            speed = guess_speed(evidence.sample, evidence.baud)
            return {"no_sync": evidence.share} if speed is None else {"wrong_baud": f"{speed}; {evidence.share}"}
    if recent.bad_checksums >= BAD_CHECKSUMS:
        return {"damaged": f"{recent.bad_checksums} bad checksums and {recent.frames} good frames"}
    return _explain_burst(evidence, guess_speed)


def _explain_burst(evidence: LinkEvidence, guess_speed: GuessSpeed) -> Mapping[str, str]:
    """Detect bytes before the first topics, and none since."""
    early = evidence.early
    is_new = evidence.recent.skipped_bytes >= len(early) >= BURST_BYTES
    if not is_new or evidence.total.skipped_bytes - len(early) >= UNEXPLAINED_BYTES:
        return {}
    speed = guess_speed(early, evidence.baud)
    is_boot = speed is not None and speed.is_of_boot
    return {"boot_noise": f"{len(early)} bytes{f', {speed}' if is_boot else ''}"}


def explain_unknown(messages: int, seconds: float) -> str:
    """Return the detail about a device in a session that was not begun here; empty if it may be about to begin one."""
    return f"{messages} messages" if messages >= UNKNOWN_MESSAGES and seconds >= UNKNOWN_S else ""


def is_text(sample: bytes) -> bool:
    """Whether the bytes are text printed by a program."""
    return bool(sample) and sum(byte in _TEXT_BYTES for byte in sample) >= TEXT_SHARE * len(sample)


def excerpt(sample: bytes) -> str:
    """Return the longest of the last lines, in printable characters."""
    lines = [line for line in sample.decode("ascii", "replace").splitlines() if line.strip()]
    longest = max(lines[-4:], key=len, default="")  # the first and the last line may be cut
    return "".join(char if char.isprintable() else "?" for char in longest)[:EXCERPT_CHARS]
