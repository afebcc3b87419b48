"""What a UART reads that listens at another speed than the other end sends. Pure arithmetic on one line's bits.

Both ends use 8N1. The reader waits for a falling edge, takes the middle of each of its own bits that follow, and
waits for the next edge; as PC drivers do, it passes bytes on whose stop bit was wrong.
"""

from collections.abc import Iterator

STANDARD_BAUDS = (9600, 19200, 38400, 57600, 74880, 115200, 230400, 250000, 460800, 500000, 921600, 1000000)
_DATA_BITS = 8
_FRAME_BITS = 10  # start, eight of data, stop


def resample(data: bytes, *, ratio: float, gap_bits: float = 0.0) -> bytes:
    """What comes out where the reader's speed is `ratio` times the sender's; `gap_bits` of idle line between bytes."""
    return bytes(_read(_levels(data, ratio, gap_bits)))


def _levels(data: bytes, ratio: float, gap_bits: float) -> list[tuple[float, int]]:
    """The line as (time at which a level ends, level); the unit is one bit of the reader's."""
    levels: list[tuple[float, int]] = [(_FRAME_BITS * 1.0, 1)]
    at = levels[0][0]
    for byte in data:
        bits = (byte << 1) | 1 << (_FRAME_BITS - 1)  # the start bit is 0, the stop bit 1, the lowest bit first
        for number in range(_FRAME_BITS):
            at += ratio
            levels.append((at, bits >> number & 1))
        at += gap_bits * ratio
        levels[-1] = (at, 1)
    levels.append((at + 2 * _FRAME_BITS, 1))
    return levels


def _read(levels: list[tuple[float, int]]) -> Iterator[int]:
    index, at = 0, 0.0
    while True:
        while index < len(levels) and (levels[index][1] or levels[index][0] <= at):
            index += 1
        if index == len(levels):
            return
        start = max(at, levels[index - 1][0])
        byte = 0
        for bit in range(_DATA_BITS):
            middle = start + 1.5 + bit
            while index < len(levels) - 1 and levels[index][0] <= middle:
                index += 1
            byte |= levels[index][1] << bit
        at = start + 1.5 + _DATA_BITS
        yield byte
