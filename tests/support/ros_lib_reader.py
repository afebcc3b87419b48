"""Reader of the original client library, byte by byte: from rosserial's spinOnce, not from hostlink."""

from collections.abc import Callable

TIMEOUT_S = 0.020  # of a frame, from its first byte


class RosLibReader:
    """Finds frames in bytes. `gives_up`: it drops one that is not complete after TIMEOUT_S, as most versions do."""

    def __init__(self, on_frame: Callable[[int, bytes], None], *, gives_up: bool = True) -> None:
        self.cut_frames = 0  # which began and were not completed
        self._on_frame = on_frame
        self._gives_up = gives_up
        self._head = bytearray()  # sync, version, two of size, its checksum, two of topic id
        self._body = bytearray()  # payload and checksum
        self._size = 0
        self._began_s = 0.0

    def turn(self, data: bytes, now_s: float) -> None:
        """One call of spinOnce, which finds these bytes waiting."""
        if self._head and self._gives_up and now_s > self._began_s + TIMEOUT_S:
            self.cut_frames += 1
            self._reset()
        at = 0
        while at < len(data):
            if len(self._head) == 7:
                missing = self._size + 1 - len(self._body)
                self._body += data[at : at + missing]
                at += missing
                if len(self._body) == self._size + 1:
                    self._finish()
                continue
            if not self._head:
                at = data.find(b"\xff", at)
                if at < 0:
                    return
                self._began_s = now_s
            self._head.append(data[at])
            at += 1
            self._check_head()

    def _check_head(self) -> None:
        head = self._head
        if len(head) == 2 and head[1] != 0xFE:
            self._reset()
        elif len(head) == 5:
            self._size = head[2] + (head[3] << 8)
            if sum(head[2:5]) % 256 != 255:
                self._reset()

    def _finish(self) -> None:
        topic_id, payload = self._head[5] + (self._head[6] << 8), bytes(self._body[:-1])
        is_good = (sum(self._head[5:7]) + sum(self._body)) % 256 == 255
        self._reset()
        self.cut_frames += not is_good
        if is_good:
            self._on_frame(topic_id, payload)

    def _reset(self) -> None:
        self._head.clear()
        self._body.clear()
