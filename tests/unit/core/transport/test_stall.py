"""Stall detection of a stopped network, but not of a slow or idle one."""

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.transport.tcp import STALL_S, Stall


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
