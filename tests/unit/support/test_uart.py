"""A simulated serial line: its pace, the receive ring, and a reader at another rate."""

import pytest

from hostlink.core.protocol.resampling import resample
from tests.support.uart import Uart


@pytest.mark.parametrize("baud", [115200, 921600])
def test_bytes_arrive_one_by_one_at_the_pace_of_the_line(baud: int) -> None:
    line = Uart(baud=baud)
    line.send(b"abcd", 1.0)
    assert line.free_at_s == pytest.approx(1.0 + 40 / baud)
    assert line.pop(1.0 + 25 / baud) == b"ab"
    assert line.pop(1.0 + 41 / baud) == b"cd"


def test_ring_keeps_the_oldest_bytes_of_those_that_arrive_while_no_program_reads() -> None:
    line = Uart(baud=115200, ring_bytes=64)
    line.send(bytes(range(100)), 0.0)
    line.settle(0.1)
    assert line.lost_bytes == 36
    assert line.pop(0.1) == bytes(range(64))


def test_program_that_waits_for_bytes_loses_none() -> None:
    line = Uart(baud=115200, ring_bytes=64)
    line.send(bytes(range(100)), 0.0)
    line.settle(0.001)
    taken = []
    while (byte := line.take(0.1)) is not None:
        taken.append(byte)
    assert taken == list(range(100))
    assert not line.lost_bytes


@pytest.mark.parametrize(("sent", "read"), [(115200, 57600), (57600, 115200), (921600, 115200)])
def test_reader_at_another_rate_samples_the_bits_in_the_same_time(sent: int, read: int) -> None:
    data = b"hostlink" * 8
    line = Uart(baud=sent)
    line.read_baud = read
    line.send(data, 0.0)
    wanted = resample(data, ratio=read / sent)
    assert wanted != data
    assert len(line.pop(len(data) * 5 / sent)) == pytest.approx(len(wanted) / 2, abs=1)
    assert line.free_at_s == pytest.approx(len(data) * 10 / sent)
