"""A second negotiation: queued frames for old ids, refused topics, lost TopicInfos."""

import traceback

import pytest

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.outbox import MAX_REPLIES
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.session import VERSION_1
from hostlink.core.protocol.rosserial.topic_table import MAX_MISSED
from hostlink.errors import DeviceBusy, FrameTooLarge, UnknownTopic, WrongType
from tests.support.session_host import LED, ODOMETRY, TEXT, TIME, Host, wire

MOTOR = LED._replace(name="/motor", type="std_msgs/Int32")
SERVICE = DeviceEndpoint(EndpointKind.SERVICE_SERVER_SUBSCRIBER, 101, "/set", "std_srvs/SetBool", "m", 512)
WRONG_LED = LED._replace(md5="wrong")
CLIENT = DeviceEndpoint(EndpointKind.SERVICE_CLIENT_PUBLISHER, 126, "/ask", "std_srvs/SetBool", "m", 512)
ANSWER = DeviceEndpoint(EndpointKind.SERVICE_CLIENT_SUBSCRIBER, 102, "/ask", "std_srvs/SetBool", "m", 512)
BIG = DeviceEndpoint(EndpointKind.PUBLISHER, 126, "/image", "sensor_msgs/Image", "m", 5000)


@pytest.mark.parametrize("is_urgent", [False, True])
def test_queued_command_is_dropped_when_its_id_changes_meaning(is_urgent: bool) -> None:
    """One frame of a wrong size crashes a device, so the frame is dropped even before the negotiation ends."""
    host = Host(ODOMETRY, LED)
    host.session.publish("/led", b"\x01", is_urgent=is_urgent)
    host.receive(wire(ODOMETRY, MOTOR))
    assert host.sent() == []


def test_queued_call_is_dropped_when_its_id_changes_meaning() -> None:
    host = Host(ODOMETRY, LED, SERVICE)
    host.session.call("/set", b"\x01")
    host.receive(wire(ODOMETRY, LED, TEXT) + TIME)
    assert [frame.topic_id for frame in host.sent()] == [Id.TIME]


def test_queued_call_is_dropped_when_its_service_is_removed() -> None:
    host = Host(ODOMETRY, LED, SERVICE)
    host.session.call("/set", b"\x01")
    for _ in range(MAX_MISSED):
        host.receive(wire(ODOMETRY, LED) + TIME)
    assert [frame.topic_id for frame in host.sent()] == [Id.TIME]


@pytest.mark.parametrize("lost", [ODOMETRY, LED, SERVICE, CLIENT, ANSWER])
def test_missing_topic_is_requested_and_kept_until_three_negotiations_lack_it(lost: DeviceEndpoint) -> None:
    topics = [ODOMETRY, CLIENT, LED, SERVICE, ANSWER]
    rest = [info for info in topics if info is not lost]
    host = Host(*topics)
    for requested in (2, 4):
        for _ in range(MAX_MISSED - 1):
            host.receive(TIME + wire(*rest) + TIME)
            assert lost in host.session.topics
            host.wait(1.1)
        host.receive(TIME + wire(*topics) + TIME)
        host.wait(1.1)
        assert host.session.counts.topic_requests == 1 + requested
    for _ in range(MAX_MISSED):
        host.receive(TIME + wire(*rest) + TIME)
    assert sorted(host.session.topics) == sorted(rest)


def test_new_topic_does_not_confirm_the_loss_of_another() -> None:
    """With lost datagrams the first announcement may lack one topic, and the second another."""
    host = Host(ODOMETRY, LED)
    host.receive(TIME + wire(LED, TEXT) + TIME)
    assert host.session.topics == (LED, TEXT, ODOMETRY)
    host.wait(1.1)
    assert host.requests() == ["missing"]


