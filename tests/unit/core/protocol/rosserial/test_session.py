"""Session: requests, answers, refusals, negotiation. Times are virtual."""

import dataclasses
import gc
import itertools

import pytest

from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.outbox import OutgoingFrame
from hostlink.core.protocol.rosserial.control import Log
from hostlink.core.protocol.rosserial.frame import TOPICS_REQUEST, Frame, Id, encode
from hostlink.core.protocol.rosserial.negotiation import MAX_PARTS, MAX_SAME_REQUESTS
from hostlink.core.protocol.rosserial.session import DEFAULT_BUFFER_BYTES, MOST_FRAMES, VERSION_1, Session
from hostlink.errors import FrameTooLarge, UnknownTopic, WrongType
from tests.support.device_codec import encode_log, encode_parameter_request
from tests.support.rosserial_stop import rosserial_stop
from tests.support.session_host import LED, ODOMETRY, TEXT, TIME, Host, check, wire


def test_open_requests_topics() -> None:
    host = Host()
    assert host.requests() == ["connected"]
    assert host.session.pop_frame(now_s=host.now_s, wall_ns=0) == OutgoingFrame(TOPICS_REQUEST)


def test_request_without_answer_is_repeated_every_two_seconds() -> None:
    host = Host()
    host.wait(10.0)
    assert host.requests() == ["no_answer"] * 5


def test_topics_are_known_after_a_frame_of_another_kind_or_half_a_second() -> None:
    host = Host()
    assert host.receive(wire(ODOMETRY, LED)) == []
    assert host.wait(0.4) == []
    assert host.wait(0.2) == [events.TopicsNegotiated((LED, ODOMETRY), is_changed=True, gap_at=None)]
    host = Host()
    assert host.receive(wire(ODOMETRY) + TIME)[0] == events.TopicsNegotiated((ODOMETRY,), is_changed=True, gap_at=None)


def test_message_of_a_known_topic_is_received() -> None:
    host = Host(ODOMETRY)
    assert host.receive(encode(125, bytes(24))) == [events.MessageReceived(ODOMETRY, bytes(24))]


def test_session_is_steady_except_during_a_negotiation_a_due_request_and_a_part_of_a_frame() -> None:
    host = Host()
    assert not host.session.is_steady
    host.receive(wire(ODOMETRY))
    assert not host.session.is_steady
    host.receive(TIME)
    assert host.session.is_steady
    frame = encode(125, bytes(24))
    host.receive(frame[:9])
    assert not host.session.is_steady
    host.receive(frame[9:])
    assert host.session.is_steady
    host.session.probe()
    assert not host.session.is_steady


def test_message_of_the_wrong_size_is_damage() -> None:
    host = Host(ODOMETRY)
    assert host.receive(encode(125, bytes(23))) == []
    assert host.session.rejected == {"wrong_size": 1}
    assert host.session.counts.skipped_bytes == 31


def test_time_is_answered_first_with_the_clock_of_the_moment_of_sending() -> None:
    host = Host(ODOMETRY, LED)
    host.session.publish("/led", b"\x01")
    assert host.receive(TIME) == [events.TimeRequested()]
    assert host.sent() == [Frame(Id.TIME, bytes.fromhex("00000000 05000000")), Frame(100, b"\x01")]


def test_unknown_id_causes_at_most_one_request_a_second_and_three_in_all() -> None:
    host = Host(ODOMETRY)
    requested_at_s = []
    for _ in range(1000):
        host.receive(encode(140, b"?"))
        if host.requests():
            requested_at_s.append(host.now_s)
            host.receive(TIME + wire(ODOMETRY) + TIME)
    assert len(requested_at_s) == MAX_SAME_REQUESTS
    assert all(later - earlier >= 1.0 for earlier, later in itertools.pairwise(requested_at_s))
    assert host.session.counts.unknown_ids == 1000


def test_frames_before_the_answer_cause_no_second_request() -> None:
    host = Host()
    for _ in range(20):
        host.receive(encode(125, bytes(24)))
    host.receive(TIME + wire(ODOMETRY) + TIME)
    host.wait(3.0)
    assert host.session.counts.topic_requests == 1


