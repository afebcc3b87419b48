"""Guarded serial ports and TCP connections while the daemon hangs: a board that waits is answered."""

import fcntl
import os
import socket
import sys
import termios
import time
from collections.abc import Iterator

import pytest

from hostlink.core.guardian.connection import GuardedConnection
from hostlink.core.protocol.xrce.framing import LengthFraming, SerialFraming, device_frame
from hostlink.core.runtime.stop_frames import StopFrames
from tests.support.pty_pair import pty_pair

ACKNACK = "810000000a010500 %02x00 0000 80"
ACKNOWLEDGER = "hostlink.core.protocol.xrce.acknowledging:serial"


@pytest.fixture
def line() -> Iterator[tuple[int, int]]:
    """The device's end, and the daemon's descriptor."""
    with pty_pair() as (device, path):
        os.set_blocking(device, False)
        daemon = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        yield device, daemon
        os.close(daemon)


def arrived(descriptor: int, size: int) -> bool:
    """Wait until so many bytes can be read: a pseudo-terminal takes its time."""
    for _ in range(1000):
        waiting = fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4))
        if int.from_bytes(waiting, sys.byteorder) >= size:
            return True
        time.sleep(0.002)
    return False


def guarded(daemon: int, acknowledger: str) -> GuardedConnection:
    return GuardedConnection(os.dup(daemon), StopFrames((b"zero",), interval_s=0.12, acknowledger=acknowledger))


def test_board_of_a_hanging_daemon_is_acknowledged_and_the_zeros_follow(line: tuple[int, int]) -> None:
    device, daemon = line
    connection = guarded(daemon, ACKNOWLEDGER)
    for number in (7, 30):  # it hangs twice
        sent = b"end of a message that the daemon has begun to read" + device_frame(bytes((0x81, 0x80, number, 0)))
        os.write(device, sent)
        assert arrived(daemon, len(sent))
        connection.begin_hold()
        assert connection.hold(0.0) == 0.0  # at once again
        acknack = SerialFraming().encode(bytes.fromhex(ACKNACK % (number + 1)))
        wanted = b"zero" + acknack + b"zero"
        assert arrived(device, len(wanted))
        assert os.read(device, 1000) == wanted
        assert connection.hold(0.01) == 0.01
        with pytest.raises(BlockingIOError):
            os.read(device, 1000)
    connection.close()


def test_bytes_of_a_device_that_waits_for_nothing_are_left_for_the_daemon(line: tuple[int, int]) -> None:
    device, daemon = line
    connection = guarded(daemon, "")
    os.write(device, b"odometry")
    connection.begin_hold()
    for hundredth in range(40):
        connection.hold(hundredth / 100)
    assert arrived(device, 12)
    assert os.read(device, 1000) == b"zero" * 3
    assert arrived(daemon, 8)
    assert os.read(daemon, 1000) == b"odometry"
    connection.close()


def test_port_that_is_removed_while_the_daemon_hangs_is_left_to_the_daemon() -> None:
    with pty_pair() as (device, path):
        daemon = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        connection = guarded(daemon, ACKNOWLEDGER)
        connection.begin_hold()
        os.close(device)
        assert connection.hold(0.0) is None
        assert connection.is_open
        connection.close()
        os.close(daemon)


def test_board_of_a_hanging_daemon_over_tcp_is_answered_and_what_it_sends_is_kept_for_the_daemon() -> None:
    device, daemon = socket.socketpair()
    with device, daemon:
        device.setblocking(False)
        stop = StopFrames((b"zero",), interval_s=0.12, acknowledger=ACKNOWLEDGER.replace("serial", "tcp"))
        connection, sent = GuardedConnection(daemon.dup().detach(), stop), b""
        for begun in (0, 1):  # it hangs twice, and reads what waits between
            connection.begin_hold()
            for place, number in enumerate((7, 8)):
                message = LengthFraming().encode(bytes((0x81, 0x80, number + 10 * begun, 0)))
                device.send(message[:3])  # a part
                connection.hold(place / 100)
                device.send(message[3:])
                assert connection.hold(place / 100) == place / 100
                acknack = LengthFraming().encode(bytes.fromhex(ACKNACK % (number + 10 * begun + 1)))
                assert device.recv(1000) == b"zero" * (place == 0) + acknack + b"zero"
                sent += message
            assert daemon.recv(1000) == sent
            sent = b""
        connection.close()


def test_board_over_tcp_gets_no_answer_after_the_daemon_has_read_again() -> None:
    """The bytes that wait begin in the middle of a message then, and a wrong number could be acknowledged."""
    device, daemon = socket.socketpair()
    with device, daemon:
        device.setblocking(False)
        stop = StopFrames((b"zero",), interval_s=0.12, acknowledger=ACKNOWLEDGER.replace("serial", "tcp"))
        connection = GuardedConnection(daemon.dup().detach(), stop)
        connection.begin_hold()
        message = LengthFraming().encode(bytes((0x81, 0x80, 7, 0)))
        device.send(message)
        connection.hold(0.0)
        assert len(device.recv(1000)) > len(b"zero")
        assert daemon.recv(3) == message[:3]
        device.send(message[:1])
        connection.hold(0.01)
        device.send(message[1:] + LengthFraming().encode(bytes((0x81, 0x80, 8, 0))))
        connection.hold(0.02)
        with pytest.raises(BlockingIOError):
            device.recv(1000)
        connection.close()
