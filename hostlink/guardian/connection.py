"""A duplicate of one robot's connection in the guardian's process, and how it is written when the daemon is gone."""

import _socket
import fcntl
import os
import select
import sys
import termios

from hostlink.guardian.frames import StopWriter

STALE_BYTES = 128  # a turn of a robot's loop at 38400 baud: what the daemon's pacing may leave in a serial port
READ_BYTES = 65536
DATAGRAM_BYTES = 1024  # of one write over UDP: no network splits it
_GONE = select.POLLERR | select.POLLHUP | select.POLLNVAL


class Connection:
    """TCP, UDP or serial. Reading and writing are the daemon's before the first `step`, unless it hangs.

    | call              | while the daemon        | writes                      | reads, closes |
    |-------------------|-------------------------|-----------------------------|---------------|
    | `hold`, repeated  | hangs, and may go on    | zeros                       | never         |
    | `step`, repeated  | is gone                 | zeros, then id 11           | all, at last  |
    """

    def __init__(self, descriptor: int, topic_ids: tuple[int, ...], claim_bytes: int) -> None:
        self.descriptor = descriptor
        self.is_open = True
        self._is_serial = os.isatty(descriptor)
        self._is_udp = not self._is_serial and _is_udp(descriptor)
        if self._is_udp and claim_bytes <= DATAGRAM_BYTES:
            claim_bytes = 0  # such a frame left as one datagram, whole or not at all
        self._topic_ids, self._claim_bytes = topic_ids, claim_bytes
        self._writer = StopWriter(topic_ids, claim_bytes)
        self._zeros = self._writer  # of `hold`
        self._is_readable = True  # until its end has come
        self._is_begun = self._is_finished = False

    def close(self) -> None:
        """Close the duplicate; another process's descriptor of the same connection stays as it is."""
        if self.is_open:
            self.is_open = False
            try:  # noqa: SIM105 - contextlib is not small
                os.close(self.descriptor)
            except OSError:
                pass  # the port has vanished; it is closed all the same

    def begin_hold(self) -> None:
        """The daemon hangs: zeros are due from now on."""
        self._zeros = StopWriter(self._topic_ids, self._claim_bytes, is_end=False)

    def hold(self, now_s: float) -> float | None:
        """Write the zeros that are due and have room, `now_s` after `begin_hold`; returns when to call it again.

        None: there is nothing more to write. An error is left to the daemon, whose connection it is.
        """
        try:
            self._write(self._zeros, now_s)
        except OSError:
            return None
        return now_s if self._zeros.has_waiting else self._zeros.next_s()

    def events(self, now_s: float) -> int:
        """What poll() should wait for."""
        wanted = select.POLLIN if self._is_readable else 0
        return wanted | select.POLLOUT if self._writer.pop_due(now_s) else wanted

    def next_s(self) -> float | None:
        """When there is more to write; None: never."""
        return self._writer.next_s()

    def step(self, events: int, now_s: float) -> None:
        """Write what is due and has room, discard what came; what goes wrong here ends this connection alone."""
        try:
            if not self._is_begun:
                self._begin()
            if events & _GONE and not events & select.POLLIN and not self._is_udp:
                self.close()
                return
            self._write(self._writer, now_s)
            if events & (select.POLLIN | _GONE):
                self._discard()
            if self.is_open and self._writer.is_done():
                self._finish()
        except (OSError, termios.error):  # the second is none of the first
            self.close()

    def abandon(self) -> None:
        """The time is over: what has not left now never will, and close() would wait for it."""
        try:
            if self.is_open and self._is_serial:
                termios.tcflush(self.descriptor, termios.TCOFLUSH)
        except termios.error:
            self.close()
        self.close()

    def _begin(self) -> None:
        """The daemon is gone: the connection is this process's alone."""
        self._is_begun = True
        os.set_blocking(self.descriptor, False)
        if self._is_serial and self._unsent_bytes() > STALE_BYTES:  # old commands would take too long
            termios.tcflush(self.descriptor, termios.TCOFLUSH)

    def _write(self, writer: StopWriter, now_s: float) -> None:
        try:
            while waiting := writer.pop_due(now_s):
                writer.written(self._send(waiting) if self._is_udp else os.write(self.descriptor, waiting))
        except BlockingIOError:
            return  # poll() returns when there is room

    def _send(self, waiting: bytes) -> int:
        """A datagram of it. An error may be about an earlier one; one that cannot be sent at all is lost, as others."""
        datagram = waiting[:DATAGRAM_BYTES]
        for _ in range(2):
            try:
                return os.write(self.descriptor, datagram)
            except BlockingIOError:
                raise
            except OSError:
                continue
        return len(datagram)

    def _discard(self) -> None:
        """A device whose bytes nobody takes may stop reading; closing a connection with unread bytes resets it."""
        if self._is_udp:
            _discard_datagram(self.descriptor)
            return
        try:
            self._is_readable = bool(os.read(self.descriptor, READ_BYTES))
        except BlockingIOError:
            return
        if self._is_serial and not self._is_readable:
            self.close()  # it hung up

    def _finish(self) -> None:
        """All is written: a serial port is closed when it has sent that, a TCP connection when its peer closes too."""
        if self._is_udp:
            self.close()
            return
        if self._is_serial:
            if not self._unsent_bytes():
                self.close()
            return
        if not self._is_finished:
            self._is_finished = True
            _end_sending(self.descriptor)
        if not self._is_readable:
            self.close()

    def _unsent_bytes(self) -> int:
        """What a serial port has not sent yet; 0 where the driver has no such figure."""
        try:
            count = fcntl.ioctl(self.descriptor, termios.TIOCOUTQ, bytes(4))
        except OSError:
            return 0
        return int.from_bytes(count, sys.byteorder)


def _is_udp(descriptor: int) -> bool:
    try:
        connection = _socket.socket(fileno=descriptor)
    except OSError:
        return False
    kind = connection.type
    connection.detach()
    return kind == _socket.SOCK_DGRAM


def _discard_datagram(descriptor: int) -> None:
    """An empty one is no end, and neither is an error: it may be about one that was sent before."""
    try:
        os.read(descriptor, READ_BYTES)
    except OSError:
        return


def _end_sending(descriptor: int) -> None:
    """The peer reads to the end of what was written, then its end."""
    connection = _socket.socket(fileno=descriptor)
    try:
        connection.shutdown(_socket.SHUT_WR)
    finally:
        connection.detach()
