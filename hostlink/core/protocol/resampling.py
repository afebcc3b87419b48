"""Simulation of a UART that reads at another baud rate than the sender's. Pure arithmetic on the bits of one line.

Both ends use 8N1. The reader waits for a falling edge, samples the middle of each following bit at its own rate, and
waits for the next edge. It also returns bytes with a wrong stop bit, as PC drivers do.
"""

from bisect import bisect_right

import numpy as np
import numpy.typing as npt

_Times = npt.NDArray[np.float64]
_Bits = npt.NDArray[np.uint8]
_DATA_BITS = 8
_FRAME_BITS = 10  # start bit, eight data bits, stop bit


def resample(data: bytes, *, ratio: float, gap_bits: float = 0.0) -> bytes:
    """Return what a reader at `ratio` times the sender's rate reads, with `gap_bits` of idle line between bytes."""
    return _read(*_levels(data, ratio, gap_bits))


def _levels(data: bytes, ratio: float, gap_bits: float) -> tuple[_Times, _Bits]:
    """Return the times at which a level ends, in bits of the reader, and the levels."""
    count = len(data)
    bits = np.ones((count, _FRAME_BITS), np.uint8)  # the start bit is 0, the stop bit 1, the lowest bit first
    bits[:, 0] = 0
    bits[:, 1:-1] = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little").reshape(count, _DATA_BITS)
    lengths = np.full((count, _FRAME_BITS), float(ratio))
    lengths[:, -1] += gap_bits * ratio
    ends = np.cumsum(np.concatenate(([_FRAME_BITS], lengths.ravel(), [2 * _FRAME_BITS])))
    return ends, np.concatenate(([1], bits.ravel(), [1])).astype(np.uint8)


def _read(ends: _Times, levels: _Bits) -> bytes:
    starts = np.array(_starts(ends, levels))
    middles = starts[:, np.newaxis] + 1.5 + np.arange(_DATA_BITS)
    at = np.minimum(np.searchsorted(ends, middles.ravel(), side="right"), len(ends) - 1)
    return np.packbits(levels[at].reshape(-1, _DATA_BITS), axis=1, bitorder="little").tobytes()


def _starts(ends: _Times, levels: _Bits) -> list[float]:
    """Return the times at which the reader detects a start bit. Each depends on the one before."""
    low = np.flatnonzero(levels == 0)
    low_ends, low_begins = ends[low].tolist(), ends[low - 1].tolist()
    found: list[float] = []
    at = 0.0
    while (number := bisect_right(low_ends, at)) < len(low_ends):
        found.append(max(at, low_begins[number]))
        at = found[-1] + 1.5 + _DATA_BITS
    return found
