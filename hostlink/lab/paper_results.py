"""What the paper measured: tables 2-5 (docs/robot.md#what-the-paper-measured). Pure."""

import numpy as np
from numpy.typing import NDArray

SQUARE_SIDE_M = 2.0
LINE_TABLE = 4  # the only one with a length instead of x and y
LINE_M = (3.84, 3.52, 3.47, 3.96, 3.95)  # of table 4, as measured on the floor

# A row each run: |x| and |y|, or |length|; the length has more digits than the columns that it is the difference of.
PAPER_CM: dict[int, NDArray[np.float64]] = {
    2: np.array([(26.0, 0.0), (28.0, 3.0), (36.0, 6.0)]),  # square, counterclockwise
    3: np.array([(41.0, 53.0), (45.0, 26.0), (35.0, 12.0)]),  # square, clockwise
    LINE_TABLE: np.array([(2.97,), (0.64,), (1.96,), (1.79,), (1.84,)]),
    5: np.array([(0.0, 7.0), (2.0, 15.0), (6.0, 0.0)]),  # there and back
}


def axes_of(table: int) -> tuple[str, ...]:
    """The columns of a table."""
    return ("length",) if table == LINE_TABLE else ("x", "y")
