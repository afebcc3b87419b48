"""The guardian's duplicate of a UDP socket: neither an error nor an empty datagram ends it."""

import select
import socket
import struct
from collections.abc import Iterator

import pytest

from hostlink.core.guardian.connection import ANSWERING_S, DATAGRAM_BYTES, GuardedConnection
from hostlink.core.guardian.frames import ZEROS
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, encode
from hostlink.core.runtime.stop_frames import INTERVAL_S, StopFrames
from tests.support.rosserial_stop import rosserial_stop

END_S = ZEROS * INTERVAL_S
ZERO = encode(100, bytes(48))


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    """Return the daemon's socket and the device's."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device,
    ):
        ours.bind(("127.0.0.1", 0))
        device.bind(("127.0.0.1", 0))
        ours.connect(device.getsockname())
        device.connect(ours.getsockname())
        device.setblocking(False)
        yield ours, device


def received(device: socket.socket) -> list[bytes]:
    came = []
    try:
        while True:
            came.append(device.recv(65536))
    except (BlockingIOError, ConnectionRefusedError):
        return came


def play(connection: GuardedConnection, events: int = select.POLLOUT) -> None:
    for tenth in range(int(END_S * 100) + 2):
        if connection.is_open:
            connection.step(events, tenth / 100)


def guarded(ours: socket.socket, claim_bytes: int = 100, zeros: tuple[bytes, ...] = (ZERO,)) -> GuardedConnection:
    return GuardedConnection(ours.dup().detach(), rosserial_stop(zeros, claim_bytes))


def test_zeros_and_stop_request_are_datagrams_of_whole_frames(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    ours, device = pair
    connection = guarded(ours)
    play(connection)
    assert received(device) == [ZERO] * ZEROS + [STOP_REQUEST]
    assert not connection.is_open


@pytest.mark.parametrize("is_end", [True, False])
def test_frames_of_many_endpoints_are_whole_in_as_few_datagrams_as_possible(
    pair: tuple[socket.socket, socket.socket], *, is_end: bool
) -> None:
    ours, device = pair
    zeros = tuple(encode(100 + number, bytes(92)) for number in range(16))
    connection = guarded(ours, DATAGRAM_BYTES, zeros)
    if is_end:
        play(connection)
    else:
        connection.begin_hold()
        for turn in range(ZEROS):
            connection.hold(turn * INTERVAL_S)
        connection.close()
    both = [b"\0".join(zeros[:10]), b"\0".join(zeros[10:])]
    assert received(device) == both * ZEROS + [STOP_REQUEST] * is_end


def test_frames_of_a_protocol_that_keeps_datagrams_are_one_each(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, device = pair
    play(GuardedConnection(ours.dup().detach(), StopFrames((ZERO, b"other"), b"end")))
    assert received(device) == [ZERO, b"other"] * ZEROS + [b"end"]


def watched_board(
    ours: socket.socket, place: str = "hostlink.core.protocol.xrce.acknowledging:udp"
) -> GuardedConnection:
    return GuardedConnection(ours.dup().detach(), StopFrames((b"zero",), interval_s=0.12, acknowledger=place))


def test_message_that_a_board_sends_reliably_is_acknowledged_and_the_zeros_follow(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    ours, device = pair
    device.send(b"\x81\x80\x07\x00")  # unread by the daemon
    connection = watched_board(ours)
    connection.step(0, 0.0)
    assert received(device) == [b"zero"]
    connection.step(select.POLLIN, 0.001)
    acknack = bytes.fromhex("810000000a010500 0800 0000 80")
    assert received(device) == [acknack, b"zero"]
    connection.step(select.POLLOUT, 0.12)
    connection.step(select.POLLOUT, 0.24)
    assert received(device) == [b"zero"] * 2
    assert connection.is_open  # for what it sends until ANSWERING_S
    device.send(b"\x81\x80\x08\x00")
    connection.step(select.POLLIN, 0.3)
    assert received(device) == [acknack.replace(b"\x08", b"\x09"), b"zero"]
    connection.step(select.POLLOUT, ANSWERING_S)
    assert not connection.is_open


@pytest.mark.parametrize("place", ["no.such.module:x", "hostlink.core.protocol.xrce.session:x"])
def test_board_is_stopped_also_if_what_acknowledges_cannot_be_imported(
    pair: tuple[socket.socket, socket.socket], place: str
) -> None:
    ours, device = pair
    connection = watched_board(ours, place)
    device.send(b"\x81\x80\x07\x00")
    play(connection, select.POLLIN | select.POLLOUT)
    assert received(device)[:1] == [b"zero"]


def test_board_of_a_hanging_daemon_is_answered_and_what_it_sends_is_kept_for_the_daemon(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    ours, device = pair
    connection = watched_board(ours)
    for number in (7, 8):
        device.send(bytes((0x81, 0x80, number, 0)))
    for turn in range(2):  # it hangs twice
        connection.begin_hold()
        assert connection.hold(0.0) == 0.0  # at once again
        for hundredth in range(1, 30):
            connection.hold(hundredth / 100)
            if hundredth == 3:
                device.send(bytes((0x81, 0x80, 0x30 + turn, 0)))
        acknowledged = [each[8] for each in received(device) if each[:5] == b"\x81\0\0\0\x0a"]
        assert acknowledged == [8, 9, *range(0x31, 0x32 + turn)]
    ours.setblocking(False)
    assert [each[2] for each in received(ours)] == [7, 8, 0x30, 0x31]
    connection.close()


def test_zeros_of_a_hanging_daemon_follow_each_other_where_a_board_sends_nothing(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    ours, device = pair
    connection = watched_board(ours)
    connection.begin_hold()
    for hundredth in range(40):
        connection.hold(hundredth / 100)
    assert received(device) == [b"zero"] * 3
    connection.close()


def test_zeros_cover_the_length_of_frames_in_several_datagrams(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    ours, device = pair
    claim_bytes = 3 * DATAGRAM_BYTES
    play(guarded(ours, claim_bytes))
    came = received(device)
    assert max(map(len, came)) <= DATAGRAM_BYTES
    assert len(b"".join(came)) > claim_bytes
    assert b"".join(came).endswith(ZERO + STOP_REQUEST)


def test_icmp_error_does_not_end_the_connection(pair: tuple[socket.socket, socket.socket]) -> None:
    """The device's system answers the first datagram with port unreachable; then the device is back."""
    ours, device = pair
    address = device.getsockname()
    device.close()
    connection = guarded(ours)
    connection.step(select.POLLOUT, 0.0)
    connection.step(select.POLLERR, 0.01)
    assert connection.is_open
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as back:
        back.bind(address)
        back.setblocking(False)
        for tenth in range(2, 20):
            if connection.is_open:
                connection.step(select.POLLOUT | select.POLLERR, tenth / 100)
        assert received(back) == [ZERO] * (ZEROS - 1) + [STOP_REQUEST]


def test_unreachable_device_ends_the_connection_in_time(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, device = pair
    device.close()
    connection = guarded(ours)
    play(connection, select.POLLOUT | select.POLLERR)
    assert not connection.is_open


def test_received_datagrams_are_discarded_even_when_empty(pair: tuple[socket.socket, socket.socket]) -> None:
    ours, device = pair
    connection = guarded(ours)
    for data in (b"", struct.pack("<3d", 1, 2, 3)):
        device.send(data)
        connection.step(select.POLLIN | select.POLLOUT, 0.0)
        assert connection.is_open
    play(connection)
    assert received(device)[-1] == STOP_REQUEST
