"""Times at which the frames that stop a robot are sent. Pure, without imports.

The daemon makes the frames. No byte of a frame is chosen here, except the 00 between two frames.
"""

ZEROS = 3  # as many as the daemon sends on shutdown: a radio may lose one
INTERVAL_S = 0.05
SEPARATOR = b"\0"  # ignored between frames; without it, a frame that ends with FF would hide the next sync
LEAD = bytes(3)  # length and checksum of a header after the sync. A sync there could give it a length of 65 kB
UNLIMITED = 1 << 32


def stop_sequence(
    zeros: tuple[bytes, ...], claim_bytes: int, end: bytes = b"", *, part_bytes: int = UNLIMITED
) -> list[tuple[float, bytes]]:
    """Return the parts to send, each with its time in seconds.

    `zeros` are the frames that stop the device, one for each velocity endpoint. `claim_bytes` is the longest frame that
    may have been sent to the device. `end` requests it to stop sending. A daemon that only hangs may recover, so its
    devices are not requested to. `part_bytes` is the limit of a part of several frames: a datagram.

    The daemon may have ended in the middle of a frame. The device takes the next bytes for the rest of that frame. The
    zeros are therefore repeated over the length of any frame: wherever the frame ends or is given up, the next zero of
    each endpoint is whole. `LEAD` completes a header that was cut inside its length: it is rejected, or its frame is at
    most as long as it was.

    | the device                                              | obeys                                                  |
    |---------------------------------------------------------|--------------------------------------------------------|
    | is between frames                                       | the first zeros                                        |
    | is inside a frame, and never gives it up                | at the latest the second zeros after the frame's end   |
    | is inside a frame, and gives it up (20 ms, ros_lib)     | those, or the first after it gave up, within 50 ms     |
    | lost bytes, because it or its radio was busy            | the zeros after 50 and 100 ms                          |

    The second row needs zeros without the sync FF FE after their first byte. It would begin a frame for a device that
    reads from the middle of a zero.
    """
    once = packed(zeros, part_bytes)
    first = once
    if claim_bytes:
        zero = SEPARATOR.join(zeros)
        again = SEPARATOR + zero
        first = [LEAD + zero + again * (1 + -(-claim_bytes // len(again)))]
    turns = [first, *[once] * (ZEROS - 1), [end] if end else []]
    return [(number * INTERVAL_S, part) for number, parts in enumerate(turns) for part in parts]


def packed(frames: tuple[bytes, ...], part_bytes: int) -> list[bytes]:
    """Join frames to as few parts as this limit allows, in their order. A longer frame is a part by itself."""
    parts: list[bytes] = []
    for frame in frames:
        if parts and len(parts[-1]) + len(SEPARATOR) + len(frame) <= part_bytes:
            parts[-1] += SEPARATOR + frame
        else:
            parts.append(frame)
    return parts


class StopWriter:
    """Unsent part of one device's stop sequence. The arguments are those of `stop_sequence`."""

    def __init__(
        self, zeros: tuple[bytes, ...], claim_bytes: int, end: bytes = b"", *, part_bytes: int = UNLIMITED
    ) -> None:
        self._zeros, self._claim_bytes, self._end, self._part_bytes = zeros, claim_bytes, end, part_bytes
        self._due: list[tuple[float, bytes]] = []
        self._waiting: list[bytes] = []  # parts that are due
        self._is_begun = False

    def pop_due(self, now_s: float) -> bytes:
        """Return the unwritten bytes of the oldest part that is due `now_s` after the daemon's end."""
        if not self._is_begun:  # built late, because a sequence may be long and there are many connections
            self._is_begun = True
            self._due = stop_sequence(self._zeros, self._claim_bytes, self._end, part_bytes=self._part_bytes)
        while self._due and self._due[0][0] <= now_s:
            self._waiting.append(self._due.pop(0)[1])
        return self._waiting[0] if self._waiting else b""

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
