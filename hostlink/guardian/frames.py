"""What the guardian sends: a zero velocity, and the request to fall silent. Pure; imports nothing, for a small process.

There is no frame here that moves a robot: of a velocity only the topic ids can be chosen.
"""

TWIST_BYTES = 48  # geometry_msgs/Twist: six float64
ZEROS = 3  # as many as the daemon's own shutdown: a single one can be lost on a radio
INTERVAL_S = 0.05
STOP_REQUEST = b"\xff\xfe\x00\x00\xff\x0b\x00\xf4"  # id 11


def zero_frame(topic_id: int) -> bytes:
    """A Twist of zeros for this topic."""
    low, high = topic_id & 0xFF, topic_id >> 8
    header = bytes((0xFF, 0xFE, TWIST_BYTES, 0, 0xFF - TWIST_BYTES, low, high))
    return header + bytes(TWIST_BYTES) + bytes((0xFF - (low + high) % 256,))


def stop_sequence(topic_ids: tuple[int, ...], claim_bytes: int, *, is_end: bool = True) -> list[tuple[float, bytes]]:
    """What is due after so many seconds. `claim_bytes`: the longest frame that the device may have been sent.

    `is_end`: the daemon is gone; one that only hangs may go on, and its devices are not requested to fall silent.

    The daemon may have ended in the middle of a frame; a device takes what comes next for the rest of it. So the first
    zero is repeated over the length of any claim: wherever that ends, or is given up, the next zero is whole.

    | the device                                              | obeys                                                  |
    |---------------------------------------------------------|--------------------------------------------------------|
    | waits for nothing                                       | the first zero                                         |
    | is inside a frame, and never gives it up                | the second one behind the frame's claimed end          |
    | is inside a frame, and gives it up (20 ms, ros_lib)     | that, or the first one after it gave up: within 50 ms  |
    | lost bytes, because it or its radio was busy            | those after 50 and 100 ms                              |
    """
    zero = b"\0".join(map(zero_frame, topic_ids))  # of all; what follows holds for the last as for the first
    again = b"\0" + zero  # a 00 means nothing between frames; without it one that ends with FF would hide the next
    first = zero + again * (1 + -(-claim_bytes // len(again))) if claim_bytes else zero
    parts = [first, *[zero] * (ZEROS - 1), *[STOP_REQUEST] * is_end]
    return [(number * INTERVAL_S, part) for number, part in enumerate(parts)]


class StopWriter:
    """What one device is still owed of its stop sequence."""

    def __init__(self, topic_ids: tuple[int, ...], claim_bytes: int, *, is_end: bool = True) -> None:
        self._topic_ids, self._claim_bytes, self._is_end = topic_ids, claim_bytes, is_end
        self._due: list[tuple[float, bytes]] = []
        self._waiting = b""
        self._is_begun = False

    def pop_due(self, now_s: float) -> bytes:
        """What should be written by now, `now_s` after the daemon's end, and was not."""
        if not self._is_begun:  # not before: a sequence may be long, and connections many
            self._is_begun = True
            self._due = stop_sequence(self._topic_ids, self._claim_bytes, is_end=self._is_end)
        while self._due and self._due[0][0] <= now_s:
            self._waiting += self._due.pop(0)[1]
        return self._waiting

    def written(self, count: int) -> None:
        """The connection took so many bytes of it."""
        self._waiting = self._waiting[count:]

    @property
    def has_waiting(self) -> bool:
        """Whether something that is due was not written."""
        return bool(self._waiting)

    def next_s(self) -> float | None:
        """When there is more to write, once it has begun; None: never."""
        return self._due[0][0] if self._due else None

    def is_done(self) -> bool:
        """Whether all has been written."""
        return self._is_begun and not self._due and not self._waiting
