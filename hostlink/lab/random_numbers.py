"""RandomNumbers: PCG32 (O'Neill 2014, XSH-RR) and normal numbers by Box and Muller. Pure."""

import math

_MULTIPLIER = 6364136223846793005
_MASK_64 = (1 << 64) - 1
_MASK_32 = (1 << 32) - 1


class RandomNumbers:
    """A sequence that its seed and its stream decide."""

    def __init__(self, seed: int, stream: int) -> None:
        self._state = 0
        self._increment = ((stream << 1) | 1) & _MASK_64
        self._next()
        self._state = (self._state + seed) & _MASK_64
        self._next()

    def uniform(self) -> float:
        """A number in (0, 1)."""
        return (self._next() + 0.5) / 4294967296.0

    def normal(self) -> float:
        """A number with mean 0 and standard deviation 1."""
        radius = math.sqrt(-2.0 * math.log(self.uniform()))
        return radius * math.cos(math.tau * self.uniform())

    def _next(self) -> int:
        old = self._state
        self._state = (old * _MULTIPLIER + self._increment) & _MASK_64
        shifted = (((old >> 18) ^ old) >> 27) & _MASK_32
        turn = old >> 59
        return ((shifted >> turn) | (shifted << (-turn & 31))) & _MASK_32
