"""Duplicate of one robot's connection in the guardian's process, and its writing when the daemon is gone."""

import _socket
import fcntl
import os
import select
import sys
import termios

from hostlink.core.guardian.frames import UNLIMITED, StopWriter
from hostlink.core.runtime.stop_frames import StopFrames

STALE_BYTES = 128  # one turn of a robot's loop at 38400 baud: the most that the daemon's pacing leaves in a serial port
READ_BYTES = 65536
DATAGRAM_BYTES = 1024  # of one write over UDP: no network fragments it
# A board waits for 0.1 s in each turn of its loop in which a message is lost, and takes one velocity a turn. Four may
# wait in front of the zero.
ANSWERING_S = 1.0
PEEKED = 64  # datagrams of a device that are looked at in one turn
_PEEK = _socket.MSG_PEEK | _socket.MSG_DONTWAIT
_SO_PEEK_OFF = 42  # Linux: each look continues behind the one before
_GONE = select.POLLERR | select.POLLHUP | select.POLLNVAL


class GuardedConnection:
    """Duplicate of a TCP, UDP or serial connection.

    Only the daemon reads and writes before the first `step`, except while it hangs.

    | call              | while the daemon        | writes                      | reads       | closes     |
    |-------------------|-------------------------|-----------------------------|-------------|------------|
    | `hold`, repeated  | hangs, and may recover  | zeros                       | (1)         | never      |
    | `step`, repeated  | is gone                 | zeros, then the end         | everything  | at the end |

    A device that waits until what it sends is acknowledged reads no zero before. While the daemon is gone, its
    `Acknowledger` answers what is read, and the zeros follow each answer.

    (1) What such a device sends is answered. Over UDP and TCP it is looked at, and stays for the daemon. A serial port
    cannot be looked at: it is read, and the daemon misses it. Otherwise the device would wait for seconds for each
    velocity that it has before the zero. From other devices nothing is read.
    """

    def __init__(self, descriptor: int, stop: StopFrames) -> None:
        self.descriptor = descriptor
        self.is_open = True
        self._is_serial = os.isatty(descriptor)
        self._is_udp = not self._is_serial and _is_udp(descriptor)
        self._part_bytes = DATAGRAM_BYTES if self._is_udp else UNLIMITED
        if self._is_udp and stop.claim_bytes <= DATAGRAM_BYTES:
            stop.claim_bytes = 0  # such a frame was sent as one datagram, whole or not at all
        self._stop = stop
        self._acknowledgers = _AcknowledgerSource(stop.acknowledger)
        self._acknowledger: _Acknowledger | None = None  # a new one each time: it knows numbers of that time
        self._writer = StopWriter(stop, part_bytes=self._part_bytes)
        self._holding = self._writer  # used by `hold`
        self._looked_bytes = 0  # of the stream of a TCP connection, by `hold`
        self._is_readable = True  # until the end of the stream was read
        self._is_begun = self._is_finished = False

    def close(self) -> None:
        """Close the duplicate. The daemon's descriptor of the same connection is not affected."""
        if self.is_open:
            self.is_open = False
            try:  # noqa: SIM105 - contextlib is a large import
                os.close(self.descriptor)
            except OSError:
                pass  # the port was removed; the descriptor is closed all the same

    def begin_hold(self) -> None:
        """Start the zeros for a daemon that hangs."""
        self._holding = StopWriter(self._stop, has_end=False, part_bytes=self._part_bytes)
        self._looked_bytes = 0
        has_answers = not self._is_udp or _peeks(self.descriptor)
        self._acknowledger = self._acknowledgers.make() if has_answers else None

    def hold(self, now_s: float) -> float | None:
        """Write the zeros that are due `now_s` after `begin_hold`, as far as there is room. Return when to call again.

        None: nothing is left to write, or an error occurred, which is left to the daemon.
        """
        try:
            self._write(self._holding, now_s)
            if self._acknowledger is not None:
                self._look(self._acknowledger)
                self._write(self._holding, now_s)
        except OSError:
            return None
        is_polled = self._holding.has_waiting or self._acknowledger is not None
        return now_s if is_polled else self._holding.next_s()

    def _look(self, acknowledger: "_Acknowledger") -> None:
        """Answer what waits for the daemon. It stays there, but on a serial port."""
        if self._is_serial:
            os.set_blocking(self.descriptor, False)
            try:
                received = os.read(self.descriptor, READ_BYTES)
            except BlockingIOError:
                received = b""
            self._holding.answer(acknowledger.receive(received))
            return
        connection, answers = _socket.socket(fileno=self.descriptor), list[bytes]()
        try:
            if self._is_udp:
                for _ in range(PEEKED):
                    answers += acknowledger.receive(connection.recv(READ_BYTES, _PEEK))
            else:  # each look at a stream begins with its first byte
                waiting = connection.recv(READ_BYTES, _PEEK)
                if len(waiting) < self._looked_bytes:  # the daemon reads again
                    self._acknowledger = None
                else:
                    answers += acknowledger.receive(waiting[self._looked_bytes :])
                    self._looked_bytes = len(waiting)
        except OSError:
            pass  # no more wait, or an error of an earlier datagram
        connection.detach()
        self._holding.answer(answers)

    def events(self, now_s: float) -> int:
        """Events for which poll() should wait."""
        wanted = select.POLLIN if self._is_readable else 0
        return wanted | select.POLLOUT if self._writer.pop_due(now_s) else wanted

    def next_s(self) -> float | None:
        """Time of the next write; None if none is left."""
        return self._writer.next_s()

    def step(self, events: int, now_s: float) -> None:
        """Write what is due, read received bytes and answer them. An error closes only this connection."""
        try:
            if not self._is_begun:
                self._begin()
            if events & _GONE and not events & select.POLLIN and not self._is_udp:
                self.close()
                return
            self._write(self._writer, now_s)
            if events & (select.POLLIN | _GONE):
                self._read()
                self._write(self._writer, now_s)
            if self.is_open and self._writer.is_done() and (self._acknowledger is None or now_s >= ANSWERING_S):
                self._finish()
        except (OSError, termios.error):  # termios.error is not an OSError
            self.close()

    def abandon(self) -> None:
        """Close at the end of the time. Discard unsent bytes of a serial port, because close() would wait for them."""
        try:
            if self.is_open and self._is_serial:
                termios.tcflush(self.descriptor, termios.TCOFLUSH)
        except termios.error:
            self.close()
        self.close()

    def _begin(self) -> None:
        """Take over the connection, because the daemon is gone."""
        self._is_begun = True
        self._acknowledger = self._acknowledgers.make()
        os.set_blocking(self.descriptor, False)
        if self._is_serial and self._unsent_bytes() > STALE_BYTES:  # old commands would take too long
            termios.tcflush(self.descriptor, termios.TCOFLUSH)

    def _write(self, writer: StopWriter, now_s: float) -> None:
        try:
            while waiting := writer.pop_due(now_s):
                writer.written(self._send(waiting) if self._is_udp else os.write(self.descriptor, waiting))
        except BlockingIOError:
            return  # poll() reports when there is room

    def _send(self, waiting: bytes) -> int:
        """Send one datagram. An error may belong to an earlier one, so try twice, then count it as lost."""
        datagram = waiting[:DATAGRAM_BYTES]
        for _ in range(2):
            try:
                return os.write(self.descriptor, datagram)
            except BlockingIOError:
                raise
            except OSError:
                continue
        return len(datagram)

    def _read(self) -> None:
        """Read received bytes, and answer what the device waits for.

        A device may block while its bytes are not read, and closing a TCP connection with unread bytes resets it.
        """
        try:
            received = os.read(self.descriptor, READ_BYTES)
        except OSError as error:
            if self._is_udp or isinstance(error, BlockingIOError):
                return  # an error may belong to an earlier datagram
            raise
        if self._acknowledger is not None:
            self._writer.answer(self._acknowledger.receive(received))
        self._is_readable = bool(received) or self._is_udp  # an empty datagram does not end it
        if self._is_serial and not self._is_readable:
            self.close()  # the serial device hung up

    def _finish(self) -> None:
        """Close after the last write: a serial port when all bytes are sent, a TCP connection when the peer closes."""
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
        """Number of unsent bytes of a serial port; 0 where the driver does not report it."""
        try:
            count = fcntl.ioctl(self.descriptor, termios.TIOCOUTQ, bytes(4))
        except OSError:
            return 0
        return int.from_bytes(count, sys.byteorder)


