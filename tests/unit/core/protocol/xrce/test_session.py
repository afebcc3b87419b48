"""XrceSession: clients, objects, messages, services, time, flow control. A stock client plays in virtual time."""

import contextlib
import itertools
import math
import struct
from collections.abc import Callable
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import ENCAPSULATION, cdr_of
from hostlink.core.messages.serialisation import CDR
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Parameter
from hostlink.core.protocol.xrce.client import HEARTBEAT_MAX_S, IN_FLIGHT_S, LOST_MIN_S, REPEATS_AFTER, WAITING_MAX
from hostlink.core.protocol.xrce.evidence import STORED_PAUSE_S
from hostlink.core.protocol.xrce.framing import DatagramFraming
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_SERIAL, MICRO_ROS_TCP, MICRO_ROS_UDP, Xrce
from hostlink.core.protocol.xrce.resume import SessionState
from hostlink.core.protocol.xrce.session import (
    CALLS_MAX,
    CLIENTS_MAX,
    GONE_S,
    KEEPALIVE_S,
    LATE_CREATION_S,
    QUIET_S,
    RESTART_SILENCE_S,
    XrceSession,
    endpoint_id,
    object_id,
)
from hostlink.core.protocol.xrce.streams import WINDOW
from hostlink.core.protocol.xrce.wire import Kind
from hostlink.errors import BadPayload, DeviceBusy, FrameTooLarge, UnknownTopic, WrongType
from tests.support import xrce_board as board
from tests.support.xrce_board import TWIST, XML, Client, Link, Program, World, sub

CATALOG = Catalog()
KEY = b"\1\2\3\4"
NODE, NODE_TOPIC, NODE_PUBLISHER, NODE_SUBSCRIBER, WRITER, READER, REQUESTER, REPLIER = range(1, 9)
SET_BOOL = "std_srvs::srv::dds_::SetBool"
VELOCITY = TWIST.pack(0.2, 0, 0, 0, 0, 0.5)
ZERO = bytes(48)


def cdr(name: str, message: dict[str, object]) -> bytes:
    type_ = CATALOG.message(name)
    assert type_ is not None
    return cdr_of(type_).from_ros1(type_.encode(message))


def made(**settings: int) -> XrceSession:
    return MICRO_ROS_UDP.resumed(CATALOG, "", **settings)


def idle() -> Program:
    while True:
        yield math.inf


def world(client: Client | None = None, session: XrceSession | None = None, link: Link | None = None) -> World:
    client = client or Client(key=KEY)
    return World(session or made(), idle(), client, link or Link(Random(1), delay_s=(0.001, 0.001)))


def creations(client: Client, *, stream: int = 0x80) -> Program:
    """A node that publishes text, takes text and velocities, and has and calls a service."""
    text_type = "std_msgs::msg::dds_::String_"
    for id_, content, parent in (
        (0x01, board.participant("/ns/base"), 0),
        (0x02, board.topic("rt/chatter", text_type), 1),
        (0x03, b"\0\0", 1),
        (WRITER, board.endpoint(0x02, is_reader=False), 3),
        (0x12, board.topic("rt/cmd_vel", "geometry_msgs::msg::dds_::Twist_"), 1),
        (0x04, b"\0\0", 1),
        (READER, board.endpoint(0x12, is_reader=True), 4),
        (0x22, board.topic("rt/words", text_type), 1),
        (0x16, board.endpoint(0x22, is_reader=True), 4),
        (REQUESTER, board.service("ask", SET_BOOL), 1),
        (REPLIER, board.service("led", SET_BOOL), 1),
    ):
        status = yield from client.create(id_, content, parent)
        assert status in {0, 1}, (hex(id_), status)
    for id_ in (READER, 0x16, REQUESTER, REPLIER):
        client.read_data(id_, stream)
    yield from client.confirm(1.0)


def connected(client: Client | None = None, session: XrceSession | None = None, *, stream: int = 0x80) -> World:
    """A board that is announced."""
    here = world(client, session)
    assert here.do(here.client.connect())
    here.do(creations(here.client, stream=stream))
    here.run(here.now_s + 2 * QUIET_S)
    assert here.session.topics
    return here


def of_kind(here: World, kind: type) -> list[object]:
    return [event for _, event in here.found if isinstance(event, kind)]


def taken(here: World, id_: int) -> list[bytes]:
    return [payload for _, object_, _, payload in here.client.taken if object_ == id_]


def text_of(payload: bytes) -> str:
    return payload[4:-1].decode()


# -- clients ----------------------------------------------------------------------------------------------------------


def test_board_is_announced_with_the_names_of_ros() -> None:
    here = connected()
    names = {(each.kind, each.name, each.type) for each in here.session.topics}
    assert names == {
        (EndpointKind.PUBLISHER, "/chatter", "std_msgs/String"),
        (EndpointKind.SUBSCRIBER, "/cmd_vel", "geometry_msgs/Twist"),
        (EndpointKind.SUBSCRIBER, "/words", "std_msgs/String"),
        (EndpointKind.SERVICE_CLIENT_PUBLISHER, "/ask", "std_srvs/SetBool"),
        (EndpointKind.SERVICE_CLIENT_SUBSCRIBER, "/ask", "std_srvs/SetBool"),
        (EndpointKind.SERVICE_SERVER_PUBLISHER, "/led", "std_srvs/SetBool"),
        (EndpointKind.SERVICE_SERVER_SUBSCRIBER, "/led", "std_srvs/SetBool"),
    }
    (negotiated,) = of_kind(here, events.TopicsNegotiated)
    assert negotiated == events.TopicsNegotiated(here.session.topics, is_changed=True, gap_at=None)
    assert here.session.counts.negotiations == 1
    assert here.session.node == "/ns/base"
    assert here.session.raw_endpoints == ()
    assert not here.session.is_steady
    here.run(here.now_s + 2.0)
    assert here.session.is_steady


@pytest.mark.parametrize("session", [0x00, 0x7F, 0x80, 0x81, 0xFF])
@pytest.mark.parametrize("mtu", [64, 512, 65535])
def test_clients_with_any_session_id_and_longest_message_are_announced(session: int, mtu: int) -> None:
    client = Client(key=KEY, session=session, mtu=max(mtu, 76) if session < 0x80 else max(mtu, 68), history=8)
    here = connected(client)
    here.do(client.publish(WRITER, cdr("std_msgs/String", {"data": "x" * 100})))
    assert [event.payload[4:] for event in of_kind(here, events.MessageReceived)] == [b"x" * 100]
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.write()
    here.do(client.listen(0.1))
    assert taken(here, READER) == [VELOCITY]


def test_ping_is_answered_with_and_without_a_session() -> None:
    here = world()
    assert here.do(here.client.ping())
    assert here.client.pong == 0
    here.do(here.client.connect())
    assert here.do(here.client.ping(session=0x81))
    assert here.client.pong == 1


def test_board_gets_the_time_at_once() -> None:
    here = connected()
    assert here.do(here.client.synchronise(0.01))
    assert here.client.offset_ns == -(10**18)
    assert of_kind(here, events.TimeRequested)


def test_answers_are_queued_before_the_events_are_returned() -> None:
    session = made()
    session.open(now_s=0.0)
    client = Client(key=KEY)
    session.receive(client.creation(), now_s=0.0)
    assert session.outbox.has_waiting
    assert session.pop_frame(now_s=0.0, wall_ns=0) is not None
    client.send(0, 0, sub(board.TIMESTAMP, bytes(8)))
    assert session.receive(client.sent.pop(), now_s=0.0) == [events.TimeRequested()]
    assert session.outbox.is_time_due


def test_client_of_another_version_or_with_too_short_messages_is_refused() -> None:
    here = world()
    here.client.mtu = 20
    assert not here.do(here.client.connect(attempts=1))
    assert here.client.agent_status == 0x85
    creation = Client(key=KEY).creation().replace(b"XRCE\1", b"XRCE\2")
    here.session.receive(creation, now_s=here.now_s)
    here.write()
    here.do(here.client.listen(0.1))
    assert here.client.agent_status == 0x86
    assert here.session.topics == ()


def test_deleted_client_has_no_endpoints() -> None:
    here = connected()
    here.client.send(0, 0, sub(board.DELETE, bytes.fromhex("0002FFFE")))
    here.do(here.client.listen(1.0))
    here.run(here.now_s + 2 * RESTART_SILENCE_S)
    assert here.client.statuses[2] == 0
    assert here.session.topics == ()
    assert of_kind(here, events.TopicsNegotiated)[-1] == events.TopicsNegotiated((), is_changed=True, gap_at=None)


def test_deletion_of_an_unknown_client_is_answered() -> None:
    here = world()
    here.client.send(0, 0, sub(board.DELETE, bytes.fromhex("0002FFFE")))
    here.do(here.client.listen(1.0))
    assert here.client.statuses == {2: 0}


def test_board_that_restarts_is_announced_anew_and_its_velocities_are_dropped() -> None:
    here = connected()
    velocity = next(each for each in here.session.topics if each.name == "/cmd_vel")
    here.session.outbox.put_urgent(1, b"old velocity")
    again = Client(key=b"new!")
    here.restart_board(again, idle())
    assert here.do(again.connect())
    assert not here.session.outbox.has_urgent
    assert not here.session.has(velocity)
    assert here.session.may_have(velocity)
    with pytest.raises(UnknownTopic):
        here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.do(creations(again))
    here.run(here.now_s + 2 * QUIET_S)
    assert [event.is_changed for event in of_kind(here, events.TopicsNegotiated)] == [True, True]  # type: ignore[attr-defined]
    assert here.session.has(velocity)
    assert here.session.quality.restarts == 1


@pytest.mark.parametrize("first", [1, 2, 11])
def test_board_that_answers_heartbeats_of_its_session_before_gets_its_first_status_at_once(first: int) -> None:
    here = connected()
    heartbeat = b"\x81\0\0\0" + sub(board.HEARTBEAT, struct.pack("<HHB", first, first, 0x80))
    other = Client(key=b"new!")
    here.restart_board(other, idle())
    here._inbox.extend([heartbeat] * 4)  # they wait in its socket
    began_s = here.now_s
    here.frames.clear()
    assert here.do(other.connect())
    here.do(creations(other))
    numbers = [int.from_bytes(frame[2:4], "little") for _, frame in here.frames if frame[1] == 0x80]
    assert numbers == list(range(11))
    assert here.now_s - began_s < 0.05


def test_late_creation_of_the_session_before_changes_nothing() -> None:
    here = connected()
    old = here.client.creation()
    again = Client(key=b"new!")
    here.restart_board(again, idle())
    here.do(again.connect())
    here.do(creations(again))
    here.session.receive(old, now_s=here.now_s)
    here.run(here.now_s + 1.0)
    assert len(here.session.topics) == 7
    here.session.receive(old, now_s=here.now_s + LATE_CREATION_S)
    here.run(here.now_s + LATE_CREATION_S + 2 * RESTART_SILENCE_S)
    assert here.session.topics == ()


def test_creation_that_came_twice_changes_nothing() -> None:
    here = connected()
    here.session.receive(here.client.creation(), now_s=here.now_s)
    here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"})))
    assert len(of_kind(here, events.MessageReceived)) == 1
    assert len(of_kind(here, events.TopicsNegotiated)) == 1


def test_client_that_begins_anew_with_its_key_keeps_its_objects() -> None:
    here = connected()
    here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"})))
    assert here.do(here.client.connect())
    assert here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "b"}))).is_done
    here.run(here.now_s + 2 * QUIET_S)
    assert len(of_kind(here, events.MessageReceived)) == 2
    assert [event.is_changed for event in of_kind(here, events.TopicsNegotiated)] == [True, True]  # type: ignore[attr-defined]


def test_client_without_reliable_messages_that_begins_anew_keeps_its_objects() -> None:
    here = connected()
    client = here.client
    client.publish_best_effort(WRITER, cdr("std_msgs/String", {"data": "a"}))
    here.do(client.listen(0.1))
    here.do(client.connect())
    client.publish_best_effort(WRITER, cdr("std_msgs/String", {"data": "b"}))
    here.do(client.listen(0.1))
    assert len(of_kind(here, events.MessageReceived)) == 2
    assert here.session.quality.best_effort_late == 0


def test_first_object_of_a_client_is_asked_for_after_the_answer_to_its_creation_was_lost() -> None:
    here = world()
    here.session.receive(here.client.creation(), now_s=0.0)  # the answer is lost
    here.run(0.5)  # the host asks for the first object meanwhile
    assert here.do(here.client.connect())
    here.client.put(here.client.creating(0x01, board.participant("base"), 0)[1])
    here.client.sent.clear()  # the first object is lost
    assert here.do(here.client.confirm(0.25))


def test_board_that_creates_objects_is_asked_for_what_was_lost() -> None:
    here = world()
    here.do(here.client.connect())
    here.client.send(0, 0, here.client.creating(0x01, board.participant("n"), 0)[1])
    here.client.put(here.client.creating(0x11, board.participant("lost"), 0)[1])
    del here.client.sent[1]
    here.client.tries, here.client.next_heartbeat_s = 1, math.inf  # it would send no HEARTBEAT
    here.do(here.client.listen(0.01))
    here.do(here.client.listen(0.1))
    here.run(here.now_s + 0.1)
    assert len(here.session._clients[0x81, b""].objects.by_id) == 2


