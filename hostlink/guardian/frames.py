"""Frames that the guardian sends: zero velocity, and the request to stop sending. Pure, without imports.

No frame here moves a robot: only the topic ids of a velocity can be chosen.
"""

TWIST_BYTES = 48  # geometry_msgs/Twist: six float64
ZEROS = 3  # as many as the daemon sends on shutdown: a radio may lose one
INTERVAL_S = 0.05
STOP_REQUEST = b"\xff\xfe\x00\x00\xff\x0b\x00\xf4"  # id 11


def zero_frame(topic_id: int) -> bytes:
    """Encode a Twist of zeros for this topic."""
    low, high = topic_id & 0xFF, topic_id >> 8
    header = bytes((0xFF, 0xFE, TWIST_BYTES, 0, 0xFF - TWIST_BYTES, low, high))
    return header + bytes(TWIST_BYTES) + bytes((0xFF - (low + high) % 256,))


def stop_sequence(topic_ids: tuple[int, ...], claim_bytes: int, *, is_end: bool = True) -> list[tuple[float, bytes]]:
    """Return the parts to send, each with its time in seconds.

    `claim_bytes` is the longest frame that may have been sent to the device. `is_end`: the daemon is gone. A daemon
    that only hangs may recover, so its devices are not requested to stop sending.

    The daemon may have ended in the middle of a frame. The device takes the next bytes for the rest of that frame. The
    first zero is therefore repeated over the length of any frame: wherever the frame ends or is given up, the next zero
    is whole.

    | the device                                              | obeys                                                  |
    |---------------------------------------------------------|--------------------------------------------------------|
    | is between frames                                       | the first zero                                         |
    | is inside a frame, and never gives it up                | the second zero after the frame's end                  |
    | is inside a frame, and gives it up (20 ms, ros_lib)     | that zero, or the first after it gave up, within 50 ms |
    | lost bytes, because it or its radio was busy            | the zeros after 50 and 100 ms                          |
    """
    zero = b"\0".join(map(zero_frame, topic_ids))  # of all topics; the rule below holds for each of them
    # A 00 between frames is ignored; without it, a frame that ends with FF would hide the next sync.
    again = b"\0" + zero
    first = zero + again * (1 + -(-claim_bytes // len(again))) if claim_bytes else zero
    parts = [first, *[zero] * (ZEROS - 1), *[STOP_REQUEST] * is_end]
    return [(number * INTERVAL_S, part) for number, part in enumerate(parts)]


class StopWriter:
    """Unsent part of one device's stop sequence."""

    def __init__(self, topic_ids: tuple[int, ...], claim_bytes: int, *, is_end: bool = True) -> None:
        self._topic_ids, self._claim_bytes, self._is_end = topic_ids, claim_bytes, is_end
        self._due: list[tuple[float, bytes]] = []
        self._waiting = b""
        self._is_begun = False

    def pop_due(self, now_s: float) -> bytes:
        """Return the unwritten bytes that are due `now_s` after the daemon's end."""
        if not self._is_begun:  # built late, because a sequence may be long and there are many connections
            self._is_begun = True
            self._due = stop_sequence(self._topic_ids, self._claim_bytes, is_end=self._is_end)
        while self._due and self._due[0][0] <= now_s:
            self._waiting += self._due.pop(0)[1]
        return self._waiting

    def written(self, count: int) -> None:
        """Note that the connection accepted `count` bytes."""
        self._waiting = self._waiting[count:]

    @property
    def has_waiting(self) -> bool:
        """Whether due bytes are unwritten."""
        return bool(self._waiting)

    def next_s(self) -> float | None:
        """Time of the next part after the start; None if none is left."""
        return self._due[0][0] if self._due else None

    def is_done(self) -> bool:
        """Whether the whole sequence was written."""
        return self._is_begun and not self._due and not self._waiting
