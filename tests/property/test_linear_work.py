"""Cost of any bytes from a peer: time in proportion to their number."""

import time

import pytest

from hostlink.core.protocol.rosserial.frame import Frame
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.growth import is_linear
from tests.support.session_host import ODOMETRY, Host, wire

LIAR = b"\xff\xfe\xe8\xfd\x1a"  # claims 65000 bytes
SMALL_LIAR = b"\xff\xfe\x00\x04\xfb\x7d\x00"  # 1024


@pytest.mark.slow
@pytest.mark.parametrize("read_bytes", [1, 65536])
@pytest.mark.parametrize(
    ("unit", "limit_bytes"), [(b"\xff\xfe", 1024), (SMALL_LIAR, 1024), (SMALL_LIAR, 65535), (LIAR, 65535)]
)
def test_work_is_linear_in_bytes_made_of_headers(unit: bytes, limit_bytes: int, read_bytes: int) -> None:
    """Crafted bytes cost time in proportion, and none of the memory that their headers claim."""

    def seconds(size: int) -> float:
        stream = FrameStream(limit_bytes=limit_bytes)
        wire = (unit * size)[:size]
        began = time.process_time()
        for at in range(0, len(wire), read_bytes):
            for _ in stream.feed(wire[at : at + read_bytes]):
                pass
        return time.process_time() - began

    assert is_linear(seconds, 8000)


def test_giving_up_nested_headers_is_linear() -> None:
    def seconds(count: int) -> float:
        stream = FrameStream(limit_bytes=65535)
        assert not any(isinstance(event, Frame) for event in stream.feed(LIAR * count))
        began = time.process_time()
        while stream.pending:
            assert [event for event in stream.give_up() if isinstance(event, Frame)] == []
        return time.process_time() - began

    assert is_linear(seconds, 2000)


def test_device_with_ten_thousand_topics_costs_time_in_proportion() -> None:
    def seconds(count: int) -> float:
        line = wire(*(ODOMETRY._replace(id=100 + number) for number in range(count)))
        host = Host()
        began = time.process_time()
        host.receive(line)
        return time.process_time() - began

    assert is_linear(seconds, 2000)