def test_board_that_creates_objects_takes_a_status_within_its_second_though_most_answers_are_lost() -> None:
    here = world()
    assert here.do(here.client.connect())
    begun_s = here.now_s

    def first_ones_lost(now_s: float, *, to_board: bool) -> list[float]:
        return [now_s + 0.001] if not to_board or now_s > begun_s + 0.8 else []

    here.link.arrivals = first_ones_lost  # type: ignore[method-assign]
    assert here.do(here.client.create(0x01, board.participant("base"), 0)) == 0


def test_number_that_does_not_fit_is_not_acknowledged_while_a_board_creates_objects() -> None:
    session, client = made(), Client(key=KEY)
    session.receive(client.creation(), now_s=0.0)
    client.send(0x80, 500, sub(board.RESET, b""))
    session.receive(client.sent.pop(), now_s=0.01)
    session.tick(now_s=session.deadline_s())
    frames = []
    while (outgoing := session.pop_frame(now_s=1.0, wall_ns=0)) is not None:
        frames.append(outgoing.frame[4])
    assert board.ACKNACK not in frames


def test_several_clients_behind_one_address_are_one_device_up_to_a_bound() -> None:
    here = world()
    for number in range(CLIENTS_MAX):
        client = Client(key=KEY, session=0x81 + number)
        here.client = client
        client.now_s = here.now_s
        assert here.do(client.connect())
        here.do(creations(client))
    here.run(here.now_s + 2 * QUIET_S)
    assert len(here.session.topics) == 7 * CLIENTS_MAX
    assert len({each.key for each in here.session.topics}) == 7 * CLIENTS_MAX
    last = Client(key=KEY, session=0x91)
    for each in here.session._clients.values():
        each.heard_s = here.now_s
    here.session.receive(last.creation(), now_s=here.now_s)
    here.write()
    here.client = last
    here.do(last.listen(0.1))
    assert last.agent_status == 0x87
    here.run(here.now_s + RESTART_SILENCE_S)
    assert here.do(last.connect())
    assert here.session.quality.restarts == 1


def test_board_with_a_key_that_restarts_replaces_itself() -> None:
    here = connected(Client(key=KEY, session=0x01))
    here.run(here.now_s + RESTART_SILENCE_S)
    again = Client(key=b"new!", session=0x01)
    here.restart_board(again, idle())
    here.do(again.connect())
    here.do(creations(again))
    here.run(here.now_s + 2 * QUIET_S)
    assert len(here.session.topics) == 14
    here.run(here.now_s + 5.0)
    assert len(here.session.topics) == 7
    other = Client(key=b"also", session=0x01)
    here.session._clients[1, b"new!"].heard_s -= RESTART_SILENCE_S
    here.session.receive(other.creation(), now_s=here.now_s)
    assert list(here.session._clients) == [(1, b"also")]


def test_board_that_restarts_with_another_session_replaces_itself() -> None:
    here = connected()
    here.run(here.now_s + 2 * RESTART_SILENCE_S)
    again = Client(key=KEY, session=0x90)
    here.restart_board(again, idle())
    assert here.do(again.connect())
    here.do(creations(again))
    here.run(here.now_s + 5.0)
    assert [key[0] for key in here.session._clients] == [0x90]
    assert len(here.session.topics) == 7


@pytest.mark.parametrize(("key", "session"), [(KEY, 0x82), (b"new!", 0x82)])
@pytest.mark.parametrize(
    ("protocol", "transport"),
    [(MICRO_ROS_UDP, board.Datagrams), (MICRO_ROS_TCP, board.Lengths), (MICRO_ROS_SERIAL, board.Serial)],
)
def test_board_that_restarts_with_another_session_and_key_takes_velocities_at_once(
    protocol: Xrce, transport: type[board.Datagrams], key: bytes, session: int
) -> None:
    link = Link(Random(1), delay_s=(0.001, 0.001))
    here = World(protocol.resumed(CATALOG, ""), idle(), Client(key=KEY), link, transport())
    assert here.do(here.client.connect())
    here.do(creations(here.client))
    here.run(here.now_s + 2 * QUIET_S)
    again = Client(key=key, session=session)
    here.restart_board(again, idle())
    assert here.do(again.connect(attempts=1))
    here.do(creations(again))
    here.run(here.now_s + 2 * QUIET_S)
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.write()
    here.do(again.listen(0.1))
    assert taken(here, READER) == [VELOCITY]
    here.run(here.now_s + GONE_S + 2 * KEEPALIVE_S)
    assert [each.session for each in here.session._clients.values()] == [session]
    assert len(here.session.topics) == 7


def test_client_that_is_heard_keeps_its_names_when_a_second_one_has_the_same() -> None:
    here = connected()
    first, second = here.client, Client(key=b"also", session=0x82)
    here.session.receive(second.creation(), now_s=here.now_s)
    here.client = second
    assert here.do(second.connect())
    here.do(creations(second))
    first.send(0, 0, sub(board.ACKNACK, struct.pack("<HHB", first.last_handled + 1 & 0xFFFF, 0, 0x80)))
    here.session.receive(first.sent.pop(), now_s=here.now_s)
    here.run(here.now_s + 2 * QUIET_S)
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.write()
    assert here.frames[-1][1][0] == first.session


def test_topics_of_two_clients_keep_their_order_when_the_silent_one_is_heard_again() -> None:
    here = connected()
    first, second = here.client, Client(key=b"also", session=0x82)
    here.session.receive(second.creation(), now_s=here.now_s)
    here.client = second
    assert here.do(second.connect())
    here.do(creations(second))
    here.run(here.now_s + 2 * QUIET_S)
    topics, announced = here.session.topics, len(of_kind(here, events.TopicsNegotiated))
    assert len(topics) == 14
    first.send(0, 0, sub(board.ACKNACK, struct.pack("<HHB", first.last_handled + 1 & 0xFFFF, 0, 0x80)))
    here.session.receive(first.sent.pop(), now_s=here.now_s)
    here.do(second.create(0x32, board.topic("rt/unused", "std_msgs::msg::dds_::String_"), 1))
    here.run(here.now_s + 2 * QUIET_S)
    assert here.session.topics == topics
    assert len(of_kind(here, events.TopicsNegotiated)) == announced


def test_two_clients_with_equal_topics_both_stay_when_their_network_fails_for_a_while() -> None:
    here = connected()
    first, second = here.client, Client(key=b"also", session=0x82)
    here.session.receive(second.creation(), now_s=here.now_s)
    here.client = second
    assert here.do(second.connect())
    here.do(creations(second))
    for _ in range(4):
        here.run(here.now_s + RESTART_SILENCE_S / 2)
        for each in (first, second):
            each.send(0, 0, sub(board.ACKNACK, struct.pack("<HHB", each.last_handled + 1 & 0xFFFF, 0, 0x80)))
            here.session.receive(each.sent.pop(), now_s=here.now_s)
    here.link.loss = 1.0
    here.run(here.now_s + GONE_S + 2 * KEEPALIVE_S)
    assert [each.session for each in here.session._clients.values()] == [first.session, second.session]


def test_call_that_waits_for_a_board_that_restarts_is_forgotten() -> None:
    here = connected()
    here.session.call("/led", REQUEST)
    again = Client(key=b"new!")
    here.restart_board(again, idle())
    here.do(again.connect())
    assert here.session._calls == {}


def test_stream_of_a_client_that_is_deleted_at_once_is_not_acknowledged() -> None:
    session, client = MICRO_ROS_TCP.session(CATALOG), Client(key=KEY)
    framing = MICRO_ROS_TCP._framing()
    session.receive(framing.encode(client.creation()), now_s=0.0)
    client.put(sub(board.RESET, b""))
    client.send(0, 0, sub(board.DELETE, bytes.fromhex("0002FFFE")))
    session.receive(b"".join(map(framing.encode, client.sent)), now_s=0.0)
    frames = []
    while (outgoing := session.pop_frame(now_s=0.0, wall_ns=0)) is not None:
        frames.append(outgoing.frame[6])
    assert frames == [board.STATUS_AGENT, board.STATUS]


# -- objects ----------------------------------------------------------------------------------------------------------


def test_status_of_a_request_is_on_a_stream_like_its_own() -> None:
    here = connected()
    client = here.client
    assert here.do(client.create(0x31, board.participant("x"), 0, flags=1)) == 0
    assert here.do(client.create(0x31, board.participant("x"), 0, flags=1)) == 0x82
    assert here.do(client.delete(0x31)) == 0
    assert here.do(client.delete(0x31)) == 0x84
    assert here.do(client.create(0x32, b"\xff", 1)) == 0x85
    payload = struct.pack(">HH", 0x0777, 0x0999)
    client.put_best_effort(sub(board.DELETE, payload))
    here.do(client.listen(0.1))
    assert client.statuses[0x0777] == 0x84
    client.send(0, 0, sub(board.DELETE, struct.pack(">HH", 0x0778, 0x0999)))
    here.do(client.listen(0.1))
    assert client.statuses[0x0778] == 0x84


def test_objects_by_xml_and_reference_are_shown() -> None:
    here = world()
    client = here.client
    here.do(client.connect())

    def create() -> Program:
        for id_, text_, form in (
            (0x01, "<dds><participant><rtps><name>px4</name></rtps></participant></dds>", XML),
            (0x02, "<dds><topic><name>rt/a</name><dataType>std_msgs::msg::dds_::String_</dataType></topic></dds>", XML),
            (0x03, "", XML),
            (0x12, "odom__t", board.REFERENCE),
            (0x05, "<dds><data_writer><topic><name>rt/a</name></topic></data_writer></dds>", XML),
            (0x15, "odom__dw", board.REFERENCE),
        ):
            parent = 3 if id_ & 0xF == 5 else 1
            assert (yield from client.create(id_, text_.encode() + b"\0", parent, form=form)) == 0

    here.do(create())
    here.run(here.now_s + 2 * QUIET_S)
    assert [(each.name, each.type) for each in here.session.topics] == [
        ("/a", "std_msgs/String"),
        ("/odom", "unknown/unknown"),
    ]
    assert [each.name for each in here.session.raw_endpoints] == ["/odom"]
    client.publish_best_effort(0x15, b"raw bytes")
    here.do(client.listen(0.1))
    (received,) = of_kind(here, events.MessageReceived)
    assert received.payload == ENCAPSULATION + b"raw bytes"  # type: ignore[attr-defined]


def test_type_that_ros_2_has_changed_is_refused() -> None:
    here = world()
    client = here.client
    here.do(client.connect())

    def create() -> Program:
        for id_, content, parent in (
            (0x01, board.participant("n"), 0),
            (0x02, board.topic("rt/marker", "visualization_msgs::msg::dds_::Marker_"), 1),
            (0x03, b"\0\0", 1),
            (0x05, board.endpoint(0x02, is_reader=False), 3),
            (0x04, b"\0\0", 1),
            (0x06, board.endpoint(0x02, is_reader=True), 4),
        ):
            assert (yield from client.create(id_, content, parent)) == 0

    here.do(create())
    here.run(here.now_s + 2 * QUIET_S)
    assert here.session.topics == ()
    assert [event.topic.name for event in of_kind(here, events.TopicRefused)] == ["/marker"] * 2  # type: ignore[attr-defined]
    (writer, _), (reader, reason) = here.session.refusals
    assert here.session.is_refused(writer)
    assert isinstance(reason, WrongType)
    with pytest.raises(WrongType):
        here.session.publish("/marker", b"")
    here.do(client.publish(0x05, b"x"))
    assert here.session.counts.refused_frames == 1
    assert not here.session.is_refused(reader._replace(id=999))


def test_endpoints_above_the_bound_are_refused() -> None:
    here = world(session=made(max_topics=1))
    client = here.client
    here.do(client.connect())
    for id_, content, parent in (
        (0x01, board.participant("n"), 0),
        (0x02, board.topic("rt/a", "std_msgs::msg::dds_::String_"), 1),
        (REPLIER, board.service("led", SET_BOOL), 1),
    ):
        assert here.do(client.create(id_, content, parent)) == 0
    assert here.do(client.create(REQUESTER, board.service("ask", SET_BOOL), 1)) == 0x87
    here.run(here.now_s + 2 * QUIET_S)
    assert len(here.session.topics) == 1
    assert here.session.counts.excess_topics == 1
    assert here.session.excess_objects == 1


def test_object_that_changes_no_endpoint_is_not_announced() -> None:
    here = connected()
    here.do(here.client.create(0x31, board.participant("second"), 0))
    here.run(here.now_s + 2 * QUIET_S)
    assert here.session.counts.negotiations == 1
    assert len(of_kind(here, events.TopicsNegotiated)) == 1


def test_endpoints_of_all_clients_are_bounded_together() -> None:
    here = world(session=made(max_topics=1))
    for session, id_, name in ((0x81, REPLIER, "led"), (0x82, REQUESTER, "ask")):
        here.client = Client(key=KEY, session=session)
        here.client.now_s = here.now_s
        here.do(here.client.connect())
        assert here.do(here.client.create(0x01, board.participant("n"), 0)) == 0
        assert here.do(here.client.create(id_, board.service(name, SET_BOOL), 1)) == 0
    here.run(here.now_s + 2 * QUIET_S)
    here.do(here.client.publish(REQUESTER, b"\1"))
    assert of_kind(here, events.ServiceRequested) == []
    assert here.session.counts.refused_frames == 1


