"""What the guardian sends: a zero velocity, and the request to fall silent. Pure; imports nothing, for a small process.

There is no frame here that moves a robot: of a velocity only the topic id can be chosen.
"""

TWIST_BYTES = 48  # geometry_msgs/Twist: six float64
ZEROS = 3  # as many as the daemon's own farewell: a single one can be lost on a radio
INTERVAL_S = 0.05
STOP_REQUEST = b"\xff\xfe\x00\x00\xff\x0b\x00\xf4"  # id 11


def zero_frame(topic_id: int) -> bytes:
    """A Twist of zeros for this topic."""
    low, high = topic_id & 0xFF, topic_id >> 8
    header = bytes((0xFF, 0xFE, TWIST_BYTES, 0, 0xFF - TWIST_BYTES, low, high))
    return header + bytes(TWIST_BYTES) + bytes((0xFF - (low + high) % 256,))


def stop_sequence(topic_id: int, claim_bytes: int) -> list[tuple[float, bytes]]:
    """What is due after so many seconds. `claim_bytes`: the longest frame that the device may have been sent.

    The daemon may have ended in the middle of a frame; a device takes what comes next for the rest of it.

    | the device                                             | obeys                                             |
    |--------------------------------------------------------|---------------------------------------------------|
    | waits for nothing                                      | the first zero                                    |
    | is inside a velocity                                   | the second: the first completed that frame        |
    | is inside a longer frame, gives it up (20 ms, ros_lib) | the second, 50 ms after the first                 |
    | is inside a longer frame, never gives up, or was busy  | the third: before it stand as many bytes as any   |
    | elsewhere and reads all of this at once                | frame can claim; outside a frame a 00 means nothing |
    """
    zero = zero_frame(topic_id)
    parts = [zero] * ZEROS
    parts[-2] += bytes(max(0, claim_bytes - (ZEROS - 1) * len(zero)))
    due = [(number * INTERVAL_S, part) for number, part in enumerate(parts)]
    return [*due, (ZEROS * INTERVAL_S, STOP_REQUEST)]


class StopWriter:
    """What one device is still owed of its stop sequence."""

    def __init__(self, topic_id: int, claim_bytes: int) -> None:
        self._due = stop_sequence(topic_id, claim_bytes)
        self._waiting = b""

    def take_due(self, now_s: float) -> bytes:
        """What should be written by now, `now_s` after the daemon's end, and was not."""
        while self._due and self._due[0][0] <= now_s:
            self._waiting += self._due.pop(0)[1]
        return self._waiting

    def written(self, count: int) -> None:
        """The connection took so many bytes of it."""
        self._waiting = self._waiting[count:]

    def next_s(self) -> float | None:
        """When there is more to write; None: never."""
        return self._due[0][0] if self._due else None

    def is_done(self) -> bool:
        """Whether all has been written."""
        return not self._due and not self._waiting
