"""Thinned: a bounded number of samples at equal steps. Pure."""

from typing import Generic, TypeVar

Sample = TypeVar("Sample")


class Thinned(Generic[Sample]):
    """Samples at equal steps, at most twice `most`, and always the last one."""

    def __init__(self, most: int) -> None:
        self._most, self._step, self._count = most, 1, 0
        self._kept: list[Sample] = []
        self._last: Sample | None = None

    def add(self, sample: Sample) -> None:
        """Add the next sample. Without room, drop every second kept sample."""
        if self._count % self._step == 0:
            self._kept.append(sample)
            self._last = None
            if len(self._kept) > 2 * self._most:
                self._kept = self._kept[::2]
                self._step *= 2
        else:
            self._last = sample
        self._count += 1

    def samples(self) -> list[Sample]:
        """Return the kept samples in order."""
        return self._kept if self._last is None else [*self._kept, self._last]