class _Acknowledger:
    """Interface of the class `Acknowledger` of a protocol."""

    def __init__(self, argument: str) -> None: ...

    def receive(self, data: bytes) -> list[bytes]:
        """Return the writes that answer these bytes."""
        raise NotImplementedError


class _AcknowledgerSource:
    """Class of a module, with its argument. Only devices that need one cost the import."""

    def __init__(self, place: str) -> None:
        module, _, self._argument = place.partition(":")
        self._class: type[_Acknowledger] | None = None
        if not place:
            return
        try:
            self._class = __import__(module, fromlist=["Acknowledger"]).Acknowledger
            self.make()
        except Exception:  # noqa: BLE001 - the files may have been replaced meanwhile; the zeros are written anyway
            self._class = None

    def make(self) -> _Acknowledger | None:
        """Create an acknowledger; None if the device waits for nothing."""
        return None if self._class is None else self._class(self._argument)


def _peeks(descriptor: int) -> bool:
    """Let the next looks at a socket begin with its first datagram. Return whether the system can."""
    connection = _socket.socket(fileno=descriptor)
    try:
        connection.setsockopt(_socket.SOL_SOCKET, _SO_PEEK_OFF, 0)
    except OSError:
        return False
    finally:
        connection.detach()
    return True


def _is_udp(descriptor: int) -> bool:
    try:
        connection = _socket.socket(fileno=descriptor)
    except OSError:
        return False
    kind = connection.type
    connection.detach()
    return kind == _socket.SOCK_DGRAM


def _end_sending(descriptor: int) -> None:
    """Shut down sending, so that the peer reads everything that was written and then the end."""
    connection = _socket.socket(fileno=descriptor)
    try:
        connection.shutdown(_socket.SHUT_WR)
    finally:
        connection.detach()
