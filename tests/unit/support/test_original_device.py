"""The simulated device keeps every fault of the original client library: bytes and times to frames and drops."""

import pytest

from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import decode_parameter_request, encode_parameter, encode_time
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.support.original_device import RETRY_S, DeviceCrashed, OriginalDevice
from tests.support.uart import RING_BYTES, Uart

BYTE_S = 10 / 38400
LED = encode(100, b"\x01")


def device(*, baud: int | None = 38400, retries: bool = True) -> tuple[OriginalDevice, list[bytes]]:
    heard: list[bytes] = []
    made = OriginalDevice(baud=baud, retries=retries)
    made.advertise("/odometry", "geometry_msgs/Pose2D", "m")
    made.subscribe("/led", "std_msgs/Bool", "m", heard.append)
    return made, heard


def spin(made: OriginalDevice, now_s: float) -> float:
    """A whole turn, retry waits included; returns when it ended."""
    while (wait_s := made.spin(now_s)) is not None:
        now_s += wait_s
    return now_s


def sent(made: OriginalDevice, now_s: float) -> list[Frame]:
    return [item for item in FrameStream().feed(made.to_host.pop(now_s)) if isinstance(item, Frame)]


def test_topic_request_is_answered_with_a_time_request_and_the_topics_in_order() -> None:
    made, _ = device()
    made.from_host.send(TOPICS_REQUEST, 0.0)
    spin(made, 0.1)
    assert [frame.topic_id for frame in sent(made, 1.0)] == [Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER]
    assert made.is_configured


def test_device_publishes_nothing_before_it_is_configured() -> None:
    made, _ = device()
    assert made.publish(125, bytes(24), 0.0) is False
    assert sent(made, 1.0) == []


def test_a_frame_reaches_its_callback() -> None:
    made, heard = device()
    made.from_host.send(LED, 0.0)
    spin(made, 0.1)
    assert heard == [b"\x01"]


@pytest.mark.parametrize(
    ("gap_s", "retries", "arrives"),
    [(0.005, True, True), (0.009, True, True), (0.015, True, False), (0.005, False, False), (0.0, False, True)],
)
def test_the_retry_clause_bridges_ten_milliseconds_within_a_frame(gap_s: float, retries: bool, arrives: bool) -> None:
    """The second half arrives `gap_s` after the first was read; the loop continues only after the 20 ms of a frame."""
    made, heard = device(baud=None, retries=retries)
    made.from_host.send(LED[:4], 0.0)
    now_s, second_sent = 0.0, False
    for turn in range(3):
        now_s = max(now_s, turn * 0.033)
        while True:
            if not second_sent and now_s >= gap_s:
                made.from_host.send(LED[4:], now_s)
                second_sent = True
            wait_s = made.spin(now_s)
            if wait_s is None:
                break
            now_s += wait_s
    assert (heard == [b"\x01"]) is arrives
    assert made.dropped_frames == (0 if arrives else 1)


def test_the_retry_waits_once_for_each_gap() -> None:
    made, _ = device(baud=None)
    made.from_host.send(LED[:4], 0.0)
    assert made.spin(0.0) == RETRY_S
    assert made.spin(RETRY_S) is None


@pytest.mark.parametrize(("away_s", "lost"), [(0.0330, 0), (0.0331, 1), (0.040, 27)])
def test_the_ring_overflows_where_arithmetic_predicts(away_s: float, lost: int) -> None:
    """127 bytes at 3840 a second are 33.07 ms."""
    uart = Uart(baud=38400)
    uart.send(bytes(400), 0.0)
    uart.settle(away_s + BYTE_S)
    arrived = int((away_s + BYTE_S) / BYTE_S + 1e-9)
    assert uart.lost_bytes == max(0, arrived - RING_BYTES)
    assert abs(uart.lost_bytes - lost) <= 1


def test_eleven_seconds_without_a_time_answer_silence_it() -> None:
    made, _ = device(baud=None)
    made.from_host.send(TOPICS_REQUEST, 0.0)
    spin(made, 0.0)
    requested_at = [at_s for at_s in range(1, 30) if spin_and_count_times(made, float(at_s))]
    assert requested_at == [1, 3, 6, 9]  # the first is of the answer to the request for topics
    assert not made.is_configured


def spin_and_count_times(made: OriginalDevice, now_s: float) -> int:
    spin(made, now_s)
    return sum(frame.topic_id == Id.TIME for frame in sent(made, now_s))


def test_device_with_time_answers_continues_and_knows_the_time() -> None:
    made, _ = device(baud=None)
    made.from_host.send(TOPICS_REQUEST, 0.0)
    for tenth in range(300):
        now_s = tenth / 10
        spin(made, now_s)
        if any(frame.topic_id == Id.TIME for frame in sent(made, now_s)):
            made.from_host.send(encode(Id.TIME, encode_time(int((1000 + now_s) * 1e9))), now_s)
    assert made.is_configured
    assert made.wall_ns(30.0) / 1e9 == pytest.approx(1030.0, abs=0.2)  # the round trip is added whole


def test_stop_silences_it() -> None:
    made, _ = device()
    made.from_host.send(TOPICS_REQUEST + STOP_REQUEST, 0.0)
    spin(made, 0.1)
    spin(made, 0.2)
    assert not made.is_configured


def test_a_wrong_version_byte_makes_an_unconfigured_device_show_its_own() -> None:
    made, _ = device()
    made.from_host.send(b"\xff\x00", 0.0)
    spin(made, 0.1)
    assert [frame.topic_id for frame in sent(made, 1.0)] == [Id.TIME]


@pytest.mark.parametrize("frame", [encode(130, b""), encode(50, b""), encode(100, bytes(600))])
def test_a_frame_that_would_write_outside_its_memory_crashes_it(frame: bytes) -> None:
    made, _ = device(baud=None)
    made.from_host.send(frame, 0.0)
    with pytest.raises(DeviceCrashed):
        spin(made, 0.0)


@pytest.mark.parametrize("place", [4, 8])
def test_a_wrong_checksum_costs_the_frame(place: int) -> None:
    made, heard = device(baud=None)
    broken = bytearray(LED)
    broken[place] ^= 1
    made.from_host.send(bytes(broken) + LED, 0.0)
    spin(made, 0.0)
    assert heard == [b"\x01"]


def test_a_message_over_its_buffer_is_not_sent() -> None:
    made, _ = device()
    made.from_host.send(TOPICS_REQUEST, 0.0)
    spin(made, 0.1)
    assert made.publish(125, bytes(504), 0.1)
    assert not made.publish(125, bytes(505), 0.1)


def test_parameters() -> None:
    made, _ = device(baud=None)
    answers: list[Parameter] = []
    made.request_parameter("/gain", answers.append, 0.0)
    assert decode_parameter_request(sent(made, 0.0)[0].payload) == "/gain"
    made.from_host.send(encode(Id.PARAMETER, encode_parameter(Parameter(floats=(0.5,)))) * 2, 0.0)
    spin(made, 0.0)
    assert answers == [Parameter(floats=(0.5,))]


def test_a_reboot_forgets_the_host() -> None:
    made, heard = device()
    made.from_host.send(TOPICS_REQUEST + LED[:5], 0.0)
    spin(made, 0.1)
    made.reboot()
    made.from_host.send(LED, 0.2)
    spin(made, 0.3)
    assert not made.is_configured
    assert heard == [b"\x01"]