def test_service_of_an_unknown_type_is_passed_on_as_it_is() -> None:
    here = world()
    here.do(here.client.connect())
    here.do(here.client.create(0x01, board.participant("n"), 0))
    here.do(here.client.create(REQUESTER, board.service("ask", "my_package::srv::dds_::Ask"), 1))
    here.do(here.client.publish(REQUESTER, b"any"))
    (requested,) = of_kind(here, events.ServiceRequested)
    assert requested.payload == b"any"  # type: ignore[attr-defined]
    assert len(here.session.raw_endpoints) == 2


def test_answers_that_wait_for_room_are_bounded() -> None:
    here = connected()
    client = here.session._clients[0x81, b""]
    for _ in range(WAITING_MAX + 8):
        here.session._answer(client, 0x80, b"status")
    assert len(client.waiting) == WAITING_MAX


def test_published_message_completes_the_announcement() -> None:
    here = world()
    here.do(here.client.connect())

    def begin() -> Program:
        yield from creations(here.client)
        yield from here.client.publish(WRITER, cdr("std_msgs/String", {"data": "first"}))

    here.do(begin())
    assert [type(event) for _, event in here.found] == [events.TopicsNegotiated, events.MessageReceived]


INT32, STAMPED = "std_msgs::msg::dds_::Int32_", "geometry_msgs::msg::dds_::TwistStamped_"
CHATTER, CMD_VEL, VELOCITY_SUBSCRIBER = 0x02, 0x12, 0x04


def changed(here: World, id_: int, topic: int, name: str, type_: str, *, is_deleted: bool, with_endpoint: bool) -> None:
    """Give a topic another type, as the stock library does with its flags; or delete all first."""
    group = NODE_PUBLISHER if id_ & 0xF == WRITER else VELOCITY_SUBSCRIBER
    if is_deleted:
        for each in (id_, topic):
            assert here.do(here.client.delete(each)) == 0
    assert here.do(here.client.create(topic, board.topic(name, type_), 1)) == 0
    if with_endpoint or is_deleted:
        assert here.do(here.client.create(id_, board.endpoint(topic, is_reader=id_ & 0xF == READER), group)) in {0, 1}


CHANGES = pytest.mark.parametrize(("is_deleted", "with_endpoint"), [(True, True), (False, True), (False, False)])


@CHANGES
def test_topic_of_a_writer_that_changes_its_type_is_announced_anew(*, is_deleted: bool, with_endpoint: bool) -> None:
    here = connected()
    here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"})))
    changed(here, WRITER, CHATTER, "rt/chatter", INT32, is_deleted=is_deleted, with_endpoint=with_endpoint)
    here.do(here.client.publish(WRITER, struct.pack("<i", 7)))
    here.run(here.now_s + 2 * QUIET_S)
    first, second = of_kind(here, events.TopicsNegotiated)
    assert second.is_changed  # type: ignore[attr-defined]
    types = [[each.type for each in one.topics if each.name == "/chatter"] for one in (first, second)]  # type: ignore[attr-defined]
    assert types == [["std_msgs/String"], ["std_msgs/Int32"]]
    received = [(each.topic.type, each.payload) for each in of_kind(here, events.MessageReceived)]  # type: ignore[attr-defined]
    assert received == [("std_msgs/String", b"\1\0\0\0a"), ("std_msgs/Int32", struct.pack("<i", 7))]


@CHANGES
def test_reader_that_changes_its_type_gets_nothing_of_the_type_before(*, is_deleted: bool, with_endpoint: bool) -> None:
    """A TwistStamped that is read as a Twist would be a velocity of any size."""
    here = connected()
    velocity = here.session.endpoint_of("/cmd_vel", ZERO)
    assert here.session.send_zero(velocity, ZERO)
    here.session.publish("/cmd_vel", ZERO)
    assert here.session.outbox.has_urgent
    changed(here, READER, CMD_VEL, "rt/cmd_vel", STAMPED, is_deleted=is_deleted, with_endpoint=with_endpoint)
    here.client.read_data(READER)
    here.do(here.client.confirm(0.05))
    before = len(taken(here, READER))
    assert not here.session.outbox.has_urgent
    assert not here.session.has(velocity)
    assert not here.session.may_have(velocity)
    assert not here.session.send_zero(velocity, ZERO)
    with pytest.raises(UnknownTopic, match="created it again with another name or type, which is announced within a"):
        here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.run(here.now_s + 2 * QUIET_S)
    now = next(each for each in here.session.topics if each.name == "/cmd_vel")
    assert (now.type, here.session.has(now)) == ("geometry_msgs/TwistStamped", True)
    assert not here.session.may_have(velocity)
    here.run(here.now_s + 1.0)
    assert len(taken(here, READER)) == before  # no zero is repeated
    with pytest.raises(WrongType):
        here.session.publish("/cmd_vel", VELOCITY[:-1], is_urgent=True)


# -- messages ---------------------------------------------------------------------------------------------------------


def test_message_of_the_board_is_translated() -> None:
    here = connected()
    result = here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "hello"})))
    assert result.is_done
    (received,) = of_kind(here, events.MessageReceived)
    assert received.payload == b"\5\0\0\0hello"  # type: ignore[attr-defined]


def test_long_message_arrives_in_fragments_both_ways() -> None:
    here = connected()
    assert here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "x" * 1500}))).is_done
    (received,) = of_kind(here, events.MessageReceived)
    assert received.payload[4:] == b"x" * 1500  # type: ignore[attr-defined]
    here.session.publish("/words", struct.pack("<I", 1500) + b"y" * 1500)
    here.write()
    here.do(here.client.listen(0.1))
    here.run(here.now_s + 0.1)
    assert [text_of(each) for each in taken(here, 0x16)] == ["y" * 1500]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_long_message_is_taken_by_a_board_whose_history_holds_it(loss: float) -> None:
    here = connected(Client(key=KEY, history=8))
    here.link.loss = loss
    here.session.publish("/words", struct.pack("<I", 3500) + b"y" * 3500)
    here.write()
    here.run(here.now_s + 5.0)
    assert [text_of(each) for each in taken(here, 0x16)] == ["y" * 3500]
    assert here.session.too_long_messages == 0
    here.session.publish("/words", struct.pack("<I", 1) + b"z")
    here.run(here.now_s + 2.0)
    assert text_of(taken(here, 0x16)[-1]) == "z"


def test_message_that_is_longer_than_the_history_of_the_board_is_dropped_and_the_next_one_arrives() -> None:
    here = connected()
    here.session.publish("/words", struct.pack("<I", 2500) + b"y" * 2500)
    here.session.publish("/words", struct.pack("<I", 1) + b"z")
    here.write()
    here.run(here.now_s + 2.0)
    assert [text_of(each) for each in taken(here, 0x16)] == ["z"]
    assert here.session.too_long_messages == 1
    with pytest.raises(FrameTooLarge):
        here.session.publish("/words", struct.pack("<I", 2600) + b"y" * 2600)
    assert "/words" in here.session.too_large


def test_message_that_the_board_never_answers_is_given_up() -> None:
    here = connected()
    here.link.loss = 1.0
    here.session.publish("/words", struct.pack("<I", 2500) + b"y" * 2500)
    here.run(here.now_s + 10.0)
    assert here.session.too_long_messages == 1
    assert here.session.deadline_s() > here.now_s


@pytest.mark.parametrize(("history", "size"), [(1, 600), (1, 1900), (2, 1300), (2, 1900), (3, 1900)])
def test_message_of_few_fragments_is_refused_by_a_board_with_a_shorter_history(history: int, size: int) -> None:
    here = world(Client(key=KEY, history=history))
    here.do(here.client.connect())
    here.do(creations(here.client))
    here.client.read_data(0x16)
    here.run(here.now_s + 2 * QUIET_S)
    here.session.publish("/words", struct.pack("<I", size) + b"y" * size)
    here.write()
    sent = len(here.frames)
    here.run(here.now_s + 5.0)
    assert len(here.frames) - sent < 20
    here.session.publish("/words", struct.pack("<I", 1) + b"z")
    here.write()
    here.run(here.now_s + 1.0)
    assert [text_of(each) for each in taken(here, 0x16)] == ["z"]
    assert here.session.too_long_messages == 1
    words = next(each for each in here.session.topics if each.name == "/words")
    assert here.session.too_large == str(FrameTooLarge("/words", size + 5, here.session.room_bytes(words)))
    with pytest.raises(FrameTooLarge):
        here.session.publish("/words", struct.pack("<I", size) + b"y" * size)


def long_service() -> World:
    """A board that has a service of a type without a definition, and a history of two messages."""
    here = world(Client(key=KEY, history=2))
    client = here.client
    here.do(client.connect())
    here.do(client.create(0x01, board.participant("/ns/base"), 0))
    here.do(client.create(REPLIER, board.service("led", "my_msgs::srv::dds_::Long"), 1))
    client.read_data(REPLIER)
    here.run(here.now_s + 2 * QUIET_S)
    return here


def test_request_that_is_longer_than_the_history_of_the_board_fails_at_once() -> None:
    here = long_service()
    first = here.session.call("/led", b"x" * 1200)
    here.write()
    here.run(here.now_s + 0.1)
    (refused,) = of_kind(here, events.ResponseRefused)
    assert isinstance(refused, events.ResponseRefused)
    assert refused.service.name == "/led"
    assert refused.request == first
    assert isinstance(refused.reason, FrameTooLarge)
    with pytest.raises(FrameTooLarge):
        here.session.call("/led", b"x" * 1200)


def test_long_request_to_a_service_that_is_deleted_meanwhile_is_dropped() -> None:
    here = long_service()
    here.session.call("/led", b"x" * 1200)
    here.session._by_key.clear()
    here.write()
    here.run(here.now_s + 0.1)
    assert of_kind(here, events.ResponseRefused) == []
    assert here.session.too_long_messages == 1


def test_long_message_that_is_not_answered_does_not_show_a_short_history() -> None:
    here = connected(Client(key=KEY, history=8))
    here.link.loss = 1.0
    text = struct.pack("<I", 3500) + b"y" * 3500
    here.session.publish("/words", text)
    here.write()
    here.run(here.now_s + 10.0)
    assert here.session.too_long_messages == 1
    assert here.session.too_large == ""
    here.link.loss = 0.0
    here.session.publish("/words", text)
    here.write()
    here.run(here.now_s + 2.0)
    assert [len(text_of(each)) for each in taken(here, 0x16)] == [3500]


def test_long_request_that_is_not_answered_fails() -> None:
    here = long_service()
    here.link.loss = 1.0
    first = here.session.call("/led", b"x" * 1200)
    here.write()
    here.run(here.now_s + 10.0)
    (refused,) = of_kind(here, events.ResponseRefused)
    assert isinstance(refused, events.ResponseRefused)
    assert refused.request == first
    assert str(refused.reason) == "/led: its board answered nothing about a long message, which was dropped"


@pytest.mark.parametrize("size", [1, 1500, 3500])
@pytest.mark.parametrize("seed", range(5))
def test_board_that_only_listens_gets_every_message_at_a_loss_of_20_percent(seed: int, size: int) -> None:
    here = connected(Client(key=KEY, history=8))
    here.link.loss, here.link.random = 0.2, Random(seed)
    texts = [bytes((each,)) * size for each in b"abcdefgh"]
    for each in texts:
        here.session.publish("/words", struct.pack("<I", size) + each, depth=len(texts))
        here.write()
    here.run(here.now_s + 60.0)
    assert [text_of(each) for each in taken(here, 0x16)] == [each.decode() for each in texts]


def test_board_that_answers_nothing_is_asked_with_growing_pauses() -> None:
    here = connected()
    here.link.loss, began_s = 1.0, here.now_s
    here.session.publish("/words", struct.pack("<I", 1) + b"z")
    here.write()
    here.run(here.now_s + 20.0)
    times_s = [at_s for at_s, frame in here.frames if frame[4] == board.HEARTBEAT and at_s > began_s]
    pauses_s = [after_s - before_s for before_s, after_s in itertools.pairwise(times_s)]
    assert pauses_s == pytest.approx(sorted(pauses_s))
    assert pauses_s[0] < 0.2
    assert pauses_s[-1] == pytest.approx(HEARTBEAT_MAX_S)


def test_long_message_waits_until_nothing_is_to_be_acknowledged() -> None:
    here = connected(Client(key=KEY, history=8))
    here.session.publish("/words", struct.pack("<I", 1) + b"a", depth=2)
    here.session.publish("/words", struct.pack("<I", 3500) + b"y" * 3500, depth=2)
    here.write()
    here.run(here.now_s + 2.0)
    assert [len(text_of(each)) for each in taken(here, 0x16)] == [1, 3500]


