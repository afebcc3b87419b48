"""Waiting until a reader of events has read: what is not acknowledged, progress, and closed connections."""

import asyncio
import os
import pty
from collections.abc import Iterator
from typing import Any, cast

import pytest

from hostlink.components.gateway.events import CHECK_S, MOST_BYTES, unread_bytes, until_read
from tests.support.virtual_loop import run_virtual


class Terminal:
    """Descriptor whose kernel buffer is empty, in the place of a socket."""

    def __init__(self, number: int) -> None:
        self._number = number

    def fileno(self) -> int:
        return self._number


class SlowTransport:
    """Transport whose reader leaves `waiting` bytes, less with each look at them."""

    def __init__(self, terminal: Terminal, waiting: int, read_bytes: int = 0) -> None:
        self.waiting, self.is_closed = waiting, False
        self._read_bytes, self._terminal = read_bytes, terminal

    def is_closing(self) -> bool:
        return self.is_closed

    def get_extra_info(self, _: str) -> Terminal:
        return self._terminal

    def get_write_buffer_size(self) -> int:
        before = self.waiting
        self.waiting -= self._read_bytes
        return before


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    ours, theirs = pty.openpty()
    yield Terminal(ours)
    os.close(ours)
    os.close(theirs)


def lasted_s(transport: SlowTransport | None, timeout_s: float) -> float:
    """Return the time that `until_read` waited."""

    async def run() -> float:
        await until_read(cast(Any, transport), timeout_s)
        return asyncio.get_running_loop().time()

    return run_virtual(run())


def test_unread_bytes_are_those_of_the_process_and_the_kernel(terminal: Terminal) -> None:
    assert unread_bytes(cast(Any, SlowTransport(terminal, 700))) == 700


def test_reader_with_few_unread_bytes_is_not_waited_for(terminal: Terminal) -> None:
    assert lasted_s(SlowTransport(terminal, MOST_BYTES), 1.0) == 0.0


def test_slow_reader_that_reads_on_is_waited_for_longer_than_the_timeout(terminal: Terminal) -> None:
    transport = SlowTransport(terminal, MOST_BYTES + 500, read_bytes=1)
    assert lasted_s(transport, 5 * CHECK_S) == pytest.approx(500 * CHECK_S)


def test_reader_that_reads_nothing_times_out(terminal: Terminal) -> None:
    with pytest.raises(TimeoutError):
        lasted_s(SlowTransport(terminal, MOST_BYTES + 1), 1.0)


def test_closed_connection_is_not_waited_for(terminal: Terminal) -> None:
    transport = SlowTransport(terminal, MOST_BYTES + 1)
    transport.is_closed = True
    for closed in (transport, None):
        with pytest.raises(ConnectionResetError):
            lasted_s(closed, 1.0)
