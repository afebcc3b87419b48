"""Diagnosis of recordings: no finding for healthy devices, none for a part that the rest would refute."""

from pathlib import Path

import pytest

from hostlink.core.diagnosis.finding import Finding
from hostlink.core.diagnosis.replay import replay
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.registry import find_protocol
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, encode
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.runtime.capture_file import Read, load_reads

CAPTURES = Path(__file__).parents[3] / "captures"
CATALOG = Catalog()


def findings(reads: list[Read]) -> list[Finding]:
    connections = replay(reads, find_protocol, CATALOG)
    return [each for connection in connections.values() for each in connection.findings()]


def robot() -> list[Read]:
    return list(load_reads(CAPTURES / "robot.jsonl"))


@pytest.mark.parametrize("name", ["robot", "robot_serial", "services", "reconnect"])
def test_healthy_real_devices_give_no_finding(name: str) -> None:
    assert findings(list(load_reads(CAPTURES / f"{name}.jsonl"))) == []


def test_recording_with_a_lost_beginning_gives_no_finding() -> None:
    assert findings(robot()[400:]) == []


def late(reads: list[Read], begin_s: float) -> list[Read]:
    """Return a recording as `hostlink capture` saves it after its first device bytes were lost."""
    stream = FrameStream()
    before = (bytes.fromhex(read.hex) for read in reads if read.dir == "device" and read.t < begin_s)
    frames = (item for data in before for item in stream.feed(data) if isinstance(item, Frame))
    infos = (frame for frame in frames if frame.topic_id <= EndpointKind.SERVICE_CLIENT_SUBSCRIBER)
    announced = b"".join(encode(*info) for info in infos).hex()
    kept = [read for read in reads if read.dir == "host" or read.t >= begin_s]
    return [Read("device", t=0.0, event="open"), Read("device", announced, kept[0].t, event="topics"), *kept]


@pytest.mark.parametrize("begin_s", [8.0, 20.0, 40.0])
def test_marked_late_beginning_is_not_silence(begin_s: float) -> None:
    assert findings(late(robot(), begin_s)) == []


def test_silence_after_a_late_beginning_is_found() -> None:
    reads = late(robot(), 20.0)
    assert [each.code for each in findings([*reads, Read("device", t=reads[-1].t + 60.0, event="close")])] == [
        "went_silent"
    ]


def test_text_between_frames_is_found() -> None:
    text = [Read("device", b"speed 1\r\n".hex(), read.t) for read in robot() if read.dir == "device" and read.hex]
    mixed = sorted([*robot(), *text], key=lambda read: read.t)
    assert [each.code for each in findings(mixed)] == ["text_on_line"]


def test_device_that_does_not_answer_is_found() -> None:
    requests = [Read("host", "fffe0000ff0000ff", float(t)) for t in (0, 2, 4)]
    quiet = [Read("device", t=0.0, event="open"), *requests, Read("device", t=11.0, event="close")]
    assert [each.code for each in findings(quiet)] == ["no_bytes"]


def test_device_that_sends_only_time_requests_has_no_topics() -> None:
    requests = [Read("host", "fffe0000ff0000ff", t) for t in (0.0, 2.0, 4.0)]
    answers = [Read("device", "fffe0800f70a000000000000000000f5", t + 0.1) for t in (0.0, 2.0, 4.0)]
    reads = sorted([*requests, *answers, Read("device", t=6.0, event="close")], key=lambda read: read.t)
    assert [each.code for each in findings(reads)] == ["no_topics"]


def test_topics_are_known_half_a_second_after_the_last_one() -> None:
    info = DeviceEndpoint(
        EndpointKind.PUBLISHER, 125, "/bumper", "std_msgs/Bool", "8b94c1b53db61fb6aed406028ad6332a", 512
    )
    announced = Read("device", encode(info.kind, encode_topic_info(info)).hex(), 0.1)
    reads = [Read("device", t=0.0, event="open"), Read("host", "fffe0000ff0000ff", 0.0), announced]
    (connection,) = replay([*reads, Read("device", t=2.0, event="close")], find_protocol, CATALOG).values()
    assert connection.findings() == []
    assert connection.session.topics == (info,)