@pytest.mark.parametrize(
    ("infos", "gap_at"),
    [
        ([ODOMETRY, LED._replace(id=101)], 100),
        ([ODOMETRY, LED, TEXT._replace(id=102)], 101),
        ([ODOMETRY, ODOMETRY._replace(id=127, name="/b")], 126),
    ],
)
def test_gap_in_the_ids_causes_three_requests(infos: list[DeviceEndpoint], gap_at: int) -> None:
    host = Host(*infos)
    assert [event.gap_at for event in host.events if isinstance(event, events.TopicsNegotiated)] == [gap_at]
    topic_requests = 0
    for _ in range(10):
        host.wait(1.2)
        if "gap" in host.requests():
            topic_requests += 1
            host.receive(TIME + wire(*infos) + TIME)
    assert topic_requests == MAX_SAME_REQUESTS


def test_other_topics_are_a_new_cause_for_requests() -> None:
    lost = LED._replace(id=101)
    host = Host(ODOMETRY, lost)
    for _ in range(MAX_SAME_REQUESTS):
        host.wait(1.2)
        assert "gap" in host.requests()
        host.receive(TIME + wire(ODOMETRY, lost) + TIME)
    host.wait(1.2)
    assert host.requests() == []
    host.receive(TIME + wire(ODOMETRY._replace(name="/other"), lost) + TIME)
    assert host.requests() == ["gap"]


def test_new_session_has_zero_counts_and_counts_its_first_negotiation() -> None:
    session = Session(check=check)
    assert set(dataclasses.asdict(session.counts).values()) == {0}
    assert Host(ODOMETRY).session.counts.negotiations == 1


def test_damage_during_a_negotiation_causes_a_request() -> None:
    host = Host()
    host.receive(wire(ODOMETRY) + b"junk" + wire(LED) + TIME)
    host.wait(1.1)
    assert host.requests() == ["damaged"]
    host.receive(wire(ODOMETRY, LED) + TIME)
    host.wait(1.1)
    assert host.requests() == []


def test_line_of_the_log_between_topics_ends_no_negotiation() -> None:
    """A passthrough that reports its signal strength inserts a log line after any frame of the device."""
    host = Host()
    host.receive(TIME + wire(ODOMETRY) + encode(Id.LOG, encode_log(Log(1, "WiFi signal -85 dBm"))))
    assert host.receive(wire(LED) + TIME)[0] == events.TopicsNegotiated((LED, ODOMETRY), is_changed=True, gap_at=None)
    host.receive(encode(125, bytes(24)))
    assert (host.session.counts.negotiations, host.session.counts.unknown_ids) == (1, 0)


def test_messages_between_topics_let_the_same_negotiation_go_on() -> None:
    """A device with several tasks interleaves messages and TopicInfos. No topic request is between the two parts."""
    host = Host()
    host.receive(TIME + wire(LED, ODOMETRY) + encode(125, bytes(24)) + wire(TEXT) + encode(125, bytes(24)) + TIME)
    assert [info.name for info in host.session.topics] == ["/led", "/text", "/odometry"]
    assert host.session.counts.unknown_ids == 0


def test_frame_after_each_topic_ends_eight_negotiations_then_waits_for_a_pause() -> None:
    """Each finished negotiation costs the hub 6 ms with 256 velocity topics, for 90 bytes from the device."""
    host, topics = Host(), [ODOMETRY._replace(id=125 + number, name=f"/t{number}") for number in range(40)]
    for topic in topics:
        host.receive(wire(topic) + TIME)
    assert host.session.counts.negotiations == MAX_PARTS
    host.wait(0.6)
    assert (host.session.counts.negotiations, len(host.session.topics)) == (MAX_PARTS + 1, 40)
    host.receive(wire(*topics) + TIME)
    assert host.session.counts.negotiations == MAX_PARTS + 2


def test_messages_between_topics_that_are_announced_again_change_nothing() -> None:
    """A configured device continues to publish. Its robot must not disappear meanwhile."""
    scan = ODOMETRY._replace(id=126, name="/scan")
    host = Host(ODOMETRY, scan, LED)
    messages = encode(125, bytes(24)) + encode(126, bytes(24))
    parts = [TIME, wire(ODOMETRY), messages, wire(scan), messages, encode(Id.PARAMETER, encode_parameter_request("/a"))]
    found = [event for part in (*parts, wire(LED), messages) for event in host.receive(part)]
    negotiated = [event for event in found if isinstance(event, events.TopicsNegotiated)]
    assert negotiated == [events.TopicsNegotiated((LED, ODOMETRY, scan), is_changed=False, gap_at=None)]
    assert sum(isinstance(event, events.MessageReceived) for event in found) == 6
    assert host.session.counts.unknown_ids == 0