@pytest.mark.parametrize("stream", [0, 1, 0x80])
def test_message_to_the_board_is_on_the_stream_that_it_wants(stream: int) -> None:
    here = connected(stream=stream)
    before = len(here.frames)
    for number in range(5):
        here.session.publish("/words", struct.pack("<I", 1) + b"%d" % number, depth=5)
    here.write()
    here.run(here.now_s + 1.0)
    here.do(here.client.listen(0.1))
    streams = {frame[1] for _, frame in here.frames[before:] if b"\x09" in (frame[4:5], frame[16:17], frame[28:29])}
    assert streams == {stream}
    assert [text_of(each) for each in taken(here, 0x16)] == list("01234")


def test_newest_messages_wait_for_the_history_of_the_board() -> None:
    here = connected()
    here.session.outbox.replaced = 0
    for number in range(12):
        here.session.publish("/words", struct.pack("<I", 2) + b"%02d" % number, depth=3)
    here.write()
    here.run(here.now_s + 1.0)
    assert [text_of(each) for each in taken(here, 0x16)] == ["00", "01", "02", "03", "09", "10", "11"]
    assert here.session.outbox.replaced == 5


def test_velocity_is_one_message_without_a_number_and_is_not_sent_again() -> None:
    here = connected()
    here.frames.clear()
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.session.publish("/cmd_vel", ZERO, is_urgent=True)
    here.write()
    assert [frame[:4] for _, frame in here.frames] == [b"\x81\0\0\0"]
    here.do(here.client.listen(1.0))
    assert taken(here, READER) == [ZERO]
    assert here.session.outbox.replaced == 1


def test_velocity_that_fits_no_message_is_refused() -> None:
    here = connected(Client(key=KEY, mtu=60))
    with pytest.raises(FrameTooLarge):
        here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    assert "/cmd_vel" in here.session.too_large


def test_payload_that_is_not_of_the_type_is_refused_on_both_sides() -> None:
    here = connected()
    with pytest.raises(WrongType, match="/cmd_vel"):
        here.session.publish("/cmd_vel", b"x", is_urgent=True)
    here.do(here.client.publish(WRITER, b"x"))
    assert here.session.wrong_sizes == 1
    assert here.session.rejected == {"wrong_size": 1}
    assert of_kind(here, events.MessageReceived) == []


def test_payload_that_is_not_of_the_type_is_refused_also_while_the_board_creates_more() -> None:
    here = connected()
    here.do(here.client.create(0x32, board.topic("rt/more", "std_msgs::msg::dds_::String_"), 1))
    here.do(here.client.publish(WRITER, b"x"))
    assert here.session.wrong_sizes == 1
    assert of_kind(here, events.MessageReceived) == []


def test_message_to_an_unknown_topic_is_refused_with_the_known_ones() -> None:
    here = connected()
    with pytest.raises(UnknownTopic, match="known: /cmd_vel, /words"):
        here.session.publish("/other", b"")
    assert here.session.endpoint_of("/cmd_vel", VELOCITY).name == "/cmd_vel"


def test_message_that_would_delay_a_stop_on_a_slow_line_is_refused_while_the_robot_moves() -> None:
    here = connected(session=made(uart_bytes_s=11520))
    here.session.outbox.robot_moves = True
    with pytest.raises(FrameTooLarge, match="while the robot moves"):
        here.session.publish("/words", struct.pack("<I", 200) + b"y" * 200)
    with pytest.raises(FrameTooLarge, match="while the robot moves"):
        here.session._check_prompt(here.session.topics[0], 500)


# -- flow control -----------------------------------------------------------------------------------------------------


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def publish_every(here: World, period_s: float, count: int) -> None:
    for number in range(count):
        here.at(
            here.now_s + number * period_s,
            lambda number=number: here.session.publish("/words", text(str(number)), depth=1),
        )  # type: ignore[misc]


def times(here: World) -> list[float]:
    return [at_s for at_s, object_, _, _ in here.client.taken if object_ == 0x16]


def asked(here: World, **control: int) -> None:
    here.client.read_data(0x16, **control)
    here.do(here.client.confirm(1.0))


def test_reader_that_wants_samples_gets_as_many() -> None:
    here = connected()
    asked(here, samples=2)
    publish_every(here, 0.01, 5)
    here.run(here.now_s + 1.0)
    assert len(times(here)) == 2
    assert here.session.quality.unread == 3


def test_reader_that_wants_messages_for_a_time_gets_no_more_afterwards() -> None:
    here = connected()
    asked(here, seconds=1)
    began_s = here.now_s
    publish_every(here, 0.25, 10)
    here.run(here.now_s + 4.0)
    assert 3 <= len(times(here)) <= 5
    assert max(times(here)) < began_s + 1.1


def test_reader_that_wants_a_pace_gets_the_newest_at_it() -> None:
    here = connected()
    asked(here, pace_ms=200)
    publish_every(here, 0.01, 100)
    here.run(here.now_s + 2.0)
    gaps = [second - first for first, second in zip(times(here), times(here)[1:], strict=False)]
    assert min(gaps) >= 0.199
    assert text_of(taken(here, 0x16)[-1]) == "99"


def test_reader_that_wants_bytes_a_second_gets_no_more() -> None:
    here = connected()
    asked(here, bytes_s=60)
    publish_every(here, 0.01, 100)
    here.run(here.now_s + 2.0)
    assert 5 <= len(times(here)) <= 25


def test_reader_that_cancels_gets_nothing() -> None:
    here = connected()
    asked(here, samples=0)
    publish_every(here, 0.01, 3)
    here.run(here.now_s + 1.0)
    assert times(here) == []


def test_message_waits_until_its_reader_asks() -> None:
    here = connected()
    here.do(here.client.create(0x26, board.endpoint(0x22, is_reader=True), 4))
    here.do(here.client.delete(0x16))
    here.run(here.now_s + 2 * QUIET_S)
    here.session.publish("/words", text("waits"))
    here.run(here.now_s + 1.0)
    assert taken(here, 0x26) == []
    here.client.read_data(0x26)
    here.do(here.client.confirm(1.0))
    here.do(here.client.listen(0.5))
    assert [text_of(each) for each in taken(here, 0x26)] == ["waits"]


def test_reader_that_is_deleted_leaves_nothing() -> None:
    here = connected()
    client = here.session._clients[0x81, b""]
    here.do(here.client.delete(0x16))
    assert 0x16 not in client.readings
    assert 0x16 not in client.reads
    with pytest.raises(UnknownTopic):
        here.session.publish("/words", text("a"))


def test_request_about_an_unknown_reader_is_answered() -> None:
    here = connected()
    request = here.client.read_data(0x996)
    here.do(here.client.listen(1.0))
    here.do(here.client.listen(1.0))
    assert here.client.statuses[request] == 0x84


# -- services ---------------------------------------------------------------------------------------------------------

REQUEST, RESPONSE = b"\1", b"\1\2\0\0\0ok"
RESPONSE_CDR = b"\1\0\0\0\3\0\0\0ok\0"


def answered(client: Client, count: int = 1) -> list[bytes]:
    """Let the board answer the requests to its service. Return the identities."""
    found = [payload for _, object_, _, payload in client.taken if object_ == REPLIER]
    for payload in found[-count:]:
        client.put(sub(board.WRITE, struct.pack(">HH", client.request(), REPLIER) + payload[:24] + RESPONSE_CDR))
    return found


def test_service_of_the_board_is_called_with_the_request_that_it_asked_for() -> None:
    here = connected()
    here.session.call("/led", REQUEST)
    here.write()
    here.do(here.client.listen(1.0))
    (found,) = answered(here.client)
    assert found[24:] == b"\1"
    here.do(here.client.confirm(1.0))
    (responded,) = of_kind(here, events.ServiceResponded)
    assert responded.payload == RESPONSE  # type: ignore[attr-defined]
    request = next(each[2] for each in here.client.taken if each[1] == REPLIER)
    assert request == here.session._clients[0x81, b""].request_of(REPLIER)
    assert here.session.service_endpoint("/led", REQUEST).kind is EndpointKind.SERVICE_SERVER_SUBSCRIBER


def test_response_that_arrives_twice_or_without_a_call_is_dropped() -> None:
    here = connected()
    for _ in range(2):
        here.session.call("/led", REQUEST)
    here.write()
    here.run(here.now_s + 0.5)
    answered(here.client, 1)  # the second: the first is no longer answered
    answered(here.client, 2)
    here.do(here.client.confirm(1.0))
    assert len(of_kind(here, events.ServiceResponded)) == 1
    assert here.session.counts.refused_frames == 3


@pytest.mark.parametrize("content", [b"", b"\1", RESPONSE_CDR + b"zzzzzzzz", b"\1\0\0\0\xff\xff\xff\xffabc"])
def test_undecodable_response_is_counted_and_reported_with_the_reason(content: bytes) -> None:
    here = connected()
    request = here.session.call("/led", REQUEST)
    here.write()
    here.do(here.client.listen(1.0))
    identity = taken(here, REPLIER)[0][:24]
    here.do(here.client.publish(REPLIER, identity + content))
    assert here.session.wrong_sizes == here.session.rejected["wrong_size"] == 1
    (refused,) = of_kind(here, events.ResponseRefused)
    assert isinstance(refused, events.ResponseRefused)
    assert (refused.service.name, refused.request) == ("/led", request)
    assert isinstance(refused.reason, BadPayload)
    assert "std_srvs/SetBool" in str(refused.reason)
    here.do(here.client.publish(REPLIER, identity + RESPONSE_CDR))  # a second answer to this request
    assert of_kind(here, events.ServiceResponded) == []


@pytest.mark.parametrize("first", [5, 2**32 - 1, 2**32, 2**40 + 7])
def test_calls_are_numbered_from_the_given_number_and_none_has_that_of_a_zero(first: int) -> None:
    here = connected()
    here.session.number_calls(first)
    for _ in range(3):
        here.session.call("/led", REQUEST)
        here.write()
        here.run(here.now_s + 0.5)
        answered(here.client)
        here.do(here.client.confirm(1.0))
    numbers = [int.from_bytes(payload[20:24], "little") for payload in taken(here, REPLIER)]
    assert len(set(numbers)) == len(of_kind(here, events.ServiceResponded)) == 3
    assert 0 not in numbers
    assert numbers[0] == first or first >= 2**32


def test_calls_that_wait_are_bounded() -> None:
    here = connected()
    here.session._clients[0x81, b""].output.window = 0  # the board reads nothing
    for _ in range(CALLS_MAX):
        here.session.call("/led", REQUEST)
    with pytest.raises(DeviceBusy):
        here.session.call("/led", REQUEST)


def test_service_that_has_answered_no_call_so_far_is_called_again() -> None:
    here = connected()
    for _ in range(3 * CALLS_MAX):
        identity = here.session.call("/led", REQUEST)
        here.write()
        here.do(here.client.listen(0.2))
    answered(here.client)
    here.do(here.client.confirm(1.0))
    (responded,) = of_kind(here, events.ServiceResponded)
    assert responded.request == identity  # type: ignore[attr-defined]


def test_board_calls_a_service_and_gets_the_response_to_its_request() -> None:
    here = connected()
    client = here.client
    client.put(sub(board.WRITE, struct.pack(">HH", 0x0055, REQUESTER) + b"\1"))
    here.do(client.confirm(1.0))
    (requested,) = of_kind(here, events.ServiceRequested)
    assert requested.payload == REQUEST  # type: ignore[attr-defined]
    response = here.session.response_endpoint(requested.service)  # type: ignore[attr-defined]
    here.session.respond(response, RESPONSE, request=requested.request)  # type: ignore[attr-defined]
    here.write()
    here.do(client.listen(1.0))
    assert taken(here, REQUESTER) == [struct.pack(">HH", 0x0055, REQUESTER) + RESPONSE_CDR]
    for request in (requested.request, None, b"another"):  # type: ignore[attr-defined]
        with pytest.raises(UnknownTopic):
            here.session.respond(response, RESPONSE, request=request)


def called(here: World, count: int = 1) -> list[events.ServiceRequested]:
    """Let the board call its service, and return the events of these calls."""
    before = len(of_kind(here, events.ServiceRequested))
    for _ in range(count):
        here.do(here.client.publish(REQUESTER, b"\1"))
    return [
        each for each in of_kind(here, events.ServiceRequested)[before:] if isinstance(each, events.ServiceRequested)
    ]


def respond(here: World, requested: events.ServiceRequested, payload: bytes | None = RESPONSE) -> None:
    """Answer a call of the board."""
    here.session.respond(here.session.response_endpoint(requested.service), payload, request=requested.request)
    here.write()


def test_responses_in_another_order_go_to_the_requests_that_they_are_for() -> None:
    here = connected()
    calls = called(here, 3)
    for at in (2, 0, 1):
        respond(here, calls[at], struct.pack("<BI1s", 1, 1, b"abc"[at : at + 1]))
    here.do(here.client.listen(1.0))
    first = int.from_bytes(calls[0].request[-4:-2])  # type: ignore[index]
    found = {int.from_bytes(payload[:2]) - first: payload[-2:-1] for payload in taken(here, REQUESTER)}
    assert found == {0: b"a", 1: b"b", 2: b"c"}


