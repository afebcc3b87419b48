"""Whether work grows in proportion to its size, on a machine that also does other things."""

import gc
from collections.abc import Callable

TRIES = 5  # the best of them: what else runs only makes it longer
SHORTEST_S = 0.01


def is_linear(seconds: Callable[[int], float], size: int) -> bool:
    """Whether four times `size` lasts less than ten times as long; a square would last sixteen times.

    What is linear lasts up to six times as long: more of it is not in the caches.
    """
    gc.collect()
    limit_s = 10 * max(min(seconds(size) for _ in range(TRIES)), SHORTEST_S)
    return any(seconds(4 * size) < limit_s for _ in range(TRIES))