def test_partial_announcement_ends_after_half_a_second_despite_messages() -> None:
    host = Host(ODOMETRY, LED)
    for is_gone in (False, False, True):
        host.receive(wire(LED), after_s=1.0)
        assert host.receive(encode(125, bytes(24)), after_s=0.4) == [events.MessageReceived(ODOMETRY, bytes(24))]
        topics = (LED,) if is_gone else (LED, ODOMETRY)
        assert host.wait(0.2)[0] == events.TopicsNegotiated(topics, is_changed=is_gone, gap_at=None)


@pytest.mark.parametrize("after_s", [0.01, 0.6])
def test_device_that_restarts_at_once_begins_a_negotiation(after_s: float) -> None:
    host = Host(ODOMETRY, LED)
    host.receive(wire(ODOMETRY._replace(name="/pose")) + TIME, after_s=after_s)
    assert [info.name for info in host.session.topics] == ["/pose"]


def test_second_negotiation_replaces_the_first() -> None:
    host = Host(ODOMETRY, LED)
    other = ODOMETRY._replace(name="/battery", type="std_msgs/Float32")
    found = host.receive(TIME + wire(other) + TIME)
    assert events.TopicsNegotiated((other,), is_changed=True, gap_at=None) in found
    assert host.receive(encode(125, b"1234")) == [events.MessageReceived(other, b"1234")]
    with pytest.raises(UnknownTopic, match="no topic named /led"):
        host.session.publish("/led", b"\x01")


def test_dropped_frames_are_reported_as_change_though_the_topics_are_the_same() -> None:
    """The receiver of TopicsNegotiated sends a zero velocity if a queued one was dropped."""
    host = Host(ODOMETRY, TEXT._replace(id=100), LED)
    host.session.publish("/led", b"\x00", is_urgent=True)
    found = host.receive(TIME + wire(ODOMETRY, TEXT._replace(id=100), LED) + TIME)
    assert [frame.topic_id for frame in host.sent()] == [Id.TIME]
    assert [event.is_changed for event in found if isinstance(event, events.TopicsNegotiated)] == [True]


@pytest.mark.parametrize(
    ("topic", "payload", "error", "text"),
    [
        ("/nope", b"", UnknownTopic, "no topic named /nope; known: /led, /text"),
        ("/odometry", bytes(24), UnknownTopic, "no topic named /odometry; known: /led, /text"),
        ("/led", b"\x01\x02", WrongType, "/led: wanted std_msgs/Bool of 1 bytes, got 2 bytes"),
        ("/text", bytes(57), FrameTooLarge, "/text: frame of 65 bytes, the device takes 64"),
    ],
)
def test_message_that_a_device_cannot_receive_is_refused_before_it_is_queued(
    topic: str, payload: bytes, error: type[Exception], text: str
) -> None:
    host = Host(ODOMETRY, LED, TEXT)
    with pytest.raises(error) as caught:
        host.session.publish(topic, payload)
    assert str(caught.value) == text
    assert host.sent() == []


def test_refused_topic_leaves_no_cycle_for_the_garbage_collector() -> None:
    """A device that repeated its announcement without end caused full collections of 20 ms, which delay a stop."""
    wrong = wire(LED._replace(md5="wrong")) + TIME
    host = Host(ODOMETRY)
    host.receive(wrong)
    for _ in range(5):  # what other tests have left, and what its finalizers leave
        gc.collect()
    gc.disable()
    try:
        for _ in range(500):
            host.receive(wrong, after_s=1.0)
        assert gc.collect() < 500  # other threads of the test run may leave some
    finally:
        gc.enable()


def test_refused_topic_is_an_event_and_its_messages_are_not_delivered() -> None:
    host = Host()
    wrong = LED._replace(md5="wrong")
    found = host.receive(wire(ODOMETRY, wrong, TEXT) + TIME)
    assert [(event.topic, str(event.reason)) for event in found if isinstance(event, events.TopicRefused)] == [
        (wrong, "/led: wanted md5 right, got md5 wrong")
    ]
    assert host.session.topics == (TEXT, ODOMETRY)
    with pytest.raises(WrongType):
        host.session.publish("/led", b"\x01")
    assert host.receive(encode(100, b"\x01")) == []
    assert host.session.counts.refused_frames == 1