@pytest.mark.parametrize("key", [KEY, b"anew"])
def test_board_that_begins_anew_waits_for_no_response_to_its_request_of_before(key: bytes) -> None:
    here = connected()
    (before,) = called(here)
    assert before.request is not None
    assert here.session.is_waiting_for(before.service, before.request)
    here.client = Client(key=key)
    here.run(here.now_s + RESTART_SILENCE_S)
    assert here.do(here.client.connect())
    here.do(creations(here.client))
    here.run(here.now_s + 2 * QUIET_S)
    (now,) = called(here)
    assert now.service == before.service
    assert now.request is not None
    assert not here.session.is_waiting_for(before.service, before.request)
    assert here.session.is_waiting_for(now.service, now.request)
    with pytest.raises(UnknownTopic):
        respond(here, before)


def test_board_that_deletes_its_service_client_waits_for_no_response() -> None:
    here = connected()
    (requested,) = called(here)
    here.do(here.client.delete(REQUESTER))
    assert requested.request is not None
    assert not here.session.is_waiting_for(requested.service, requested.request)
    assert not here.session._clients[0x81, b""].calls


def test_request_that_is_left_unanswered_takes_no_place_of_another() -> None:
    here = connected()
    for _ in range(2 * CALLS_MAX):
        (requested,) = called(here)
        assert requested.request is not None
        here.session.leave_unanswered(requested.service, requested.request)
        assert not here.session.is_waiting_for(requested.service, requested.request)
    assert here.session.counts.refused_frames == 0


def test_request_of_a_client_that_is_gone_may_be_left_unanswered() -> None:
    here = connected()
    (requested,) = called(here)
    assert requested.request is not None
    del here.session._clients[0x81, b""]
    here.session.leave_unanswered(requested.service, requested.request)
    assert not here.session.is_waiting_for(requested.service, requested.request)


def test_every_request_that_is_accepted_has_room_for_its_response() -> None:
    here = connected()
    client = here.session._clients[0x81, b""]
    client.output.window = 0  # the board reads nothing
    for each in called(here, CALLS_MAX // 2):
        respond(here, each)
    calls = called(here, CALLS_MAX)
    assert len(calls) == CALLS_MAX // 2
    for each in calls:
        respond(here, each)


def test_response_of_an_unknown_layout_is_zeros() -> None:
    here = connected()
    respond(here, *called(here), None)
    here.do(here.client.listen(1.0))
    assert not any(taken(here, REQUESTER)[0][4:])


def test_requests_of_the_board_that_wait_are_bounded_and_damaged_ones_are_dropped() -> None:
    here = connected()
    here.do(here.client.publish(REQUESTER, b""))
    for _ in range(CALLS_MAX + 1):
        here.do(here.client.publish(REQUESTER, b"\1"))
    assert len(of_kind(here, events.ServiceRequested)) == CALLS_MAX
    assert here.session.counts.refused_frames == 2


def test_responses_that_wait_are_bounded() -> None:
    here = connected()
    response = next(each for each in here.session.topics if each.kind is EndpointKind.SERVICE_CLIENT_SUBSCRIBER)
    client = here.session._clients[0x81, b""]
    client.output.window = 0
    for _ in range(CALLS_MAX):
        here.session._put_sample(client, response, b"x")
    with pytest.raises(DeviceBusy):
        here.session._put_sample(client, response, b"x")


def test_endpoint_without_responses_is_refused() -> None:
    here = connected()
    velocity = here.session.endpoint_of("/cmd_vel", VELOCITY)
    with pytest.raises(UnknownTopic):
        here.session.response_endpoint(velocity)


def test_board_that_is_created_again_gets_no_number_of_its_session_before() -> None:
    """A client that gets one counts through thousands of numbers, and forgets its own."""
    here = connected()
    for _ in range(20):
        here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "x"})))
    here.client = Client(key=KEY)
    here.restart_board(here.client, idle())
    assert here.do(here.client.connect())
    here.run(here.now_s + 0.2)
    here.session.send_zero(here.session._known[1], ZERO)
    here.write()
    here.do(here.client.listen(0.3))  # the client of the test asserts that each number was sent
    here.do(creations(here.client))


def test_late_creation_of_a_session_that_continues_stops_no_acknowledgement() -> None:
    here = connected()
    here._to_host(here.client.creation())  # a datagram that came twice
    here.link.loss = 1.0
    here.client.put(sub(board.WRITE, struct.pack(">HH", 9, WRITER) + cdr("std_msgs/String", {"data": "x"})))
    here.do(here.client.confirm(0.05))
    here.link.loss = 0.0
    assert here.do(here.client.confirm(1.0))


def test_number_of_a_long_session_shows_after_a_late_creation_that_it_continues() -> None:
    here = connected()
    for _ in range(WINDOW):
        here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "x"})))
    before = len(of_kind(here, events.MessageReceived))
    here._to_host(here.client.creation())  # a datagram that came twice
    assert here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "y"}))).is_done
    assert len(of_kind(here, events.MessageReceived)) == before + 1
    assert here.session.quality.restarts == 0
    assert len(of_kind(here, events.TopicsNegotiated)) == 1


def test_heartbeat_far_from_either_session_decides_nothing_after_a_late_creation() -> None:
    here = connected()
    here._to_host(here.client.creation())
    here.client.send(0, 0, sub(board.HEARTBEAT, struct.pack("<HHB", 5000, 5001, 0x80)))
    here._to_host(here.client.sent.pop())
    assert here.session.quality.restarts == 0
    assert here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "y"}))).is_done


def begun_again(*, after_s: float) -> World:
    """A board with a text on its way that restarts with its key. It has not created anything."""
    here = connected()
    here.run(here.now_s + after_s)
    here.link.loss = 1.0
    here.session.publish("/words", struct.pack("<I", 3) + b"old")
    here.write()
    here.link.loss = 0.0
    here.client = Client(key=KEY)
    here.restart_board(here.client, idle())
    assert here.do(here.client.connect(attempts=1))
    return here


@pytest.mark.parametrize("after_s", [0.0, 3.0])
def test_board_that_restarts_with_its_key_gets_no_message_of_its_session_before(after_s: float) -> None:
    here = begun_again(after_s=after_s)
    here.client.send(0, 0, sub(board.ACKNACK, struct.pack("<HHB", 0, 0xFFFF, 0x80)))
    here._to_host(here.client.sent.pop())
    here.session.probe()
    here.session.send_zero(here.session._known[1], ZERO)
    with contextlib.suppress(UnknownTopic):  # it is announced only if it may be the same session
        here.session.publish("/words", struct.pack("<I", 3) + b"two")
    here.write()
    here.run(here.now_s + 0.3)
    here.do(creations(here.client))
    here.run(here.now_s + 2 * QUIET_S)
    here.session.publish("/words", struct.pack("<I", 3) + b"new")
    here.write()
    here.run(here.now_s + 1.0)
    assert [text_of(each) for each in taken(here, 0x16)][-1:] == ["new"]
    assert "old" not in [text_of(each) for each in taken(here, 0x16)]
    assert here.client.old_acknacks == 0


@pytest.mark.parametrize("lost", [1, 3])
def test_first_messages_of_a_board_that_restarts_are_lost_and_sent_again(lost: int) -> None:
    here = begun_again(after_s=0.0)
    client = here.client
    for _ in range(4):
        client.put(client.creating(0x01, board.participant("/ns/base"), 0)[1])
    sent, client.sent = client.sent[lost:], []
    for each in sent:
        here._to_host(each)
    here.do(client.listen(0.05))
    assert client.old_acknacks == 0
    assert here.do(client.confirm(2.0))  # the client of the test asserts that each number was sent
    assert here.session.quality.restarts == 1


def test_board_that_restarts_and_falls_silent_has_begun_anew() -> None:
    here = begun_again(after_s=0.0)
    client = here.client
    for _ in range(2):
        client.put(client.creating(0x01, board.participant("/ns/base"), 0)[1])
    here._to_host(client.sent[1])
    client.sent = []
    here.run(here.now_s + 2 * KEEPALIVE_S)
    assert here.session.quality.restarts == 1


def test_board_that_restarts_and_creates_its_first_object_late_gets_its_status() -> None:
    here = begun_again(after_s=0.0)
    here.run(here.now_s + 1.6 * KEEPALIVE_S)
    assert here.do(here.client.create(0x01, board.participant("/ns/base"), 0)) in {0, 1}
    assert here.client.old_acknacks == 0
    assert here.session.quality.restarts == 1


def test_board_that_restarts_is_not_announced_before_it_has_created_its_objects() -> None:
    """The hub sends zeros and latched messages when a board is announced: a board without readers drops them."""
    here = begun_again(after_s=3.0)
    before = len(of_kind(here, events.TopicsNegotiated))
    here.run(here.now_s + 3 * QUIET_S)
    with pytest.raises(UnknownTopic, match="has begun anew"):
        here.session.publish("/words", struct.pack("<I", 3) + b"new")
    here.do(creations(here.client))
    here.run(here.now_s + 2 * QUIET_S)
    assert len(of_kind(here, events.TopicsNegotiated)) == before + 1
    here.session.publish("/words", struct.pack("<I", 3) + b"new")


def test_board_that_only_listens_gets_messages_after_a_late_creation() -> None:
    here = connected()
    here._to_host(here.client.creation())  # a datagram that came twice
    here.run(here.now_s + 2 * KEEPALIVE_S)
    here.session.publish("/words", struct.pack("<I", 3) + b"new")
    here.write()
    here.run(here.now_s + 2.0)
    assert [text_of(each) for each in taken(here, 0x16)] == ["new"]
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.write()
    here.run(here.now_s + 0.1)
    assert taken(here, READER) == [VELOCITY]


@pytest.mark.parametrize("key", [KEY, b"\5\6\7\x08"])
def test_board_that_has_begun_anew_gets_no_velocity_before_it_is_announced(key: bytes) -> None:
    """The hub knows nothing of the restart yet: the driver's next velocity would move a board that has just booted."""
    here = connected()
    velocity = here.session.endpoint_of("/cmd_vel", VELOCITY)
    here.client = Client(key=key)
    here.restart_board(here.client, idle())
    assert here.do(here.client.connect())
    here.do(creations(here.client))
    with pytest.raises(
        UnknownTopic, match="no topic named /cmd_vel: its board has begun anew and has not announced it"
    ):
        here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    assert here.session.send_zero(velocity, ZERO)
    here.write()
    here.run(here.now_s + 0.05)
    assert taken(here, READER) == [ZERO]
    here.run(here.now_s + 2 * QUIET_S)
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)


@pytest.mark.parametrize("is_resumed", [False, True])
@pytest.mark.parametrize("key", [KEY, b"\xaa\xaa\xbb\xbb"])
def test_board_with_another_program_takes_velocities_at_the_reader_of_that_program(
    key: bytes, is_resumed: bool
) -> None:
    """The key is fixed in many programs. The objects of the program before stay, as with the agent."""
    here = connected(Client(key=key))
    if is_resumed:
        here = restarted(here)
    here.client = Client(key=key)
    here.restart_board(here.client, idle())
    here.run(here.now_s + LATE_CREATION_S)
    assert here.do(here.client.connect())
    for id_, content, parent in (
        (0x01, board.participant("/ns/base"), 0),
        (0x32, board.topic("rt/cmd_vel", "geometry_msgs::msg::dds_::Twist_"), 1),
        (0x04, b"\0\0", 1),
        (0x26, board.endpoint(0x32, is_reader=True), 4),
    ):
        assert here.do(here.client.create(id_, content, parent)) in {0, 1}
    here.client.read_data(0x26, 0x80)
    here.do(here.client.confirm(1.0))
    here.run(here.now_s + 2 * QUIET_S)
    (velocity,) = [each for each in here.session.topics if each.name == "/cmd_vel"]
    assert here.session.endpoint_of("/cmd_vel", VELOCITY) == velocity
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.write()
    here.run(here.now_s + 0.05)
    assert taken(here, 0x26) == [VELOCITY]
    assert taken(here, READER) == []
    assert {each.name for each in here.session.topics} >= {"/words", "/chatter"}


# -- stopping ---------------------------------------------------------------------------------------------------------


def test_zero_frame_is_constant_and_taken_at_any_time() -> None:
    here = connected()
    velocity = here.session.endpoint_of("/cmd_vel", VELOCITY)
    (frame,) = here.session.zero_frames(velocity, ZERO)
    assert (len(frame), frame[:4], frame[-48:]) == (60, b"\x81\0\0\0", ZERO)
    here.run(here.now_s + 60.0)
    assert here.session.zero_frames(velocity, ZERO) == (frame,)
    here._to_board(frame)
    here.do(here.client.listen(0.1))
    assert taken(here, READER) == [ZERO]
    stop = here.session.stop_frames((frame, frame))
    assert (stop.end, stop.claim_bytes, stop.last_writes) == (b"", 0, (frame, frame))


def test_zero_frame_of_a_service_calls_it() -> None:
    here = connected()
    led = here.session.service_endpoint("/led", REQUEST)
    here._to_board(*here.session.zero_frames(led, REQUEST))
    here.do(here.client.listen(0.1))
    assert [each[24:] for each in taken(here, REPLIER)] == [b"\1"]
    assert here.session.send_zero(led, REQUEST)
    here.write()
    here.do(here.client.listen(0.1))
    assert len(taken(here, REPLIER)) == 2


