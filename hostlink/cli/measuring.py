"""Figures of the messages of a topic: rate, bandwidth, delay. Pure; times and sizes come in."""

import itertools
import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

WINDOW = 10_000  # messages, as rostopic has it
BYTES_PER_MB = 1_000_000


@dataclass(frozen=True, slots=True)
class Distribution:
    """What many numbers are like."""

    count: int
    mean: float
    least: float
    most: float
    deviation: float


def distribution(numbers: Iterable[float]) -> Distribution | None:
    """None: there are no numbers."""
    known = list(numbers)
    if not known:
        return None
    mean = math.fsum(known) / len(known)
    variance = math.fsum((each - mean) ** 2 for each in known) / len(known)
    return Distribution(len(known), mean, min(known), max(known), math.sqrt(variance))


class Measured:
    """The messages of the window: when they came, and a figure of each."""

    def __init__(self, window: int) -> None:
        self.messages = 0
        self._times_s: deque[float] = deque(maxlen=window)
        self._figures: deque[float] = deque(maxlen=window)

    def add(self, time_s: float, figure: float = 0.0) -> None:
        """One message."""
        self.messages += 1
        self._times_s.append(time_s)
        self._figures.append(figure)

    @property
    def figures(self) -> Distribution | None:
        """None before the first message."""
        return distribution(self._figures)

    @property
    def between_s(self) -> Distribution | None:
        """From each message to the next; None before the second of them."""
        times_s = list(self._times_s)
        return distribution(later - earlier for earlier, later in itertools.pairwise(times_s))

    @property
    def rate_hz(self) -> float:
        """0 before the second message."""
        between_s = self.between_s
        return 0.0 if between_s is None or between_s.mean <= 0 else 1 / between_s.mean


def duration(seconds: float) -> str:
    """With as many digits as a person reads: 0.412 ms, 33.3 ms, 1.23 s."""
    value = abs(seconds)
    if value == 0:
        return "0 ms"
    if value >= 1:
        return f"{seconds:.2f} s"
    return f"{seconds * 1000:.1f} ms" if value >= 0.001 else f"{seconds * 1000:.3f} ms"  # noqa: PLR2004 - a millisecond


def size(count: float) -> str:
    """Bytes: 320 B, 9.6 kB, 1.2 MB."""
    for unit in ("B", "kB", "MB"):
        if count < 1000:  # noqa: PLR2004 - orders of magnitude
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} GB"


def megabytes(count: float) -> str:
    """Of a file: always in MB, so that a column or a line that is written again and again keeps its unit."""
    return f"{count / BYTES_PER_MB:.1f} MB"
