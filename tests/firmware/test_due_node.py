"""The node compared with the simulated device byte for byte, under any bytes, and with its own better policy."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.rosserial.control import Log, encode_parameter
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from tests.firmware.due import Node, Retry, node
from tests.support.device_codec import encode_log, encode_parameter_request
from tests.support.original_device import OriginalDevice
from tests.support.strategies import damaged, noise, split
from tests.support.uart import Uart

VELOCITY, LED = encode(100, b"\x22" * 48), encode(101, b"\x01")
TIME = encode(Id.TIME, bytes(8))
LOOP_S = 1 / 30
POLICIES = list(Retry)
# Bytes that a host may send without crashing the original: announced ids, sizes that fit.
good = st.sampled_from([TOPICS_REQUEST, VELOCITY, LED, TIME, STOP_REQUEST])
short_noise = noise.map(lambda junk: junk.replace(b"\xff\xfe", b"\xff\xfd"))  # without a sync
lines = st.lists(st.one_of(good, short_noise), max_size=8).map(b"".join)


def frames(data: bytes) -> list[Frame]:
    return [item for item in FrameStream().feed(data) if isinstance(item, Frame)]


def spin(device: Node | OriginalDevice, now_s: float) -> float:
    while (wait_s := device.spin(now_s)) is not None:
        now_s += wait_s
    return now_s


@pytest.mark.parametrize("retries", [True, False])
@given(story=st.lists(st.tuples(lines, st.floats(0.0, 0.05)), max_size=10), data=st.data())
def test_the_same_bytes_at_the_same_times_give_the_same_frames(
    retries: bool, story: list[tuple[bytes, float]], data: st.DataObject
) -> None:
    """The simulated device and the compiled one, with the retry clause of the paper and without."""
    heard: list[bytes] = []
    twin = OriginalDevice(baud=None, retries=retries)
    twin.advertise("/odometry", "geometry_msgs/Pose2D", "m")
    twin.subscribe("/velocity", "geometry_msgs/Twist", "m", heard.append)
    twin.subscribe("/led", "std_msgs/Bool", "m", heard.append)
    with node(Retry.PAPER if retries else Retry.NONE) as device:
        now_s = 1.0
        for line, pause_s in story:
            for piece in split(line, data):
                device.feed(piece)
                twin.from_host.send(piece, now_s)
                ended_s = spin(device, now_s)
                assert spin(twin, now_s) == pytest.approx(ended_s)
                assert device.received() == heard
                heard.clear()
                assert device.sent() == twin.to_host.pop(now_s + 1.0)
                assert device.is_configured == twin.is_configured
                now_s = ended_s + round(pause_s, 3)


@pytest.mark.parametrize("retry", POLICIES)
@given(story=st.lists(st.tuples(lines | noise, st.floats(0.0, 0.3)), max_size=10), data=st.data())
def test_any_bytes_at_any_time_and_it_finds_the_next_good_frame(
    retry: Retry, story: list[tuple[bytes, float]], data: st.DataObject
) -> None:
    with node(retry) as device:
        now_s = 1.0
        for line, pause_s in story:
            device.feed(damaged(line, data))
            now_s = spin(device, now_s) + pause_s
        for _ in range(10):
            now_s = spin(device, now_s + 0.3)
        device.received()
        device.feed(LED)
        spin(device, now_s + 0.3)
        assert device.received()[-1:] == [b"\x01"]


@given(pieces=st.lists(st.integers(1, 20), min_size=1), pause_s=st.floats(0.0, 0.04), junk=st.binary(max_size=10))
def test_the_default_keeps_a_frame_through_any_gap_up_to_a_quarter_of_a_second(
    pieces: list[int], pause_s: float, junk: bytes
) -> None:
    wire = junk.replace(b"\xff", b"") + VELOCITY
    with node() as device:
        now_s, at = 1.0, 0
        for size in [*pieces, len(wire)]:
            if (now_s - 1.0) > 0.2:
                size = len(wire)  # noqa: PLW2901 - the rest, before the deadline
            device.feed(wire[at : at + size])
            at += size
            assert device.spin(now_s) is None, "it never waits"
            now_s += pause_s
        assert device.received() == [b"\x22" * 48]


def test_the_default_does_not_lose_a_frame_to_what_stands_before_it() -> None:
    for junk in (
        b"\xff",
        b"\xff\xff",
        b"\xff\xfe",
        LED[:5],
        LED[:-1],
        b"\xff\xfe\x00\x01\xfe",
        b"\xff\xfe\x30\x00\xcfxx",
    ):
        with node() as device:
            device.feed(junk + LED + LED)
            spin(device, 1.0)
            spin(device, 1.5)
            assert device.received()[-1:] == [b"\x01"], junk


def test_topics_time_log_parameters_and_stop() -> None:
    with node() as device:
        device.feed(TOPICS_REQUEST)
        spin(device, 1.0)
        assert [frame.topic_id for frame in frames(device.sent())] == [Id.TIME, 0, 1, 1]
        assert device.publish(bytes(24))
        device.log(2, "warm")
        device.request_parameter("/gain")
        spin(device, 1.1)
        assert frames(device.sent()) == [
            Frame(125, bytes(24)),
            Frame(Id.LOG, encode_log(Log(2, "warm"))),
            Frame(Id.PARAMETER, encode_parameter_request("/gain")),
        ]
        device.feed(encode(Id.PARAMETER, encode_parameter(Parameter(floats=(0.5, 1.5)))))
        spin(device, 1.2)
        assert device.parameter() == [0.5, 1.5]
        device.feed(STOP_REQUEST)
        spin(device, 1.3)
        assert not device.is_configured
        assert not device.publish(bytes(24))


@pytest.mark.parametrize(
    ("parameter", "values"),
    [(Parameter(ints=(7, -2)), [7.0, -2.0]), (Parameter(), []), (Parameter(strings=("x",)), [])],
)
def test_parameters_of_every_kind(parameter: Parameter, values: list[float]) -> None:
    with node() as device:
        device.request_parameter("/p")
        device.feed(encode(Id.PARAMETER, encode_parameter(parameter)))
        spin(device, 1.0)
        assert device.parameter() == values


@pytest.mark.parametrize("payload", [b"", b"\x01", b"\xff\xff\xff\xff", b"\x02\x00\x00\x00\x01\x00\x00\x00"])
def test_a_parameter_with_a_length_that_lies(payload: bytes) -> None:
    with node() as device:
        device.request_parameter("/p")
        device.feed(encode(Id.PARAMETER, payload))
        spin(device, 1.0)
        assert device.parameter() == []


@pytest.mark.parametrize("retry", POLICIES)
@pytest.mark.parametrize("frame", [encode(99, b""), encode(102, b""), encode(65535, b"x"), encode(100, b"short")])
def test_ids_and_sizes_that_no_topic_has_are_refused(frame: bytes, retry: Retry) -> None:
    with node(retry) as device:
        device.feed(frame + LED)
        spin(device, 1.0)
        assert device.received() == [b"\x01"]
        assert device.refused + device.dropped_from_host > 0


def test_eleven_seconds_without_time_silence_it_also_when_the_clock_wraps() -> None:
    for start_s in (1.0, 2**32 / 1000 - 5.0):
        with node() as device:
            device.feed(TOPICS_REQUEST)
            spin(device, start_s)
            spin(device, start_s + 10.9)
            assert device.is_configured
            spin(device, start_s + 11.2)
            assert not device.is_configured


QUEUE_FRAMES = 2048 // 32  # of Pose2Ds


def pose(number: int) -> bytes:
    return number.to_bytes(4, "little") + bytes(20)


def numbers(received: list[Frame]) -> list[int]:
    return [int.from_bytes(frame.payload[:4], "little") for frame in received if frame.topic_id == 125]


@contextmanager
def blocked() -> Iterator[Node]:
    """A device with announced topics, on a line that takes no more bytes."""
    with node() as device:
        device.feed(TOPICS_REQUEST)
        spin(device, 1.0)
        device.sent()
        device.room(0)
        yield device


def test_a_full_line_to_the_host_keeps_the_newest_messages_and_counts_the_oldest() -> None:
    with blocked() as device:
        assert all(device.publish(pose(number)) for number in range(100))
        assert device.dropped_to_host == 100 - QUEUE_FRAMES
        device.room(2**32)
        spin(device, 1.1)
        assert numbers(frames(device.sent())) == list(range(100 - QUEUE_FRAMES, 100))


@pytest.mark.parametrize("begun_bytes", [1, 5, 31, 32, 33, 70])
def test_a_frame_that_is_on_the_wire_already_is_sent_to_its_end(begun_bytes: int) -> None:
    with blocked() as device:
        for number in range(10):
            device.publish(pose(number))
        device.room(begun_bytes)
        spin(device, 1.1)
        for number in range(10, 100):
            device.publish(pose(number))
        device.room(2**32)
        spin(device, 1.2)
        received = device.sent()
        begun = -(-begun_bytes // 32)
        kept = numbers(frames(received))
        assert kept[:begun] == list(range(begun))
        assert kept[begun:] == list(range(100 - len(kept) + begun, 100))
        assert len(received) == 32 * len(kept), "no byte of another frame is between them"


def test_queue_keeps_what_is_sent_once_and_drops_messages_for_it() -> None:
    """Errors, topics and requests of the device are sent once; a pose is repeated in a tenth of a second."""
    with blocked() as device:
        device.log(2, "first")
        for number in range(100):
            device.publish(pose(number))
        device.log(3, "left wheel stalled")
        device.request_parameter("/gain")
        device.feed(TOPICS_REQUEST)
        spin(device, 1.1)
        device.room(2**32)
        spin(device, 1.2)
        received = frames(device.sent())
        others = [frame.topic_id for frame in received if frame.topic_id != 125]
        assert others == [Id.LOG, Id.LOG, Id.PARAMETER, Id.TIME, Id.PUBLISHER, Id.SUBSCRIBER, Id.SUBSCRIBER]
        assert numbers(received)[-1] == 99
        assert device.is_configured


def test_a_queue_without_messages_refuses_and_counts() -> None:
    with blocked() as device:
        for _ in range(60):
            device.log(2, "x" * 100)
        lines = 2048 // 113
        assert device.dropped_to_host == 60 - lines
        assert not device.publish(bytes(200))
        device.room(2**32)
        spin(device, 1.1)
        assert [frame.topic_id for frame in frames(device.sent())] == [Id.LOG] * lines


@given(
    story=st.lists(
        st.tuples(st.sampled_from(["pose", "pose", "plot", "log", "spin"]), st.integers(0, 300)), max_size=150
    )
)
def test_host_on_a_line_of_any_rate_gets_whole_frames_in_order(story: list[tuple[str, int]]) -> None:
    with blocked() as device:
        data, published, accepted = b"", 0, 0
        now_s = 1.0
        for kind, size in story:
            if kind == "spin":
                device.room(size)
                now_s += 0.001
                spin(device, now_s)
                data += device.sent()
            elif kind == "log":
                device.log(2, "x" * (size % 100))
            else:
                published += 1
                accepted += device.publish(pose(published) + bytes(24 if kind == "plot" else 0))
        device.room(2**32)
        spin(device, now_s + 0.001)
        data += device.sent()
        received = frames(data)
        assert sum(len(frame.payload) + 8 for frame in received) == len(data), "nothing but frames"
        kept = numbers(received)
        assert kept == sorted(kept)
        lost_logs = sum(kind == "log" for kind, _ in story) - sum(frame.topic_id == Id.LOG for frame in received)
        assert device.dropped_to_host == published - len(kept) + lost_logs
        if sum(kind == "log" for kind, _ in story) <= 10:  # with at most 113 bytes each there is always room
            assert accepted == published
            assert kept[-1:] == ([published] if published else [])


def test_a_frame_found_among_bytes_that_are_read_again_has_its_own_quarter_of_a_second() -> None:
    with node() as device:
        device.feed(b"\xff\xfe\x02\x00\xfd\x06\x00")  # the header of a frame that never arrives
        device.spin(1.0)
        device.feed(LED[:8])
        device.spin(1.24)
        device.feed(LED[8:])
        device.spin(1.26)
        assert device.received() == [b"\x01"]


@pytest.mark.parametrize("topic_id", [1, 7, 99, 100, 102, 65535])
def test_a_false_header_does_not_make_the_default_deaf(topic_id: int) -> None:
    """The header claims 510 bytes, perhaps a second of commands. Its id, or the size for it, is wrong."""
    with node() as device:
        device.feed(encode(topic_id, bytes(510))[:7] + LED)
        spin(device, 1.0)
        assert device.received() == [b"\x01"]


@pytest.mark.parametrize("retries", [True, False])
@given(story=st.lists(st.tuples(lines, st.floats(0.0, 0.08)), max_size=12))
def test_the_same_frames_also_at_the_pace_of_the_line(retries: bool, story: list[tuple[bytes, float]]) -> None:
    """At 38400 baud frames straddle the turns of a 30 Hz loop. The clause bridges the same gaps in both."""
    heard: list[bytes] = []
    line = Uart(baud=38400, ring_bytes=1 << 20)
    twin = OriginalDevice(retries=retries)
    twin.from_host = Uart(baud=38400, ring_bytes=1 << 20)  # large: losses would depend on the ring
    twin.advertise("/odometry", "geometry_msgs/Pose2D", "m")
    twin.subscribe("/velocity", "geometry_msgs/Twist", "m", heard.append)
    twin.subscribe("/led", "std_msgs/Bool", "m", heard.append)
    with node(Retry.PAPER if retries else Retry.NONE) as device:
        now_s, sent_at_s = 1.0, 1.0
        for data, pause_s in [*story, (b"", 0.5)]:
            sent_at_s += round(pause_s, 3)
            while now_s < sent_at_s:
                now_s += turn(device, twin, line, now_s)
                assert device.received() == heard
                heard.clear()
            for end in (line, twin.from_host):
                end.send(data, sent_at_s)
        assert device.sent() == twin.to_host.pop(now_s + 10.0)
        assert device.is_configured == twin.is_configured


def turn(device: Node, twin: OriginalDevice, line: Uart, now_s: float) -> float:
    """One turn of both, with the waits that they ask for; returns when the next turn begins."""
    began_s = now_s
    while True:
        device.feed(line.pop(now_s))
        wait_s = twin.spin(now_s)
        assert device.spin(now_s) == wait_s
        if wait_s is None:
            return max(LOOP_S, now_s - began_s)
        now_s += wait_s