def test_endpoint_without_a_client_is_sent_nothing() -> None:
    here = connected()
    gone = DeviceEndpoint(EndpointKind.SUBSCRIBER, endpoint_id(3, READER), "/cmd_vel", "geometry_msgs/Twist")
    assert here.session.zero_frames(gone, ZERO) == ()
    here.session.drop_commands(gone)
    assert not here.session.send_zero(gone, ZERO)
    assert here.session.room_bytes(gone) == 0
    other = here.session.endpoint_of("/cmd_vel", VELOCITY)._replace(name="/other", type="a/B")
    assert not here.session.send_zero(other, ZERO)


def test_zero_is_repeated_until_the_board_has_read_one_and_for_a_few_turns_of_its_loop() -> None:
    here = connected()
    velocity = here.session.endpoint_of("/cmd_vel", VELOCITY)
    here.link.loss = 1.0
    here.frames.clear()
    assert here.session.send_zero(velocity, ZERO)
    here.write()
    here.run(here.now_s + 0.5)
    sent = sum(ZERO in frame for _, frame in here.frames)
    assert 5 <= sent <= 11
    here.link.loss = 0.0
    here.do(here.client.listen(0.2))
    here.run(here.now_s + 0.2)
    assert len(taken(here, READER)) >= 1
    here.run(here.now_s + 5.0)
    after = len(taken(here, READER))
    assert REPEATS_AFTER < after < REPEATS_AFTER + 6
    here.run(here.now_s + 5.0)
    assert len(taken(here, READER)) == after


def test_zero_is_not_repeated_before_it_is_due() -> None:
    here = connected()
    here.session.send_zero(here.session.endpoint_of("/cmd_vel", VELOCITY), ZERO)
    here.write()
    here.session.tick(now_s=here.now_s)
    assert not here.session.outbox.has_waiting


def test_answer_to_what_was_sent_before_a_velocity_does_not_show_that_it_was_read() -> None:
    client = connected().session._clients[0x81, b""]
    client.note_velocity_sent(1.0)
    client.note_flying(7, 1.0)
    client.note_answered(6, 1.01)
    assert client.flying_until_s == 1.0 + LOST_MIN_S
    client.note_answered(7, 1.01)
    assert client.flying_until_s == 1.0 + client.slow_round_trip_s


@pytest.mark.parametrize(("slow_s", "lost_s"), [(0.0, LOST_MIN_S), (0.05, LOST_MIN_S), (0.2, 0.4), (0.4, IN_FLIGHT_S)])
def test_unanswered_velocity_is_lost_after_two_of_the_slowest_round_trips(slow_s: float, lost_s: float) -> None:
    client = connected().session._clients[0x81, b""]
    client.slow_round_trip_s = slow_s
    client.note_flying(7, 1.0)
    assert client.flying_until_s == pytest.approx(1.0 + lost_s)


def test_zero_is_not_repeated_for_ever_or_after_a_new_velocity() -> None:
    here = connected()
    velocity = here.session.endpoint_of("/cmd_vel", VELOCITY)
    here.link.loss = 1.0
    here.session.send_zero(velocity, ZERO)
    here.run(here.now_s + 4.0)
    here.frames.clear()
    here.run(here.now_s + 4.0)
    assert not any(ZERO in frame for _, frame in here.frames)
    here.session.send_zero(velocity, ZERO)
    here.write()
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.write()
    here.frames.clear()
    here.run(here.now_s + 1.0)
    assert not any(ZERO in frame for _, frame in here.frames)


@pytest.mark.parametrize("silent_s", [0.3, 2.0])
def test_velocity_that_waits_sends_no_acknowledgement_alone(silent_s: float) -> None:
    """A board reads one message a turn: each one in vain delays the zero of a stop."""
    here = connected()
    here.run(here.now_s + 2.0)
    here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"})))
    here.run(here.now_s + silent_s)
    client = here.session._clients[0x81, b""]
    here.link.loss = 1.0
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.write()
    client.flying_until_s, client.round_trips, client.slow_round_trip_s = here.now_s + 0.4, 5, 0.2
    here.frames.clear()
    for _ in range(4):
        here.run(here.now_s + 0.05)
        here.session.tick(now_s=here.now_s)
        here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
        here.write()
    alone = [frame for _, frame in here.frames if frame[4] == Kind.ACKNACK and len(frame) == 13]
    assert alone == []


def test_board_that_falls_behind_gets_one_velocity_at_a_time_and_a_zero_at_once() -> None:
    here = connected()
    client = here.session._clients[0x81, b""]
    client.round_trips, client.slow_round_trip_s = 5, 0.2
    here.link.loss = 1.0
    here.frames.clear()
    for number in range(4):
        here.session.publish("/cmd_vel", TWIST.pack(number + 1.0, 0, 0, 0, 0, 0), is_urgent=True)
        here.write()
        here.run(here.now_s + 0.05)
    velocities = [TWIST.unpack(frame[-48:])[0] for _, frame in here.frames if len(frame) > 60]
    assert velocities == [1.0]
    here.run(here.now_s + 0.5)
    velocities = [TWIST.unpack(frame[-48:])[0] for _, frame in here.frames if len(frame) > 60]
    assert velocities == [1.0, 4.0]
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.session.send_zero(here.session.endpoint_of("/cmd_vel", VELOCITY), ZERO)
    here.frames.clear()
    here.write()
    assert [frame[-48:] for _, frame in here.frames if len(frame) > 60] == [ZERO]
    here.run(here.now_s + 0.5)
    assert not any(frame[-48:] == VELOCITY for _, frame in here.frames)


def test_clients_that_refuse_messages_without_a_number_get_velocities_with_one() -> None:
    protocol = Xrce(DatagramFraming, keeps_datagrams=True, velocity_stream=1)
    here = connected(session=protocol.session(CATALOG))
    for _ in range(3):
        here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
        here.write()
    here.run(here.now_s + 0.5)
    assert taken(here, READER) == [VELOCITY, VELOCITY, VELOCITY]


@given(st.integers(0, 0xFFFF), st.integers(0, 2))
def test_zeros_with_a_number_are_taken_after_any_other_number(newest: int, lost: int) -> None:
    """One of three is taken at any time, also when one of them is lost, and so is one of each repetition."""
    protocol = Xrce(DatagramFraming, keeps_datagrams=True, velocity_stream=1)
    here = connected(session=protocol.session(CATALOG))
    velocity = here.session.endpoint_of("/cmd_vel", VELOCITY)
    zeros = here.session.zero_frames(velocity, ZERO)
    here.client.last_best_effort = newest
    for turn in range(3):
        for number, zero in enumerate(zeros):
            if turn or number != lost:
                here._to_board(zero)
        here.do(here.client.listen(0.01))
        here.do(here.client.listen(0.01))
        here.do(here.client.listen(0.01))
        is_taken = len(taken(here, READER)) > 0
        assert is_taken or turn == 0
        here.client.taken.clear()


@pytest.mark.parametrize("stream", [0x80, 0x01])
@pytest.mark.parametrize("way", ["drop", "urgent", "zero"])
def test_message_that_waits_or_was_lost_does_not_follow_a_zero(stream: int, way: str) -> None:
    """Six messages: of a reliable reader four are on their way and lost, and two wait for the acknowledgement."""
    here = connected(stream=stream)
    here.link.loss = 1.0
    for number in range(6):
        here.session.publish("/cmd_vel", TWIST.pack(0.1 * number, 0, 0, 0, 0, 0.5), depth=10)
        if number < 5:
            here.write()
    endpoint = here.session.endpoint_of("/cmd_vel", VELOCITY)
    if way == "drop":
        here.session.drop_commands(endpoint)
    elif way == "urgent":
        here.session.publish("/cmd_vel", ZERO, is_urgent=True)
    else:
        assert here.session.send_zero(endpoint, ZERO)
    here.link.loss = 0.0
    here.write()
    here.run(here.now_s + 2.0)
    assert set(taken(here, READER)) == (set() if way == "drop" else {ZERO})
    here.session.publish("/words", b"\5\0\0\0after")
    here.write()
    here.run(here.now_s + 1.0)
    assert len(taken(here, 0x16)) == 1  # the reliable stream continues


def test_message_that_waits_for_the_line_does_not_follow_a_zero() -> None:
    here = connected(session=made(uart_bytes_s=3840))
    here.session.publish("/words", b"\7\0\0\0earlier")
    here.session.publish("/cmd_vel", VELOCITY)
    here.session.drop_commands(here.session.endpoint_of("/cmd_vel", VELOCITY))
    here.write()
    here.run(here.now_s + 2.0)
    assert (len(taken(here, 0x16)), taken(here, READER)) == (1, [])


# -- liveness, damage, captures ---------------------------------------------------------------------------------------


def test_silent_board_is_asked_and_its_answer_shows_that_it_lives() -> None:
    here = connected()
    here.run(here.now_s + 5.0)
    assert here.session.is_regular
    assert here.session.round_trip_s is not None
    assert here.session.turn_s is not None
    here.session.probe()
    assert of_kind(here, events.TopicsAnswered) == []
    here.run(here.now_s + KEEPALIVE_S + 0.1)
    here.session._clients[0x81, b""].probed_s = -math.inf
    here.session.probe()
    here.write()
    here.run(here.now_s + 0.1)
    assert len(of_kind(here, events.TopicsAnswered)) == 1


def test_unmeasured_session_has_no_round_trip() -> None:
    session = made()
    assert (session.round_trip_s, session.turn_s, session.node, session.quality.resent) == (None, None, "", 0)
    assert not session.is_regular
    assert session.deadline_s() == math.inf


def test_messages_of_unknown_clients_and_objects_are_counted() -> None:
    here = world()
    here.client.put(sub(board.WRITE, bytes(8)))
    here.client.send(0, 0, sub(board.ACKNACK, bytes(5)))
    here.do(here.client.listen(0.1))
    assert here.session.counts.unknown_ids == 2
    here = connected()
    here.do(here.client.publish(0x995, b"x"))
    assert of_kind(here, events.UnknownTopicUsed) == [events.UnknownTopicUsed(0x995)]


@pytest.mark.parametrize(
    "submessage",
    [
        sub(board.WRITE, b"\0"), sub(board.WRITE, bytes(8), flags=3), sub(board.READ, b""), sub(board.ACKNACK, b""),
        sub(board.HEARTBEAT, b""), sub(board.CREATE, b"\0"), sub(board.RESET, b""), sub(99, b""),
        sub(board.TIMESTAMP, b""), sub(board.GET_INFO, b""), sub(board.CREATE_CLIENT, b""), sub(board.WRITE, b"")[:3],
        struct.pack(">BBH", board.WRITE, 0, 8) + struct.pack(">HH", 1, WRITER) + bytes(4),
    ],
)  # fmt: skip
def test_damaged_submessage_is_counted(submessage: bytes) -> None:
    here = connected()
    here.client.send(0, 0, submessage)
    here.do(here.client.listen(0.1))
    assert here.session.counts.malformed == 1


def test_bytes_outside_messages_are_skipped_and_kept() -> None:
    session = made()
    session.receive(b"\x81", now_s=0.0)
    assert (session.counts.skipped_bytes, session.foreign) == (1, b"\x81")
    serial = MICRO_ROS_SERIAL.session(CATALOG)
    serial.receive(b"boot text", now_s=0.0)
    assert (serial.counts.skipped_bytes, serial.foreign) == (9, b"boot text")
    assert serial.bad_checksums == 0
    assert serial.rest_of_frame_bytes([b"x"]) == 1


def test_streams_above_the_bound_are_refused() -> None:
    here = connected()
    for stream in range(8):
        here.client.send(1 + stream, 0, sub(board.RESET, b""))
        here.client.send(0x80 + stream, 0, sub(board.RESET, b""))
        here.client.send(0, 0, sub(board.HEARTBEAT, bytes((0, 0, 0, 0, 0x80 + stream))))
    here.do(here.client.listen(0.1))
    client = here.session._clients[0x81, b""]
    assert (len(client.inputs), len(client.lossy_inputs)) == (4, 4)
    assert here.session.counts.refused_frames == 4


def test_acknowledgement_of_another_stream_is_ignored() -> None:
    here = connected()
    here.client.send(0, 0, sub(board.ACKNACK, bytes((0, 0, 0, 0, 0x81))))
    here.client.send(0, 0, sub(board.HEARTBEAT, bytes(5)))
    here.do(here.client.listen(0.1))
    assert here.session.counts.malformed == 0


def test_best_effort_losses_are_counted_exactly() -> None:
    here = connected()
    for number in (0, 1, 5, 4):
        here.client.best_effort = number
        here.client.publish_best_effort(WRITER, cdr("std_msgs/String", {"data": "a"}))
    here.do(here.client.listen(0.1))
    assert (here.session.counts.lost_messages, here.session.quality.best_effort_late) == (3, 1)


def test_topic_that_is_too_long_without_acknowledgement_is_named() -> None:
    here = connected()
    here.do(here.client.create(0x32, board.topic("rt/odom", "nav_msgs::msg::dds_::Odometry_"), 1))
    here.do(here.client.create(0x35, board.endpoint(0x32, is_reader=False, is_reliable=False), 3))
    here.do(here.client.create(0x45, board.endpoint(0x02, is_reader=False, is_reliable=False), 3))
    assert here.session.too_small(CATALOG.least_bytes) == [
        "/odom: a message of at least 700 bytes, best effort takes 496"
    ]