@pytest.mark.parametrize("other", [LED._replace(id=101), ODOMETRY._replace(name="/text"), MOTOR])
def test_missing_topic_is_removed_when_the_announcement_contradicts_the_last(other: DeviceEndpoint) -> None:
    """An id with another meaning, or a name with another id, shows that the device runs another program."""
    host = Host(ODOMETRY, LED, SERVICE._replace(id=102))
    host.receive(TIME + wire(other) + TIME, after_s=1.0)
    assert host.session.topics == (other,)


def test_announcement_in_parts_counts_as_one_negotiation() -> None:
    """Each part ends with a time request. Three parts must not count as three negotiations without the last topic."""
    topics = [ODOMETRY, TEXT._replace(id=101), SERVICE._replace(id=102), LED]
    host = Host(*topics)
    host.session.probe()
    assert host.session.tick(now_s=host.now_s) == [events.TopicsRequested("probe")]
    host.wait(1.1)
    for info in topics:
        host.receive(wire(info) + TIME)
        assert LED in host.session.topics


def test_has_endpoint_until_its_id_changes_meaning() -> None:
    host = Host(ODOMETRY, LED)
    assert host.session.has(LED)
    host.receive(wire(ODOMETRY, MOTOR))
    assert [host.session.has(info) for info in (ODOMETRY, LED, MOTOR, SERVICE)] == [True, False, True, False]


def test_parameter_answer_is_kept_through_a_negotiation() -> None:
    """The id of a parameter answer is fixed, and a device blocks until it arrives."""
    host = Host()
    host.sent()
    host.session.answer_parameter("/gain", Parameter())
    host.receive(wire(ODOMETRY, LED) + TIME)
    assert [frame.topic_id for frame in host.sent()] == [Id.TIME, Id.PARAMETER]


def test_repeated_topics_drop_no_command() -> None:
    host = Host(ODOMETRY, LED)
    host.session.publish("/led", b"\x01")
    host.receive(wire(ODOMETRY, LED) + TIME)
    assert host.sent()[-1] == Frame(100, b"\x01")


def test_new_id_drops_no_command() -> None:
    host = Host(ODOMETRY, LED)
    host.session.publish("/led", b"\x01")
    host.receive(wire(ODOMETRY, TEXT))
    assert host.sent() == [Frame(100, b"\x01")]


def test_refused_topic_stays_refused_until_it_is_announced_anew() -> None:
    host = Host(ODOMETRY, WRONG_LED)
    host.receive(wire(ODOMETRY))
    with pytest.raises(WrongType, match="/led: wanted md5 right, got md5 wrong"):
        host.session.publish("/led", b"12345")
    host.receive(wire(LED))
    host.session.publish("/led", b"\x01")
    assert host.sent() == [Frame(100, b"\x01")]


def test_refused_topic_that_is_no_longer_announced_is_unknown() -> None:
    host = Host(ODOMETRY, WRONG_LED)
    host.receive(wire(ODOMETRY) + TIME)
    with pytest.raises(UnknownTopic, match="no topic named /led"):
        host.session.publish("/led", b"\x01")


def test_topic_of_a_right_id_that_was_refused_before_is_usable() -> None:
    host = Host(WRONG_LED)
    host.receive(TIME)
    host.receive(wire(TEXT._replace(id=100)) + TIME)
    assert [topic.name for topic in host.session.topics] == ["/text"]


def test_refusal_keeps_no_callers_alive() -> None:
    """A client may publish to the refused topic for days."""
    host = Host(WRONG_LED)
    lengths = []
    for _ in range(3):
        with pytest.raises(WrongType) as refusal:
            host.session.publish("/led", b"\x01")
        lengths.append(len(traceback.extract_tb(refusal.value.__traceback__)))
    assert len(set(lengths)) == 1


def test_incomplete_last_topic_info_causes_a_request() -> None:
    """Only the incomplete bytes show the loss: a lost last id leaves no gap."""
    host = Host()
    host.receive(TIME + wire(ODOMETRY, LED, TEXT)[:-20])
    host.wait(1.1)
    assert host.requests() == ["damaged"]


