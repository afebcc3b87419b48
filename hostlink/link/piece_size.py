"""PieceSize: how much of a device's bytes is read at once, by what reading them costs. Pure."""

from hostlink.protocol.frame import SYNC

MOST_BYTES = 4096  # four frames of 1 KiB: one that is read in parts costs twice as much
FIRST_BYTES = 512  # of the first piece nobody knows what it costs; what a robot sends at once is mostly less
LEAST_BYTES = 64  # reading itself costs as much as the smallest frames in it
PIECE_S = 0.0005  # others have their turn after it: a piece of requests that are all refused took 3 ms
MOST_FRAMES = FIRST_BYTES // 8  # of one piece: as many as FIRST_BYTES hold, which bounds what one can cost
LARGE_PIECE_S = 0.0001  # of more than FIRST_BYTES: half a turn of all links, so that a flood delays nobody by it


class PieceSize:
    """Of one link: smaller after a piece that was expensive, larger again after some that were cheap."""

    __slots__ = ("size_bytes",)

    def __init__(self) -> None:
        self.size_bytes = FIRST_BYTES

    def is_crowded(self, data: bytes) -> bool:
        """Whether a piece is to be read in parts: after long frames, that were cheap, came many short ones."""
        is_likely = len(data) > FIRST_BYTES and data.count(SYNC[:1]) > MOST_FRAMES  # a third of the time of the next
        return is_likely and data.count(SYNC) > MOST_FRAMES

    def update(self, cost_s: float) -> None:
        """A piece was read, and what was in it has cost this."""
        is_large = self.size_bytes > FIRST_BYTES
        if cost_s > (LARGE_PIECE_S if is_large else PIECE_S):
            self.size_bytes = max(LEAST_BYTES, self.size_bytes // 2)
        elif cost_s < (LARGE_PIECE_S / 2 if self.size_bytes >= FIRST_BYTES else PIECE_S / 4):
            self.size_bytes = min(MOST_BYTES, self.size_bytes * 2)