def test_capture_begins_with_messages_that_announce_the_endpoints() -> None:
    here = connected()
    here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"})))
    topics = here.session.topics
    for protocol in (MICRO_ROS_UDP, MICRO_ROS_TCP, MICRO_ROS_SERIAL):
        framing = protocol.session(CATALOG)
        framing._clients = here.session._clients
        replayed = Xrce.on(framing.captured_as.rpartition("/")[2]).session(CATALOG)
        replayed.receive(framing.announcement(topics), now_s=0.0)
        (negotiated,) = [each for each in replayed.tick(now_s=1.0) if isinstance(each, events.TopicsNegotiated)]
        assert set(negotiated.topics) == set(topics)
    gone = topics[0]._replace(id=endpoint_id(3, WRITER))
    assert here.session.announcement([gone]) == here.session.announcement([])
    keyed = connected(Client(key=KEY, session=1))
    assert b"\0\0\0\0" + KEY in keyed.session.announcement(keyed.session.topics)


def test_session_is_worth_remembering_when_a_board_has_created_something() -> None:
    assert made().memory_version == 0
    here = connected()
    before = here.session.memory_version
    assert before > 0
    here.client.read_data(READER)  # once more
    here.do(here.client.confirm(1.0))
    assert here.session.memory_version > before


def test_commands_of_an_endpoint_without_a_client_are_dropped() -> None:
    here = connected()
    here.session.drop_commands(here.session.topics[0]._replace(id=endpoint_id(3, WRITER)))
    assert not here.session.outbox.has_waiting


def test_bytes_of_a_serial_port_have_a_message_of_micro_ros_or_none() -> None:
    ping = board.Serial().encode(b"\x80\0\0\0\2\1\x08\0\0\x0a\xff\xfd\2\0\0\0")
    assert MICRO_ROS_SERIAL.is_in(b"text" + ping)
    assert not MICRO_ROS_SERIAL.is_in(b"text" + ping[:-1])


def test_ids_of_endpoints_tell_client_and_object() -> None:
    for slot in range(CLIENTS_MAX):
        for id_ in (0x0005, 0x0FF6, 0xFFF7, 0xFFF8):
            number = endpoint_id(slot, id_)
            assert 0 <= number <= 0xFFFF
            assert object_id(DeviceEndpoint(EndpointKind.PUBLISHER, number, "", "")) == id_


def test_parameters_are_not_answered() -> None:
    session = made()
    while session.pop_frame(now_s=0.0, wall_ns=0) is not None:
        pass
    session.answer_parameter("x", Parameter())
    assert session.pop_frame(now_s=0.0, wall_ns=0) is None


def test_protocol_knows_its_greeting_and_answers_pings_without_a_session() -> None:
    client = Client(key=KEY)
    client.send(0, 0, sub(board.GET_INFO, bytes.fromhex("000AFFFD02000000")), 0x80)
    ping = client.sent.pop()
    for protocol in (MICRO_ROS_UDP, MICRO_ROS_TCP, MICRO_ROS_SERIAL):
        framing = protocol._framing()
        assert protocol.is_greeting(framing.encode(client.creation()))
        assert not protocol.is_greeting(framing.encode(ping))
        assert len(protocol.answer_ping(framing.encode(ping))) >= 26
        assert protocol.answer_ping(framing.encode(client.creation())) == b""
        assert protocol.name == "micro-ROS"
        assert not protocol.is_of_other_host(framing.encode(ping) + framing.encode(client.creation()))
    assert [each.keeps_datagrams for each in (MICRO_ROS_UDP, MICRO_ROS_TCP, MICRO_ROS_SERIAL)] == [True, False, False]


def test_protocol_knows_messages_of_a_client_that_another_host_created() -> None:
    client = Client(key=KEY)
    client.send(1, 7, sub(board.WRITE, bytes(8)), 0x81)
    written = client.sent.pop()
    for data, is_known in (
        (written, True),
        (written + b"abc", False),
        (written[:4], False),
        (client.creation(), False),
        (b"hello", False),
        (bytes(600), False),
        (b"", False),
        (b"distance 42 cm\r\n", False),
    ):
        assert MICRO_ROS_UDP.is_of_other_host(data) is is_known, data


# -- going on after a restart of the host -----------------------------------------------------------------------------


def restarted(here: World, state: SessionState | None = None) -> World:
    here.restart_host(
        MICRO_ROS_UDP.resumed(CATALOG, (here.session.state() if state is None else state).to_json()), away_s=0.5
    )
    here.found.clear()
    return here


def test_board_continues_with_a_restarted_host() -> None:
    here = restarted(connected())
    here.run(here.now_s + 2.0)
    (negotiated,) = of_kind(here, events.TopicsNegotiated)
    assert len(negotiated.topics) == 7  # type: ignore[attr-defined]
    assert here.session.quality.resumed == 1
    assert here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"}))).is_done
    assert len(of_kind(here, events.MessageReceived)) == 1
    here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    here.session.publish("/words", text("a"))
    here.write()
    here.run(here.now_s + 0.5)
    assert taken(here, READER) == [VELOCITY]
    assert len(taken(here, 0x16)) == 1