def test_services_work_in_both_directions() -> None:
    server = [
        DeviceEndpoint(EndpointKind.SERVICE_SERVER_PUBLISHER, 125, "/set", "std_srvs/SetBool", "m", 512),
        DeviceEndpoint(EndpointKind.SERVICE_SERVER_SUBSCRIBER, 100, "/set", "std_srvs/SetBool", "m", 512),
    ]
    client = [
        DeviceEndpoint(EndpointKind.SERVICE_CLIENT_PUBLISHER, 126, "/ask", "std_srvs/SetBool", "m", 512),
        DeviceEndpoint(EndpointKind.SERVICE_CLIENT_SUBSCRIBER, 101, "/ask", "std_srvs/SetBool", "m", 512),
    ]
    host = Host(*server, *client)
    host.session.call("/set", b"request")
    host.session.respond(client[1], b"response")
    assert host.sent() == [Frame(100, b"request"), Frame(101, b"response")]
    assert host.receive(encode(125, b"yes") + encode(126, b"?")) == [
        events.ServiceResponded(server[0], b"yes"),
        events.ServiceRequested(client[0], b"?"),
    ]
    with pytest.raises(UnknownTopic, match="no service named /ask"):
        host.session.call("/ask", b"")


def test_parameters_and_logs_are_events() -> None:
    host = Host(LED)
    assert host.receive(
        encode(Id.PARAMETER, encode_parameter_request("/gain")) + encode(Id.LOG, encode_log(Log(2, "hot")))
    ) == [
        events.ParameterRequested("/gain"),
        events.DeviceLogged(2, "hot"),
    ]
    host.session.answer_parameter("/gain", Parameter(ints=(7,)))
    assert host.sent() == [Frame(Id.PARAMETER, bytes.fromhex("01000000 07000000 00000000 00000000"))]
    with pytest.raises(FrameTooLarge, match="parameter /long: frame of 124 bytes, the device takes 64"):
        host.session.answer_parameter("/long", Parameter(strings=("x" * 100,)))


@pytest.mark.parametrize(
    "frame", [encode(Id.LOG, b""), encode(Id.PARAMETER, b"\x01"), encode(42, b""), encode(0, b"x")]
)
def test_undecodable_control_frames_are_counted(frame: bytes) -> None:
    host = Host(LED)
    assert host.receive(frame) == []
    assert host.session.counts.malformed == 1


def test_frame_with_an_id_of_the_host_is_refused() -> None:
    host = Host(LED)
    assert host.receive(encode(100, b"\x01")) == []
    assert host.session.counts.refused_frames == 1


def test_protocol_1_is_recognised_once() -> None:
    host = Host()
    body = b"\x0a\x00\x08\x00" + bytes(8)
    line = b"\xff\xff" + body + bytes([255 - sum(body) % 256])
    found = [event for _ in range(3) for event in host.receive(line)]
    assert found == [VERSION_1]


def test_frame_that_stalls_is_given_up() -> None:
    host = Host(ODOMETRY)
    host.receive(b"\xff\xfe\x18\x00\xe7\x7d\x00half")
    host.wait(11.5)
    assert host.session.counts.skipped_bytes == 11
    assert host.receive(encode(125, bytes(24))) == [events.MessageReceived(ODOMETRY, bytes(24))]


def test_frame_may_pause_for_two_seconds() -> None:
    host = Host(ODOMETRY)
    frame = encode(125, bytes(24))
    host.receive(frame[:20])
    host.session.tick(now_s=host.now_s + 1.9)
    assert host.receive(frame[20:], after_s=1.95) == [events.MessageReceived(ODOMETRY, bytes(24))]
    assert host.session.counts.skipped_bytes == 0


def test_larger_announced_buffer_raises_the_frame_limit() -> None:
    big = DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/image", "sensor_msgs/Image", "m", 5000)
    host = Host(big)
    assert host.receive(encode(125, bytes(4000))) == [events.MessageReceived(big, bytes(4000))]


def test_pop_frame_waits_for_a_paced_device() -> None:
    session = Session(check=check, uart_bytes_s=960)
    session.open(now_s=0.0)
    assert session.outbox.wait_s(0.0) == 0.0
    assert session.pop_frame(now_s=0.0, wall_ns=0) == OutgoingFrame(TOPICS_REQUEST)
    assert session.outbox.wait_s(0.0) is None


