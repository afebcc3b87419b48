"""Session of rosserial at the border: what the daemon asks of it without knowing its protocol."""

import pytest

from hostlink.core.protocol.rosserial.frame import OVERHEAD_BYTES, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.stream import DEFAULT_LIMIT_BYTES
from tests.support.session_host import LED, ODOMETRY, TIME, Host, wire


def test_size_of_a_fixed_type_is_known_by_the_key_of_its_endpoint() -> None:
    assert dict(Host(LED, ODOMETRY).session.fixed_bytes) == {LED.key: 1, ODOMETRY.key: 24}


def test_device_that_requests_the_time_at_the_usual_period_is_regular() -> None:
    host = Host(ODOMETRY)
    assert not Host().session.is_regular
    for _ in range(5):
        host.receive(TIME, after_s=2.5)
    assert host.session.is_regular


@pytest.mark.parametrize(
    ("pieces", "before"),
    [
        ([TIME], 0),
        ([b"\x01\x02\x03", TIME], 3),
        ([b"\x01\x02", b"\x03" + TIME, TIME], 3),
        ([b"\x01" * 10], 0),
        ([b"\x01" * (DEFAULT_LIMIT_BYTES + 1), TIME], 0),
    ],
)
def test_rest_of_a_cut_frame_ends_at_the_first_whole_one(pieces: list[bytes], before: int) -> None:
    assert Host().session.rest_of_frame_bytes(pieces) == before


def test_announcement_of_endpoints_is_read_by_another_session() -> None:
    data = Host(LED, ODOMETRY).session.announcement([LED, ODOMETRY])
    assert data == wire(LED, ODOMETRY)


def test_payload_beyond_a_buffer_is_named_with_the_sizes_of_whole_frames() -> None:
    session = Host(LED).session
    assert session.room_bytes(LED) == LED.buffer_bytes - OVERHEAD_BYTES
    text = str(session.too_long(LED, 100))
    assert str(100 + OVERHEAD_BYTES) in text
    assert str(LED.buffer_bytes) in text


def test_zero_is_one_frame_of_the_endpoint() -> None:
    assert Host(LED).session.zero_frames(LED, b"\0") == (encode(LED.id, b"\0"),)


def test_datagram_with_a_whole_frame_is_a_greeting() -> None:
    assert ROSSERIAL.is_greeting(TIME)
    assert not ROSSERIAL.is_greeting(TIME[:-1])
