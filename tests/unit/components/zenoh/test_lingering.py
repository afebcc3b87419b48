"""SO_LINGER of Zenoh's sockets is turned off, and no other socket is touched."""

import socket
import struct
from collections.abc import Iterator

import pytest

from hostlink.components.zenoh.lingering import ZENOHS, end_lingering, shut_down


@pytest.fixture
def opened() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as made:
        yield made


def linger(one: socket.socket) -> bytes:
    return one.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)


def test_socket_with_zenohs_value_is_closed_without_waiting_and_stays_open(opened: socket.socket) -> None:
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ZENOHS)
    assert end_lingering() == 1
    assert linger(opened)[:4] == bytes(4)
    assert opened.fileno() >= 0
    assert end_lingering() == 0


@pytest.mark.parametrize("value", [(1, 0), (1, 9), (0, 0)])
def test_socket_with_another_value_is_not_touched(opened: socket.socket, value: tuple[int, int]) -> None:
    packed = struct.pack("ii", *value)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, packed)
    assert end_lingering() == 0
    assert linger(opened) == packed


def test_socket_that_zenoh_connects_after_it_was_seen_is_closed_without_waiting(opened: socket.socket) -> None:
    """A connection to a host that is cut off is made seconds after its socket, and has SO_LINGER only then."""
    assert end_lingering() == 0
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ZENOHS)
    assert end_lingering() == 1
    assert linger(opened)[:4] == bytes(4)


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_only_the_connection_between_two_ends_is_shut_down(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, 0), family=family)
    except OSError:
        pytest.skip("no IPv6 here")
    where = (host, listener.getsockname()[1])
    with (
        listener,
        socket.create_connection(where) as one,
        listener.accept()[0] as other,
        socket.create_connection(where) as third,
        listener.accept()[0] as fourth,
    ):
        shown = f"[{host}]" if ":" in host else host
        ends = [f"tcp/{shown}:{each.getsockname()[1]}" for each in (one, other)]
        assert shut_down({(ends[0], ends[1])}) == 1
        assert other.recv(1) == b""
        third.sendall(b"x")
        assert fourth.recv(1) == b"x"
