"""Stall detection of a stopped network, but not of a slow or idle one."""

import asyncio
import math

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.transport.tcp import CHECK_S, STALL_S, Stall, StallChecks, TcpTransport
from tests.support.virtual_loop import virtual


def test_idle_connection_does_not_stall() -> None:
    stall = Stall()
    assert not stall.is_stalled(sent_bytes=0, unacknowledged_bytes=0, now_s=5.0)
    assert not stall.is_stalled(sent_bytes=56, unacknowledged_bytes=0, now_s=1000.0)
    assert not stall.is_stalled(sent_bytes=112, unacknowledged_bytes=0, now_s=2000.0)


def test_first_byte_after_a_silence_does_not_stall() -> None:
    stall = Stall()
    assert not stall.is_stalled(sent_bytes=56, unacknowledged_bytes=56, now_s=1000.0)
    assert not stall.is_stalled(sent_bytes=56, unacknowledged_bytes=0, now_s=1000.1)
    assert not stall.is_stalled(sent_bytes=112, unacknowledged_bytes=56, now_s=2000.0)
    assert stall.is_stalled(sent_bytes=112, unacknowledged_bytes=56, now_s=2000.0 + STALL_S)


def test_unacknowledged_bytes_stall_until_progress() -> None:
    stall = Stall()
    assert not stall.is_stalled(sent_bytes=56, unacknowledged_bytes=0, now_s=9.9)
    assert not stall.is_stalled(sent_bytes=112, unacknowledged_bytes=56, now_s=10.0)
    assert not stall.is_stalled(sent_bytes=168, unacknowledged_bytes=112, now_s=10.2)
    assert stall.is_stalled(sent_bytes=168, unacknowledged_bytes=112, now_s=10.0 + STALL_S)
    assert not stall.is_stalled(sent_bytes=168, unacknowledged_bytes=56, now_s=11.0)
    assert not stall.is_stalled(sent_bytes=168, unacknowledged_bytes=0, now_s=20.0)


@given(st.lists(st.tuples(st.floats(0.001, STALL_S - 0.01), st.integers(0, 500)), max_size=50))
def test_peer_that_acknowledges_in_time_never_stalls(steps: list[tuple[float, int]]) -> None:
    stall, now_s, sent = Stall(), 100.0, 0
    stall.is_stalled(sent_bytes=0, unacknowledged_bytes=0, now_s=now_s)
    for pause_s, size in steps:
        now_s += pause_s
        sent += size + 1
        assert not stall.is_stalled(sent_bytes=sent, unacknowledged_bytes=size, now_s=now_s)


class Peer(asyncio.Transport):
    """A transport whose peer acknowledges everything, or nothing."""

    def write(self, data: object) -> None:
        """Accept any bytes."""

    def is_closing(self) -> bool:
        return False

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        """Accept any limits."""


class Connection(TcpTransport):
    """A connection whose unacknowledged bytes are told by the test."""

    __slots__ = ("acknowledged_bytes", "looks")

    def __init__(self, checks: StallChecks) -> None:
        super().__init__(lambda _: None, checks)
        self.transport = Peer()
        self.looks, self.acknowledged_bytes = list[float](), math.inf

    def _unacknowledged(self) -> int:
        self.looks.append(asyncio.get_running_loop().time())
        return int(max(0, self._sent_bytes - self.acknowledged_bytes))


@virtual
async def test_kernel_is_asked_once_in_an_interval_for_all_connections_that_were_written_to() -> None:
    checks = StallChecks()
    written, silent = [Connection(checks) for _ in range(3)], Connection(checks)
    for _ in range(10):
        assert all(connection.write(b"velocity") for connection in written)
        await asyncio.sleep(CHECK_S / 20)
    await asyncio.sleep(10 * CHECK_S)
    assert [connection.looks for connection in written] == [[CHECK_S]] * 3
    assert not silent.looks


@virtual
async def test_stall_is_noticed_by_the_first_write_after_its_time() -> None:
    connection = Connection(StallChecks())
    connection.acknowledged_bytes = 0
    taken = []
    for number in range(9):
        taken.append((number, connection.write(b"velocity")))
        await asyncio.sleep(0.1)
    assert [number for number, is_taken in taken if not is_taken] == [5, 6, 7, 8]  # from STALL_S + CHECK_S on
    connection.acknowledged_bytes = math.inf
    assert connection.write(b"velocity")
    looks = len(connection.looks)
    assert connection.write(b"velocity")  # all is acknowledged: the next look is that of the interval
    assert len(connection.looks) == looks


@virtual
async def test_progress_between_two_looks_ends_no_connection() -> None:
    connection = Connection(StallChecks())
    for number in range(20):
        connection.acknowledged_bytes = number * len(b"velocity")  # all but the newest write
        assert connection.write(b"velocity")
        await asyncio.sleep(0.1)