def test_announced_buffer_sets_the_frame_limit_from_the_next_frame() -> None:
    host = Host()
    picture = encode(126, bytes(4000))
    assert events.MessageReceived(BIG, bytes(4000)) in host.receive(wire(ODOMETRY, BIG) + picture)
    for _ in range(MAX_MISSED):
        host.receive(wire(ODOMETRY) + TIME)
    assert host.receive(picture) == []
    assert host.session.rejected == {"too_long": 1}


def test_size_is_valid_from_the_next_frame_on() -> None:
    host = Host()
    right, wrong = encode(125, bytes(24)), encode(125, bytes(23))
    found = host.receive(wire(ODOMETRY) + wrong + right)
    assert [event for event in found if isinstance(event, events.MessageReceived)] == [
        events.MessageReceived(ODOMETRY, bytes(24))
    ]


@pytest.mark.parametrize("buffer_bytes", [65543, 65544, 2**31 - 1])
def test_buffer_above_the_largest_frame_is_limited(buffer_bytes: int) -> None:
    host = Host(TEXT._replace(id=100, buffer_bytes=buffer_bytes))
    host.session.publish("/text", bytes(65535))
    with pytest.raises(FrameTooLarge, match="/text: frame of 65544 bytes, the device takes 65543"):
        host.session.publish("/text", bytes(65536))


@pytest.mark.parametrize("buffer_bytes", [0, -1, -(2**31)])
def test_invalid_buffer_size_is_replaced_by_the_default(buffer_bytes: int) -> None:
    host = Host(TEXT._replace(id=100, buffer_bytes=buffer_bytes))
    host.session.publish("/text", bytes(504))
    with pytest.raises(FrameTooLarge, match="/text: frame of 513 bytes, the device takes 512"):
        host.session.publish("/text", bytes(505))


@pytest.mark.parametrize(
    ("parameter", "error", "text"),
    [
        (Parameter(strings=("x" * 70000,)), FrameTooLarge, "parameter /p: frame of 70024 bytes, the device takes 64"),
        (Parameter(ints=(2**31,)), WrongType, "parameter /p: wanted int32 or float32, got 'i' format requires"),
        (Parameter(floats=(1e300,)), WrongType, "parameter /p: wanted int32 or float32, got float too large"),
    ],
)
def test_unsendable_parameter_is_refused(parameter: Parameter, error: type[Exception], text: str) -> None:
    host = Host(LED)
    with pytest.raises(error) as caught:
        host.session.answer_parameter("/p", parameter)
    assert str(caught.value).startswith(text)
    assert host.sent() == []


def test_service_that_is_called_too_often_is_busy() -> None:
    host = Host(ODOMETRY, LED, SERVICE)
    for _ in range(MAX_REPLIES):
        host.session.call("/set", b"\x01")
    with pytest.raises(DeviceBusy, match="/set: 32 requests wait already; try again later"):
        host.session.call("/set", b"\x01")


def test_session_sends_nothing_after_a_stop() -> None:
    host = Host(ODOMETRY, LED)
    host.session.stop()
    host.receive(TIME)
    assert [frame.topic_id for frame in host.sent()] == [Id.STOP]
    host.session.publish("/led", b"\x01")
    host.wait(30.0)
    assert host.sent() == []
    assert host.session.outbox.wait_s(host.now_s) is None


def test_early_tick_does_nothing() -> None:
    host = Host(ODOMETRY)
    deadline_s = host.session.deadline_s()
    assert host.session.tick(now_s=host.now_s) == []
    assert host.session.deadline_s() == deadline_s


@pytest.mark.parametrize("size", [1, 3, 600])
def test_protocol_1_is_recognised_for_every_cut(size: int) -> None:
    body = b"\x7d\x00\xff\x00" + bytes(255)
    line = b"\xff\xff" + body + bytes([255 - sum(body) % 256]) + b"x" * 400
    host = Host()
    found = [event for at in range(0, len(line), size) for event in host.receive(line[at : at + size], after_s=0.0)]
    assert found == [VERSION_1]
