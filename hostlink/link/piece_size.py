"""PieceSize: how much of a device's bytes is read at once, by what reading them costs. Pure."""

MOST_BYTES = 512  # what a robot sends at once is mostly less
LEAST_BYTES = 64  # reading itself costs as much as the smallest frames in it
PIECE_S = 0.0005  # others have their turn after it: a piece of requests that are all refused took 3 ms


class PieceSize:
    """Of one link: smaller after a piece that was expensive, larger again after some that were cheap."""

    __slots__ = ("size_bytes",)

    def __init__(self) -> None:
        self.size_bytes = MOST_BYTES

    def update(self, cost_s: float) -> None:
        """A piece was read, and what was in it has cost this."""
        if cost_s > PIECE_S:
            self.size_bytes = max(LEAST_BYTES, self.size_bytes // 2)
        elif cost_s < PIECE_S / 4:
            self.size_bytes = min(MOST_BYTES, self.size_bytes * 2)
