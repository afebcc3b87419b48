"""Times at which the frames that stop a robot are sent. Pure, with one small import.

The daemon's session makes the frames and the bytes between them. No byte is chosen here.
"""

from hostlink.core.runtime.stop_frames import StopFrames

ZEROS = 3  # as many as the daemon sends on shutdown: a radio may lose one
UNLIMITED = 1 << 32


def stop_sequence(stop: StopFrames, *, has_end: bool = True, part_bytes: int = UNLIMITED) -> list[tuple[float, bytes]]:
    """Return the parts to send, each with its time in seconds.

    `has_end`: the device is requested to stop sending. A daemon that only hangs may recover, so its devices are not
    requested to. `part_bytes` is the limit of a part of several frames: a datagram.

    The daemon may have ended in the middle of a frame. Where `claim_bytes` is the length of the longest frame, the
    device takes the next bytes for the rest of that frame. The zeros are therefore repeated over the length of any
    frame: wherever the frame ends or is given up, the next zero of each endpoint is whole. The lead completes a header
    that was cut inside its length: it is rejected, or its frame is at most as long as it was.

    | the device                                              | obeys                                                  |
    |---------------------------------------------------------|--------------------------------------------------------|
    | is between frames                                       | the first zeros                                        |
    | is inside a frame, and never gives it up                | at the latest the second zeros after the frame's end   |
    | is inside a frame, and gives it up (20 ms, ros_lib)     | those, or the first after it gave up, within 50 ms     |
    | lost bytes, because it or its radio was busy            | the zeros after 50 and 100 ms                          |

    The second row needs zeros without the beginning of a frame after their first byte. It would begin a frame for a
    device that reads from the middle of a zero.
    """
    once = packed(stop.zeros, stop.separator, part_bytes)
    first = once
    if stop.claim_bytes:
        zero = stop.separator.join(stop.zeros)
        again = stop.separator + zero
        first = [stop.lead + zero + again * (1 + -(-stop.claim_bytes // len(again)))]
    turns = [first, *[once] * (ZEROS - 1), [stop.end] if stop.end and has_end else []]
    return [(number * stop.interval_s, part) for number, parts in enumerate(turns) for part in parts]


def packed(frames: tuple[bytes, ...], separator: bytes, part_bytes: int) -> list[bytes]:
    """Join frames to as few parts as this limit allows, in their order. A longer frame is a part by itself.

    Without a separator each frame is a part.
    """
    parts: list[bytes] = []
    for frame in frames:
        if separator and parts and len(parts[-1]) + len(separator) + len(frame) <= part_bytes:
            parts[-1] += separator + frame
        else:
            parts.append(frame)
    return parts


class StopWriter:
    """Unsent part of one device's stop sequence. The arguments are those of `stop_sequence`."""

    def __init__(self, stop: StopFrames, *, has_end: bool = True, part_bytes: int = UNLIMITED) -> None:
        self._stop, self._has_end, self._part_bytes = stop, has_end, part_bytes
        self._due: list[tuple[float, bytes]] = []
        self._waiting: list[bytes] = []  # parts that are due
        self._is_begun = False

    def pop_due(self, now_s: float) -> bytes:
        """Return the unwritten bytes of the oldest part that is due `now_s` after the daemon's end."""
        if not self._is_begun:  # built late, because a sequence may be long and there are many connections
            self._is_begun = True
            self._due = stop_sequence(self._stop, has_end=self._has_end, part_bytes=self._part_bytes)
        while self._due and self._due[0][0] <= now_s:
            self._waiting.append(self._due.pop(0)[1])
        return self._waiting[0] if self._waiting else b""

    def answer(self, answers: list[bytes]) -> None:
        """Put answers to the device, and the zeros once more, behind what is due.

        They are dropped while a part waits: the device does not read.
        """
        if answers and not self._waiting:
            self._waiting += answers
            self._waiting += packed(self._stop.zeros, self._stop.separator, self._part_bytes)

    def written(self, count: int) -> None:
        """Note that the connection accepted `count` bytes of that part."""
        rest = self._waiting.pop(0)[count:]
        if rest:
            self._waiting.insert(0, rest)

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
