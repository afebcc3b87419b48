"""A session of a protocol that overrides what it must: what a device has then, and what is not known of it."""

from hostlink.core.messages.serialisation import ROS1
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.link_evidence import JUDGED_S, LinkEvidence, Tally
from hostlink.core.protocol.session import DeviceSession
from hostlink.core.runtime.stop_frames import StopFrames
from hostlink.errors import FrameTooLarge
from tests.support.fake_device import CATALOG
from tests.support.text_protocol import TEXT

VELOCITY = DeviceEndpoint(EndpointKind.SUBSCRIBER, 1, "car/cmd_vel", "geometry_msgs/Twist")
OTHER = VELOCITY._replace(name="other/cmd_vel", id=2)
UNREADABLE = LinkEvidence(JUDGED_S + 1.0, recent=Tally(bytes_from_device=100, skipped_bytes=100), sample=b"?")


def announced() -> DeviceSession:
    session = TEXT.session(CATALOG, uart_bytes_s=None, max_topics=16, is_lossy=False)
    session.open(now_s=0.0)
    session.receive(b"HELLO car\n", now_s=0.1)
    assert session.topics
    return session


def test_session_of_a_plain_protocol_counts_and_refuses_nothing() -> None:
    session = announced()
    assert (session.is_regular, session.is_crowded(b"x" * 1000), session.is_outdated) == (False, False, False)
    assert (session.bad_checksums, session.wrong_sizes, session.rejected, session.refusals) == (0, 0, {}, ())
    assert session.too_small(lambda _: 10_000) == []
    assert session.rest_of_frame_bytes([b"POSE 0 0 0\n"]) == 0
    assert not session.is_refused(session.topics[0])
    assert session.stop_frames((b"zero",)) == StopFrames((b"zero",), b"BYE\n")
    assert session.stop_frames((b"zero", b"other")).last_writes == (b"zero", b"other")


def test_device_of_a_plain_protocol_waits_for_the_response_to_each_request() -> None:
    session = announced()
    assert session.is_waiting_for(OTHER, b"1")
    session.leave_unanswered(OTHER, b"1")


def test_endpoint_that_is_announced_may_still_be_there_and_no_other() -> None:
    session = announced()
    assert [session.may_have(each) for each in session.topics] == [True] * len(session.topics)
    assert not session.may_have(OTHER)
    assert session.raw_encoding == ROS1


def test_payload_beyond_the_room_of_an_endpoint_is_named_with_both_sizes() -> None:
    session = announced()
    error = session.too_long(VELOCITY, 10_000)
    assert isinstance(error, FrameTooLarge)
    assert "10000" in str(error)
    assert str(session.room_bytes(VELOCITY)) in str(error)


def test_commands_of_an_endpoint_that_wait_are_dropped() -> None:
    session = announced()
    (velocity,) = [each for each in session.topics if each.is_to_device]
    session.outbox.put_command(velocity.id, b"VEL 1 0\n")
    session.drop_commands(velocity)
    frames = []
    while (frame := session.pop_frame(now_s=1.0, wall_ns=0)) is not None:
        frames.append(frame.frame)
    assert b"VEL 1 0\n" not in frames


def test_last_message_is_that_of_the_protocol() -> None:
    session = announced()
    session.stop()
    frames = []
    while (frame := session.pop_frame(now_s=1.0, wall_ns=0)) is not None:
        frames.append(frame.frame)
    assert frames[-1] == b"BYE\n"


def test_unreadable_bytes_are_a_finding_and_readable_ones_none() -> None:
    session = announced()
    assert session.explain(UNREADABLE) == {"no_sync": "100 of 100 bytes in no frame"}
    assert session.explain(UNREADABLE._replace(recent=Tally(bytes_from_device=100))) == {}
    assert session.explain(UNREADABLE._replace(is_shared=True)) == {}
    assert session.own_counts == ()


def test_captured_host_of_a_plain_protocol_asks_for_nothing() -> None:
    assert TEXT.host_reader()(b"HELLO?\n") == 0
