"""WritePace: how much is written to a client that reads slowly before it confirms what it has read. Pure.

The kernel of the client keeps what its program has not read, by the defaults of Linux 128 KiB: seconds of messages,
which nothing replaces or drops. A ping behind a write is answered when the client has read all before it.
"""

WRITE_BYTES = 64 * 1024  # in one write, unless one message is larger
LEAST_BYTES = 4 * 1024  # the same, to a slow client
SLOW_S = 0.25  # a client is slow whose socket takes nothing for so long; what it is sent at once it reads in this time


class WritePace:
    """Pace of writing to one client.

    | client                        | what happens                                                               |
    |-------------------------------|----------------------------------------------------------------------------|
    | takes all at once             | is written to without a ping                                               |
    | takes nothing for SLOW_S      | gets LEAST_BYTES and a ping, and the next after its pong                   |
    | pong within SLOW_S            | gets twice as much the next time; from WRITE_BYTES on again without a ping |
    | pong after more than 2 SLOW_S | gets half as much the next time, but LEAST_BYTES                           |
    | no pong                       | is no longer sent pings (`give_up`)                                        |
    """

    def __init__(self) -> None:
        self.max_bytes = WRITE_BYTES  # of the next write, unless one message is larger
        self._is_answering = True
        self._number = 0  # of the last ping
        self._asked_s: float | None = None  # time of the ping that is not answered

    @property
    def is_waiting(self) -> bool:
        """Whether the next write waits for a pong."""
        return self._asked_s is not None

    def note_pause(self, pause_s: float) -> None:
        """Note that the transport's buffer was not empty for so long."""
        if pause_s >= SLOW_S and self._is_answering:
            self.max_bytes = LEAST_BYTES

    def ask(self, now_s: float) -> bytes:
        """Return the payload of the ping behind a write; empty if it needs none."""
        if self.max_bytes >= WRITE_BYTES:
            return b""
        self._number += 1
        self._asked_s = now_s
        return self._payload

    def confirm(self, payload: bytes, now_s: float) -> bool:
        """Note a pong. Return whether it ends the wait."""
        if self._asked_s is None or payload != self._payload:
            return False
        took_s, self._asked_s = now_s - self._asked_s, None
        if took_s < SLOW_S:
            self.max_bytes *= 2
        elif took_s > 2 * SLOW_S:
            self.max_bytes = max(LEAST_BYTES, self.max_bytes // 2)
        return True

    def skip(self) -> None:
        """End the wait: pongs are not read now."""
        self._asked_s = None

    def give_up(self) -> None:
        """End the wait, and ask no more: the client does not answer pings."""
        self._asked_s, self._is_answering, self.max_bytes = None, False, WRITE_BYTES

    @property
    def _payload(self) -> bytes:
        return str(self._number).encode()