def test_board_that_publishes_during_the_restart_continues() -> None:
    here = restarted(connected())

    def publish() -> Program:
        results = []
        for _ in range(20):
            results.append((yield from here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a" * 700}))))
            yield from here.client.listen(0.02)
        return results

    results = here.do(publish())
    assert sum(not each.is_done for each in results) <= 2
    assert here.session.quality.resumed == 1
    assert len(of_kind(here, events.MessageReceived)) >= 17


def test_state_survives_as_text_and_holds_what_was_asked() -> None:
    here = connected()
    (client,) = here.session.state().clients
    assert (len(client.objects), len(client.reads)) == (11, 4)
    asked(here, samples=3)
    (client,) = here.session.state().clients
    assert len(client.reads) == 3


def test_version_of_the_state_changes_with_what_it_holds() -> None:
    here = connected()
    before = here.session.state_version
    here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"})))
    assert here.session.state_version == before
    here.client.read_data(0x16)
    here.do(here.client.confirm(1.0))
    assert here.session.state_version > before


def test_other_board_at_the_address_never_gets_objects_that_it_did_not_create() -> None:
    here = connected()
    (client,) = here.session.state().clients
    state = SessionState((client._replace(number=30_000),))
    restarted(here, state)
    here.run(here.now_s + 3.0)
    assert of_kind(here, events.TopicsNegotiated) == []
    assert here.session.topics == ()
    assert here.session.state().clients == ()


def test_other_board_that_creates_itself_replaces_the_state() -> None:
    here = restarted(connected())
    other = Client(key=b"new!")
    here.restart_board(other, idle())
    here.run(here.now_s + 1.0)
    here.do(other.connect())
    here.run(here.now_s + 2.0)
    assert here.session.topics == ()


def test_resumed_client_that_creates_itself_again_is_the_same() -> None:
    here = restarted(connected())
    here.run(here.now_s + 0.5)
    here.link.loss = 1.0
    here.session.receive(here.client.creation(), now_s=here.now_s)
    here.link.loss = 0.0
    here.client.reset()
    assert here.do(here.client.publish(WRITER, cdr("std_msgs/String", {"data": "a"}))).is_done
    assert len(here.session.topics) == 7


def test_board_without_reliable_streams_continues_when_its_messages_fit() -> None:
    client = Client(key=KEY, has_reliable_input=False)
    here = world(client)
    here.do(client.connect())
    for id_, content, parent in (
        (0x01, board.participant("n"), 0),
        (0x02, board.topic("rt/chatter", "std_msgs::msg::dds_::String_"), 1),
        (0x03, b"\0\0", 1),
        (WRITER, board.endpoint(0x02, is_reader=False, is_reliable=False), 3),
    ):
        client.send(0, 0, client.creating(id_, content, parent)[1])
    here.do(client.listen(0.5))
    here.run(here.now_s + 1.0)
    restarted(here)
    here.run(here.now_s + 1.1)
    for data in ("a", "b", "c", "d"):
        client.publish_best_effort(WRITER, cdr("std_msgs/String", {"data": data}))
        here.do(client.listen(0.5))
    assert len(of_kind(here, events.TopicsNegotiated)) == 1
    assert [text_of(event.payload + b"\0") for event in of_kind(here, events.MessageReceived)] == ["d"]


def test_first_messages_of_a_resumed_board_do_not_count_while_it_may_acknowledge() -> None:
    here = restarted(connected())
    here.link.loss = 1.0
    here.run(here.now_s + 0.6)
    here.client.send(1, 0, sub(board.WRITE, struct.pack(">HH", 1, WRITER) + cdr("std_msgs/String", {"data": "a"})))
    here.session.receive(here.client.sent.pop(), now_s=here.now_s)
    evidence = here.session._clients[0x81, b""].evidence
    assert evidence is not None
    assert (evidence._messages, evidence._late_messages) == (1, 0)


def test_one_of_two_resumed_clients_continues_without_the_other() -> None:
    here = connected()
    (client,) = here.session.state().clients
    other = client._replace(info=client.info._replace(session=0x82))
    restarted(here, SessionState((client, other)))
    here.run(here.now_s + 2.0)
    assert len(here.session.topics) == 7


def test_board_whose_messages_do_not_fit_the_state_is_forgotten() -> None:
    here = restarted(connected())
    here.client.has_reliable_input = False
    here.run(here.now_s + 1.0)
    here.client.publish_best_effort(WRITER, b"x")
    here.do(here.client.listen(0.5))
    assert here.session._clients == {}


# -- another board at the address of one whose state was stored -------------------------------------------------------


def other_board(ahead: int, *, taken_ahead: int = 0, program: Callable[[Client], Program] | None = None) -> World:
    """A world whose host restarts while another board takes the address. Its numbers are so far ahead of the stored."""
    here = connected()
    (stored,) = here.session.state().clients
    other = Client(key=b"arm!")
    other.agent_status = 0  # it has a session, of another host
    other.last_handled = other.last_announced = (stored.sent + ahead - 1) % 65536
    other.last_sent = other.last_acked = (stored.inputs[0x80] + taken_ahead - 1) % 65536
    restarted(here)
    here.restart_board(other, silent(other) if program is None else program(other))
    return here


def silent(client: Client, until_s: float = math.inf) -> Program:
    while client.now_s < until_s:
        yield from client.listen(min(until_s - client.now_s, 1.0))


def writing(id_: int, payload: bytes, *, is_reliable: bool = True, after_s: float = 0.7) -> Callable[[Client], Program]:
    """The program of a board that writes one object every 0.2 s."""

    def run(client: Client) -> Program:
        yield from silent(client, client.now_s + after_s)
        while True:
            if is_reliable:
                yield from client.publish(id_, payload)
            else:
                client.publish_best_effort(id_, payload)
            yield from silent(client, client.now_s + 0.2)

    return run


def driven(here: World) -> bool:
    """Whether a velocity is accepted and reaches the board."""
    try:
        here.session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    except UnknownTopic:
        return False
    here.write()
    here.run(here.now_s + 0.1)
    return VELOCITY in taken(here, READER)


WORDS = cdr("std_msgs/String", {"data": "a"})


def is_unknown(here: World) -> bool:
    """Whether the stored state was discarded, and the board is one of an unknown session."""
    unknown, state = here.session.quality.unknown, here.session.state()
    return unknown > 0 and not driven(here) and state == SessionState(()) and here.session.memory() == ""


@pytest.mark.parametrize("ahead", [-1, -30_000, 60, 190, 8_000, 30_000])
@pytest.mark.parametrize("program", [None, writing(WRITER, WORDS)])
def test_other_board_whose_number_the_host_cannot_have_reached_is_unknown(
    ahead: int, program: Callable[[Client], Program] | None
) -> None:
    here = other_board(ahead, program=program)
    here.run(here.now_s + 4.0)
    assert is_unknown(here)
    assert of_kind(here, events.TopicsNegotiated) == []


@pytest.mark.parametrize("ahead", [0, 2])
@pytest.mark.parametrize("is_reliable", [True, False])
@pytest.mark.parametrize(("id_", "payload"), [(0x35, WORDS), (READER, WORDS), (WRITER, b"x")])
def test_other_board_whose_first_message_does_not_fit_is_unknown(
    ahead: int, id_: int, payload: bytes, *, is_reliable: bool
) -> None:
    here = other_board(ahead, program=writing(id_, payload, is_reliable=is_reliable))
    here.run(here.now_s + 4.0)
    assert is_unknown(here)
    assert of_kind(here, events.TopicsNegotiated) == []


@pytest.mark.parametrize("taken_ahead", [-20, -5_000, 7_000, 30_000])
def test_other_board_whose_own_numbers_do_not_fit_is_unknown(taken_ahead: int) -> None:
    here = other_board(0, taken_ahead=taken_ahead, program=writing(WRITER, WORDS))
    here.run(here.now_s + 4.0)
    assert is_unknown(here)
    assert of_kind(here, events.TopicsNegotiated) == []


def test_other_board_whose_heartbeat_does_not_fit_is_unknown() -> None:
    here = other_board(0, taken_ahead=9_000)
    here.run(here.now_s + 0.6)
    here.client.send(0, 0, sub(board.HEARTBEAT, struct.pack("<HHB", 9_020, 9_021, 0x80)))
    here._step(None)
    here.run(here.now_s + 0.1)
    assert is_unknown(here)


def test_board_is_unknown_once_with_two_messages_that_do_not_fit() -> None:
    here = other_board(0)
    here.run(here.now_s + 0.6)
    here.client.put_best_effort(*[sub(board.WRITE, struct.pack(">HH", 1, 0x35) + WORDS)] * 2)
    here._step(None)
    here.run(here.now_s + 0.1)
    assert here.session.quality.refuted == 1
    assert is_unknown(here)


def test_other_board_that_creates_other_objects_is_unknown() -> None:
    here = other_board(0)
    here.run(here.now_s + 0.6)
    here.client.put(here.client.creating(0x02, board.topic("rt/arm", "std_msgs::msg::dds_::Float32_"), 1)[1])
    here._step(None)
    here.run(here.now_s + 0.1)
    assert is_unknown(here)


@pytest.mark.parametrize(("id_", "payload"), [(0x35, WORDS), (WRITER, b"x"), (REPLIER, bytes(24) + b"x")])
def test_other_board_that_was_silent_is_unknown_with_its_first_message(id_: int, payload: bytes) -> None:
    here = other_board(0, program=writing(id_, payload, after_s=3.0))
    here.run(here.now_s + 2.5)
    assert driven(here)  # nothing that was heard tells the boards apart
    here.run(here.now_s + 1.0)
    here.client.taken.clear()
    if id_ != REPLIER:  # a response without a call is not looked at
        assert is_unknown(here)
        here.run(here.now_s + 2.0)
        assert here.session.topics == ()
        assert here.session.quality.resumed == 0


def test_other_board_that_was_driven_takes_zeros_when_its_message_does_not_fit() -> None:
    here = other_board(0, program=writing(0x35, WORDS, after_s=3.0))
    here.run(here.now_s + 2.5)
    assert driven(here)
    (endpoint,) = [each for each in here.session.topics if each.name == "/cmd_vel"]
    here.run(here.now_s + 0.9)
    assert here.session.topics == ()
    assert here.session.send_zero(endpoint, bytes(48))
    here.write()
    here.run(here.now_s + 0.1)
    assert taken(here, READER)[-1] == bytes(48)
    here.run(here.now_s + 2.0)
    assert here.session._clients == {}
    assert not here.session.send_zero(endpoint, bytes(48))


def test_other_board_that_leaves_may_create_its_client_at_once() -> None:
    here = other_board(0, program=writing(0x35, WORDS, after_s=3.0))
    here.run(here.now_s + 3.4)
    assert here.session.topics == ()
    anew = Client(key=b"anew")
    here.restart_board(anew, silent(anew))
    assert here.do(anew.connect())
    here.run(here.now_s + 2.0)
    (client,) = here.session._clients.values()
    assert client.info.key == b"anew"


@pytest.mark.parametrize(("ahead", "is_resumed"), [(0, True), (30, False)])
def test_board_that_only_listens_continues_with_a_stored_number_alone(ahead: int, *, is_resumed: bool) -> None:
    """With a later one it is given up, so that doctor says `session_unknown`, and code that asks connects again."""
    here = connected()
    (stored,) = here.session.state().clients
    listening = tuple(each for each in stored.objects if each[1] & 15 not in (5, 7, 8))  # kinds that publish
    here.client.last_handled = here.client.last_announced = (stored.sent + ahead - 1) % 65536
    restarted(here, SessionState((stored._replace(objects=listening),)))
    here.run(here.now_s + 2.0)
    assert driven(here) is is_resumed
    here.run(here.now_s + 10.0)
    assert here.session.quality.refuted == (not is_resumed)
    assert bool(here.session._clients) is is_resumed


def test_board_whose_number_the_host_may_have_reached_continues_with_its_first_message() -> None:
    here = other_board(30)
    here.run(here.now_s + 3.0)
    assert not driven(here)
    assert here.do(here.client.publish(WRITER, WORDS)).is_done
    assert driven(here)


def test_board_that_was_killed_with_messages_on_the_way_continues_at_once() -> None:
    here = connected()
    here.is_host_there = True
    here.link.loss = 1.0
    for _ in range(2):
        here.session.publish("/words", text("a"), depth=4)
    here.write()
    here.link.loss = 0.0
    (stored,) = here.session.state().clients
    assert stored.sent == stored.number + 2
    restarted(here)
    here.run(here.now_s + 2.0)
    assert driven(here)


def test_message_of_a_topic_that_never_fitted_does_not_count() -> None:
    here = connected()
    version = here.session.memory_version
    here.do(here.client.publish(WRITER, b"x"))
    here.do(here.client.publish(WRITER, b"x"))
    assert here.session.memory_version == version + (1 << 24)
    restarted(here)
    here.run(here.now_s + 0.55)
    assert here.do(here.client.publish(WRITER, b"x")).is_done
    assert not here.session.topics
    here.run(here.now_s + 1.5)
    assert driven(here)


def test_message_of_a_refused_type_does_not_count() -> None:
    here = connected()
    here.do(here.client.create(0x32, board.topic("rt/log", "rcl_interfaces::msg::dds_::Log_"), 1))
    here.do(here.client.create(0x35, board.endpoint(0x32, is_reader=False), 3))
    here.run(here.now_s + 0.5)
    assert here.session.refusals
    restarted(here)
    here.run(here.now_s + 0.55)
    assert here.do(here.client.publish(0x35, b"x")).is_done
    assert not here.session.topics
    here.run(here.now_s + 1.5)
    assert driven(here)


def test_late_response_to_a_call_of_the_host_before_is_evidence() -> None:
    here = restarted(connected())
    here.run(here.now_s + 0.55)
    response = bytes(24) + b"\1\0\0\0\1\0\0\0\0"
    here.client.put(sub(board.WRITE, struct.pack(">HH", 1, REPLIER) + response))
    here._step(None)
    here.run(here.now_s + 0.1)
    assert driven(here)


def test_state_is_worth_storing_when_numbers_have_passed_and_when_none_pass() -> None:
    here = connected()
    session = here.session
    here.run(here.now_s + STORED_PAUSE_S)
    found = [session.memory_version]

    def send(count: int) -> None:
        for _ in range(count):
            session.publish("/words", text("a"))
            here.write()
            here.run(here.now_s + 0.05)
            found.append(session.memory_version)

    send(10)
    assert len(set(found)) == 1
    send(10)
    assert len(set(found)) == 2
    here.run(here.now_s + STORED_PAUSE_S)
    assert session.memory_version not in found


def test_state_that_waits_for_its_board_is_stored_as_it_was() -> None:
    here = connected()
    state = here.session.state()
    session = MICRO_ROS_UDP.resumed(CATALOG, state.to_json())
    session.open(now_s=0.0)
    assert session.state() == state


def test_state_with_damaged_parts_is_restored_without_them() -> None:
    here = connected()
    (client,) = here.session.state().clients
    damaged = client._replace(objects=(b"", *client.objects), reads=(b"", *client.reads))
    tiny = client._replace(info=client.info._replace(mtu=5))
    restarted(here, SessionState((tiny, damaged)))
    here.run(here.now_s + 2.0)
    assert len(here.session.topics) == 7


# -- any bytes --------------------------------------------------------------------------------------------------------

kinds = st.integers(0, 17)
payloads = st.binary(max_size=24) | st.builds(
    lambda request, id_, rest: struct.pack(">HH", request, id_) + rest,
    st.integers(0, 40), st.sampled_from([1, 2, 3, 4, 5, 6, 7, 8, 0x12, 0x16, 0xFFFE]), st.binary(max_size=40),
)  # fmt: skip
submessages = st.builds(sub, kinds, payloads, st.sampled_from([0, 1, 3, 5, 7]))
messages = st.builds(
    lambda session, stream, number, parts: struct.pack("<BBH", session, stream, number) + b"".join(parts),
    st.sampled_from([0x80, 0x81, 0x82, 0x00]), st.sampled_from([0, 1, 0x80, 0x81]),
    st.integers(0, 0xFFFF) | st.integers(0, 20), st.lists(submessages.map(board.padded), max_size=3),
) | st.binary(max_size=40) | st.just(Client(key=KEY).creation()) | st.just(Client(key=b"2222").creation())  # fmt: skip


@given(st.lists(st.tuples(messages, st.sampled_from([0.0, 0.01, 0.2, 3.0])), max_size=25), st.booleans(), st.booleans())
def test_any_bytes_in_any_state_raise_nothing_and_a_new_client_recovers(
    drawn: list[tuple[bytes, float]], is_connected: bool, is_resumed: bool
) -> None:
    here = connected() if is_connected else world()
    session = MICRO_ROS_UDP.resumed(CATALOG, here.session.memory()) if is_resumed else here.session
    now_s = here.now_s
    session.open(now_s=now_s)
    for data, pause_s in drawn:
        session.receive(data, now_s=now_s)
        now_s += pause_s
        while session.deadline_s() <= now_s:
            session.tick(now_s=now_s)
        while session.pop_frame(now_s=now_s, wall_ns=0) is not None:
            pass
        session.announcement(session.topics)
        session.state()
    now_s += LATE_CREATION_S
    fresh = World(session, idle(), Client(key=b"last"), Link(Random(1)))
    fresh.now_s = fresh.client.now_s = now_s
    assert fresh.do(fresh.client.connect())
    fresh.do(creations(fresh.client))
    fresh.run(fresh.now_s + 2 * RESTART_SILENCE_S)
    assert {"/cmd_vel", "/chatter"} <= {each.name for each in session.topics}
    session.publish("/cmd_vel", VELOCITY, is_urgent=True)
    fresh.write()
    fresh.run(fresh.now_s + 0.1)
    assert VELOCITY in taken(fresh, READER)


def test_unfinished_messages_are_counted_and_can_be_dropped() -> None:
    here = connected()
    assert here.session.is_recalled
    before = here.session.kept_bytes
    assert before > 0  # its objects
    stream = here.session._clients[0x81, b""].inputs[0x80]
    first = sub(board.FRAGMENT, bytes(400))
    number = stream.next
    here._to_host(b"\x81\x80" + number.to_bytes(2, "little") + first)
    assert here.session.kept_bytes == before + 400
    here._to_host(b"\x81\x80" + (number + 3).to_bytes(2, "little") + first)  # waits for two before it
    assert here.session.kept_bytes > before + 800
    here.session.drop_unfinished()
    assert here.session.kept_bytes == before
    here.session.drop_unfinished()
    assert here.session.kept_bytes == before


# -- types without a definition ---------------------------------------------------------------------------------------


OWN = "my_package::msg::dds_::Own_"


def test_message_of_an_unknown_type_is_cdr_with_its_encapsulation_in_both_directions() -> None:
    here = world()
    client = here.client
    here.do(client.connect())
    for id_, content, parent in (
        (0x01, board.participant("n"), 0),
        (0x02, board.topic("rt/own", OWN), 1),
        (0x03, b"\0\0", 1),
        (WRITER, board.endpoint(0x02, is_reader=False), 3),
        (0x04, b"\0\0", 1),
        (READER, board.endpoint(0x02, is_reader=True), 4),
    ):
        assert here.do(client.create(id_, content, parent)) == 0
    client.read_data(READER)
    here.do(client.publish(WRITER, b"as it is"))
    (received,) = of_kind(here, events.MessageReceived)
    assert (here.session.raw_encoding, received.payload) == (CDR, ENCAPSULATION + b"as it is")  # type: ignore[attr-defined]
    here.session.publish("/own", ENCAPSULATION + b"to it")
    here.write()
    here.do(client.listen(0.1))
    assert taken(here, READER) == [b"to it"]
    with pytest.raises(WrongType, match="4 bytes: my_package/Own: the payload begins with 726f7331, little-endian CDR"):
        here.session.publish("/own", b"ros1")


def test_zero_of_an_endpoint_before_the_last_announcement_has_the_layout_of_its_type() -> None:
    here = world()
    here.do(here.client.connect())
    for id_, content, parent in (
        (0x01, board.participant("n"), 0),
        (0x02, board.topic("rt/cmd_vel", STAMPED), 1),
        (0x04, b"\0\0", 1),
        (READER, board.endpoint(0x02, is_reader=True), 4),
    ):
        assert here.do(here.client.create(id_, content, parent)) == 0
    here.run(here.now_s + 2 * QUIET_S)
    (endpoint,) = here.session.topics
    here.do(here.client.delete(READER))
    here.run(here.now_s + 2 * QUIET_S)
    assert here.session.topics == ()
    stamped = CATALOG.message("geometry_msgs/TwistStamped")
    assert stamped is not None
    zero = stamped.encode({"header": {"seq": 7, "frame_id": "base"}})
    assert here.session.send_zero(endpoint, zero)
    here.write()
    here.do(here.client.listen(0.1))
    assert taken(here, READER)[0] == cdr_of(stamped).from_ros1(zero)