def test_long_message_is_refused_while_the_robot_moves() -> None:
    text = DeviceEndpoint(EndpointKind.SUBSCRIBER, 101, "/text", "std_msgs/String", "m", 512)
    service = DeviceEndpoint(EndpointKind.SERVICE_SERVER_SUBSCRIBER, 102, "/service", "x/Y", "m", 512)
    session = Session(check=check, uart_bytes_s=3840)
    session.open(now_s=0.0)
    session.receive(TIME + wire(text, service) + TIME, now_s=0.1)
    session.outbox.robot_moves = True
    for send in (session.publish, session.call):
        name = "/text" if send == session.publish else "/service"
        with pytest.raises(FrameTooLarge, match="frame of 105 bytes, the device takes 104 while the robot moves"):
            send(name, bytes(97))
        send(name, bytes(96))
    session.outbox.robot_moves = False
    session.publish("/text", bytes(500))
    with pytest.raises(FrameTooLarge, match=r"frame of 513 bytes, the device takes 512$"):
        session.publish("/text", bytes(505))


def test_changed_topics_reset_robot_moves() -> None:
    """The device may not be a robot any longer. If it is, its first velocity sets the flag again."""
    session = Session(check=check, uart_bytes_s=3840)
    session.open(now_s=0.0)
    session.receive(TIME + wire(ODOMETRY, LED) + TIME, now_s=0.1)
    session.outbox.robot_moves = True
    text = DeviceEndpoint(EndpointKind.SUBSCRIBER, 101, "/text", "std_msgs/String", "m", 512)
    session.receive(wire(ODOMETRY, LED, text) + TIME, now_s=1.0)
    session.publish("/text", bytes(500))


def test_zeros_are_joined_and_the_longest_frame_before_them_is_as_the_largest_buffer() -> None:
    zeros = (b"one", b"other")
    assert Host().session.stop_frames(zeros) == rosserial_stop(zeros, DEFAULT_BUFFER_BYTES)
    stop = Host(ODOMETRY, LED).session.stop_frames(zeros)
    assert stop == rosserial_stop(zeros, LED.buffer_bytes)
    assert (stop.lead, stop.separator, stop.last_writes) == (bytes(3), b"\0", (b"oneother",))
    assert rosserial_stop(()).last_writes == ()


def test_zero_is_sent_to_an_endpoint_unless_its_id_has_another_name_type_and_md5_sum() -> None:
    host = Host(LED)
    for info in (LED, LED._replace(md5="n"), LED._replace(buffer_bytes=1), LED._replace(id=116)):
        assert host.session.send_zero(info, b"\0")
        assert host.sent() == [Frame(info.id, b"\0")]
    for info in (LED._replace(name="/lid"), LED._replace(type="std_msgs/Bowl", name="/lid")):
        assert host.session.may_have(info)
    other = LED._replace(name="/lid", type="std_msgs/Bowl", md5="n")
    assert not host.session.may_have(other)
    assert not host.session.send_zero(other, b"\0")
    assert host.sent() == []


@pytest.mark.parametrize(
    "altered",
    [LED._replace(md5="wrong"), LED._replace(md5="n"), LED._replace(buffer_bytes=8), LED._replace(name="/lid")],
)
def test_id_with_another_meaning_causes_a_topic_request(altered: DeviceEndpoint) -> None:
    host = Host(ODOMETRY, LED)
    host.wait(1.5)
    host.receive(wire(ODOMETRY, altered) + TIME)
    assert host.requests() == ["altered"]
    host.wait(1.5)
    host.receive(wire(ODOMETRY, LED) + TIME)  # altered again
    assert host.requests() == ["altered"]
    host.wait(1.5)
    host.receive(wire(ODOMETRY, LED) + TIME)
    assert host.requests() == []


def test_device_that_announces_something_else_each_time_is_asked_three_times() -> None:
    host = Host(ODOMETRY, LED)
    found: list[str] = []
    for number in range(8):
        host.wait(1.5)
        host.receive(wire(ODOMETRY, LED._replace(name=f"/led{number}")) + TIME)
        found += host.requests()
    assert found == ["altered"] * MAX_SAME_REQUESTS


def test_each_frame_to_the_device_is_counted_with_its_bytes() -> None:
    host = Host(LED)
    counts = host.session.counts
    frames, size = counts.frames_to_device, counts.bytes_to_device
    host.session.publish("/led", b"\x01")
    host.sent()
    assert (counts.frames_to_device - frames, counts.bytes_to_device - size) == (1, 9)


def test_answer_time_starts_with_the_topic_request() -> None:
    host = Host()
    host.sent()
    host.receive(TIME + wire(LED) + TIME, after_s=0.2)
    assert host.session.device_clock.answer_s == pytest.approx(0.2)
    host.session.publish("/led", b"\x01")
    host.sent()
    host.receive(TIME, after_s=1.0)
    assert host.session.device_clock.answer_s == pytest.approx(0.2)


