"""Findings by the bytes that a rosserial device sent outside frames: a wrong baud rate, a boot message, text. Pure.

Each threshold names its source. Codes and texts are in hostlink/core/diagnosis/findings.toml.
"""

from hostlink.core.protocol.noise import JUDGED_S, UNEXPLAINED_BYTES, UNREADABLE_SHARE, Noise, excerpt
from hostlink.core.protocol.rosserial.speed import guess_speed

BURST_BYTES = 64  # before the first frame: the shortest boot message is longer, half a frame of a robot is shorter
TEXT_SHARE = 0.9  # 38 % of random bytes are printable, 88 % of a TopicInfo, and all of a program's text
BAD_CHECKSUMS = 3  # in the last minute; an intact line has none
BOOT_WORDS = (b"ets Jan", b"ets Jun", b"rst cause", b"rst:0x", b"boot mode", b"boot:0x", b"Brownout")
_TEXT_BYTES = frozenset(b"\t\n\r\x1b") | frozenset(range(0x20, 0x7F))


def explain(noise: Noise) -> tuple[str, str] | None:
    """Return the one code for the recently skipped bytes, and its detail; None if they need no finding."""
    if noise.is_outdated:
        return "protocol_1", ""
    if not noise.is_negotiated and noise.age_s < JUDGED_S:
        return None  # the first bytes of a running device are the middle of a frame
    if noise.skipped_bytes >= UNEXPLAINED_BYTES:
        if is_text(noise.sample):
            is_boot = any(word in noise.sample for word in BOOT_WORDS)
            return "boot_noise" if is_boot else "text_on_line", f'"{excerpt(noise.sample)}"'
        if noise.skipped_bytes >= UNREADABLE_SHARE * noise.received_bytes:
            return _unreadable(noise) if noise.is_unreadable else None
    if noise.bad_checksums >= BAD_CHECKSUMS:
        return "damaged", f"{noise.bad_checksums} bad checksums and {noise.frames} good frames"
    return _burst(noise)


def _unreadable(noise: Noise) -> tuple[str, str]:
    speed = guess_speed(noise.sample, noise.baud)
    return ("no_sync", noise.share) if speed is None else ("wrong_baud", f"{speed}; {noise.share}")


def _burst(noise: Noise) -> tuple[str, str] | None:
    """Detect bytes before the first topics, and none since."""
    early = noise.early
    is_new = noise.skipped_bytes >= len(early) >= BURST_BYTES
    if not is_new or noise.all_skipped_bytes - len(early) >= UNEXPLAINED_BYTES:
        return None
    speed = guess_speed(early, noise.baud)
    is_boot = speed is not None and speed.is_of_boot
    return "boot_noise", f"{len(early)} bytes{f', {speed}' if is_boot else ''}"


def is_text(sample: bytes) -> bool:
    """Whether the bytes are text printed by a program."""
    return bool(sample) and sum(byte in _TEXT_BYTES for byte in sample) >= TEXT_SHARE * len(sample)
