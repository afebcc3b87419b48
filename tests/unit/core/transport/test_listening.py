"""Listening on every address of a host name."""

import errno
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from hostlink.core.runtime.listening import FREE_PORT_TRIES, bind_all, close_all, listen

EVERYWHERE = [(socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::", 0, 0, 0))]
BOTH = [
    (socket.AF_INET6, socket.SOCK_STREAM, 6, "", ("::1", 7, 0, 0)),
    (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", 7)),
]


class Bound(socket.socket):
    """Socket that is said to have an address."""

    def __init__(self, address: tuple[Any, ...]) -> None:
        super().__init__()
        self.address = address

    def getsockname(self) -> tuple[Any, ...]:
        return self.address


class Binding:
    """Computer whose free ports are 40000, 40001, ...; `refused` are addresses that it refuses, with the reason."""

    def __init__(self, refused: dict[tuple[str, int], int] | None = None) -> None:
        self.asked = list[tuple[str, int]]()
        self.made = list[Bound]()
        self._refused, self._port = refused or {}, 40_000

    def bind(self, family: int, _protocol: int, address: tuple[Any, ...]) -> socket.socket:
        host, port = address[:2]
        assert (":" in host) == (family == socket.AF_INET6)
        self.asked.append((host, port))
        if (host, port) in self._refused:
            raise OSError(self._refused[host, port], "refused")
        if not port:
            port, self._port = self._port, self._port + 1
        self.made.append(Bound((host, port, *address[2:])))
        return self.made[-1]


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_every_address_is_one_of_ip_version_4_and_6_with_one_port(stack: ExitStack) -> None:
    computer = Binding()
    stack.callback(lambda: close_all(computer.made))
    assert len(bind_all("::", 0, EVERYWHERE, computer.bind)) == 2
    assert computer.asked == [("::", 0), ("0.0.0.0", 40_000)]


def test_port_in_use_for_one_of_two_addresses_is_replaced_by_another_free_one(stack: ExitStack) -> None:
    computer = Binding({("0.0.0.0", 40_000): errno.EADDRINUSE})
    stack.callback(lambda: close_all(computer.made))
    bind_all("::", 0, EVERYWHERE, computer.bind)
    assert computer.asked == [("::", 0), ("0.0.0.0", 40_000), ("::", 0), ("0.0.0.0", 40_001)]
    assert computer.made[0].fileno() < 0


def test_no_free_port_for_both_is_an_error_after_some_tries(stack: ExitStack) -> None:
    computer = Binding({("0.0.0.0", 40_000 + number): errno.EADDRINUSE for number in range(FREE_PORT_TRIES)})
    stack.callback(lambda: close_all(computer.made))
    with pytest.raises(OSError, match="refused"):
        bind_all("::", 0, EVERYWHERE, computer.bind)
    assert len(computer.made) == FREE_PORT_TRIES


def test_given_port_is_tried_once_and_a_missing_address_is_left_out(stack: ExitStack) -> None:
    missing = Binding({("::1", 7): errno.EADDRNOTAVAIL})
    stack.callback(lambda: close_all(missing.made))
    assert len(bind_all("localhost", 7, BOTH, missing.bind)) == 1
    used = Binding({("127.0.0.1", 7): errno.EADDRINUSE})
    stack.callback(lambda: close_all(used.made))
    with pytest.raises(OSError, match="refused"):
        bind_all("localhost", 7, BOTH, used.bind)
    assert used.asked == [("::1", 7), ("127.0.0.1", 7)]
    with pytest.raises(OSError, match="nowhere has no address"):
        bind_all("nowhere", 7, [], used.bind)


def test_listener_on_every_address_takes_connections_of_ip_version_4() -> None:
    listening = listen("::", 0)
    try:
        port = listening[0].getsockname()[1]
        with socket.create_connection(("127.0.0.1", port), timeout=5.0):
            (accepting,) = (each for each in listening if each.family == socket.AF_INET)
            accepting.settimeout(5.0)
            connection, address = accepting.accept()
            connection.close()
            assert address[0] == "127.0.0.1"
    finally:
        close_all(listening)