def test_endpoint_of_a_service_takes_the_request() -> None:
    service = DeviceEndpoint(EndpointKind.SERVICE_SERVER_SUBSCRIBER, 110, "/halt", "std_srvs/Empty", "m", 512)
    host = Host(LED, service)
    assert host.session.service_endpoint("/halt", b"") == service
    assert host.sent() == []
    with pytest.raises(UnknownTopic):
        host.session.service_endpoint("/led", b"")


def test_first_topic_info_after_a_request_is_an_answer() -> None:
    host = Host()
    assert host.receive(wire(LED), after_s=0.1) == []  # the request waits
    host.wait(2.0)
    host.sent()
    asked_at_s = host.now_s
    assert host.receive(wire(LED, TEXT), after_s=0.2) == [events.TopicsAnswered(asked_at_s)]
    assert host.receive(wire(LED, TEXT), after_s=0.1) == []


def test_endpoint_of_a_topic_takes_the_message() -> None:
    host = Host(LED, TEXT)
    assert host.session.endpoint_of("/led", b"\x01") == LED
    assert host.sent() == []
    with pytest.raises(UnknownTopic):
        host.session.endpoint_of("/nope", b"")
    with pytest.raises(FrameTooLarge):
        host.session.endpoint_of("/text", bytes(57))


def test_waiting_time_is_reported_before_and_after_sending() -> None:
    host = Host(LED)
    assert not host.session.outbox.has_waiting
    host.session.publish("/led", b"\x01")
    host.session.outbox.begin_waiting(host.now_s)
    assert host.session.outbox.has_waiting
    host.now_s += 0.25
    assert host.session.outbox.oldest_s(host.now_s) == pytest.approx(0.25)
    host.sent()
    assert not host.session.outbox.has_waiting
    assert host.session.outbox.oldest_s(host.now_s) == 0.0
    assert host.session.outbox.slowest_wait_s == pytest.approx(0.25)


def test_one_id_may_be_that_of_a_publisher_and_of_a_subscriber() -> None:
    """Ids are per direction: nnarain/rosserial-rs numbers both from 125."""
    led = LED._replace(id=ODOMETRY.id)
    for infos in ((ODOMETRY, led), (led, ODOMETRY)):
        host = Host(*infos)
        assert host.session.topics == (led, ODOMETRY)
        assert host.session.refusals == ()
        assert host.receive(encode(125, bytes(24))) == [events.MessageReceived(ODOMETRY, bytes(24))]
        assert host.receive(encode(125, bytes(23))) == []
        assert host.session.rejected == {"wrong_size": 1}
        host.session.publish("/led", b"\x01")
        assert host.sent() == [Frame(125, b"\x01")]
        with pytest.raises(WrongType):
            host.session.publish("/led", bytes(24))


def test_refused_subscriber_leaves_the_publisher_of_its_id() -> None:
    host = Host(ODOMETRY, LED._replace(id=ODOMETRY.id, md5="wrong"))
    assert host.session.topics == (ODOMETRY,)
    assert host.receive(encode(125, bytes(24))) == [events.MessageReceived(ODOMETRY, bytes(24))]
    with pytest.raises(WrongType):
        host.session.publish("/led", b"\x01")


def test_frame_from_the_device_with_the_id_of_a_subscriber_is_refused_and_causes_no_request() -> None:
    host = Host(ODOMETRY, LED)
    host.receive(encode(LED.id, b"\x01"))
    assert (host.session.counts.refused_frames, host.session.counts.unknown_ids) == (1, 0)
    assert host.requests() == []


def test_message_of_a_refused_publisher_is_refused() -> None:
    host = Host(ODOMETRY._replace(md5="wrong"))
    assert host.session.topics == ()
    assert host.receive(encode(ODOMETRY.id, bytes(24))) == []
    assert (host.session.counts.refused_frames, host.session.counts.unknown_ids) == (1, 0)


def test_many_short_frames_are_read_in_parts() -> None:
    session, frame = Host().session, encode(999, b"")
    assert not session.is_crowded(frame * MOST_FRAMES)
    assert session.is_crowded(frame * (MOST_FRAMES + 1))
    assert not session.is_crowded(encode(125, b"\xff" * 4000))


def test_second_message_of_a_topic_and_size_has_its_own_payload() -> None:
    host = Host(ODOMETRY, LED)
    host.receive(TIME)
    host.sent()
    for payload in (b"\x01", b"\x00"):
        host.session.publish("/led", payload)
        assert host.sent() == [Frame(100, payload)]
