"""Whether work grows in proportion to its size, on a machine that also does other things."""

import gc
from collections.abc import Callable

TRIES = 3  # the best of them: what else runs only makes it longer
SHORTEST_S = 0.01


def is_linear(seconds: Callable[[int], float], size: int) -> bool:
    """Whether four times `size` lasts less than eight times as long; a square would last sixteen times."""

    def best(of_size: int) -> float:
        gc.collect()
        return min(seconds(of_size) for _ in range(TRIES))

    return best(4 * size) < 8 * max(best(size), SHORTEST_S)
