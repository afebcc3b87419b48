"""Deliveries: a message from a callback is delivered after its cause, to all subscribers in one order."""

import asyncio
import struct

from hypothesis import given, settings
from hypothesis import strategies as st

from hostlink.core.hub.message import PROGRAM_PRIORITY, Message
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.topic import MAX_WAITING, Subscriber
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.fake_device import CATALOG, topic
from tests.support.participants import ODOMETRY_ID, POSE, ROBOT, TEXT_TYPE, VELOCITY_ID, Scene, play, text
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import inside, virtual

A, B = "/a", "/b"


def recorder(participant: Participant, *topics: str) -> list[bytes]:
    """The payloads that a participant receives."""
    heard: list[bytes] = []
    for name in topics:
        participant.subscribe(name, lambda message: heard.append(message.payload), type_name=TEXT_TYPE)
    return heard


def answering(participant: Participant, question: str, topic_name: str, answers: list[str]) -> None:
    """Publish the answers as soon as this question arrives on a topic."""

    def receive(message: Message) -> None:
        if message.payload == text(question):
            for answer in answers:
                participant.publish(topic_name, text(answer))

    participant.subscribe(topic_name, receive, type_name=TEXT_TYPE)


@inside(play)
async def test_answer_follows_its_question_for_earlier_and_later_subscribers(made: Scene) -> None:
    before, answers, after = (made.hub.join(name) for name in ("before", "answers", "after"))
    first = recorder(before, A)
    answering(answers, "question", A, ["one", "two"])
    answering(made.hub.join("more"), "one", A, ["three"])
    second = recorder(after, A)
    after.publish(A, text("question"))
    assert first == second == [text(each) for each in ("question", "one", "two", "three")]


@inside(play)
async def test_subscriber_from_a_callback_receives_latched_messages_before_newer_ones(made: Scene) -> None:
    sender, late = made.hub.join("sender"), made.hub.join("late")
    sender.advertise(A, TEXT_TYPE, is_latched=True)
    sender.publish(A, text("old"))
    heard: list[list[bytes]] = []

    def receive(message: Message) -> None:
        if message.payload == text("one"):
            for newer in ("two", "three"):
                sender.publish(A, text(newer))
            heard.append(recorder(late, A))

    made.hub.join("first").subscribe(A, receive, type_name=TEXT_TYPE)
    sender.publish(A, text("one"))
    assert heard == [[text(each) for each in ("one", "two", "three")]]
    assert recorder(made.hub.join("later"), A) == [text("three")]


@inside(play)
async def test_the_order_holds_over_two_topics(made: Scene) -> None:
    relay, sender = made.hub.join("relay"), made.hub.join("sender")
    relay.subscribe(A, lambda _: relay.publish(B, text("answer")), type_name=TEXT_TYPE)
    heard = recorder(made.hub.join("both"), A, B)
    sender.publish(A, text("question"))
    assert heard == [text("question"), text("answer")]


@inside(play)
async def test_an_older_velocity_does_not_overtake_the_one_that_it_caused(made: Scene) -> None:
    """Two robots with one velocity topic: the second must not be left with the older command."""
    devices = []
    for name, address in (("a", "10.0.0.3"), ("b", "10.0.0.4")):
        odometry = topic(EndpointKind.PUBLISHER, ODOMETRY_ID, f"/{name}/odometry", "geometry_msgs/Pose2D")
        own = topic(EndpointKind.SUBSCRIBER, VELOCITY_ID + 1, f"/{name}/velocity_commands", "geometry_msgs/Twist")
        shared = topic(EndpointKind.SUBSCRIBER, VELOCITY_ID, "/cmd_vel", "geometry_msgs/Twist")
        devices.append(ScriptedDevice(made.hub, [odometry, own, shared], address=address))
        await asyncio.sleep(0.5)
    careful, sender = made.hub.join("careful", priority=60), made.hub.join("sender")

    def slow_down(message: Message) -> None:
        if struct.unpack_from("<d", message.payload)[0] == 0.8:
            careful.publish("/cmd_vel", PlanarVelocity(0.1).encode(), priority=PROGRAM_PRIORITY + 1)

    careful.subscribe("/cmd_vel", slow_down)
    heard = recorder_of_speeds(made.hub.join("log"), "/cmd_vel")
    sender.publish("/cmd_vel", PlanarVelocity(0.8).encode())
    await asyncio.sleep(0.1)
    assert [struct.unpack_from("<d", device.payloads(VELOCITY_ID)[-1])[0] for device in devices] == [0.1, 0.1]
    assert heard == sorted(heard, reverse=True)
    for device in devices:
        await device.aclose()
    await asyncio.sleep(0.5)


def recorder_of_speeds(participant: Participant, name: str) -> list[float]:
    heard: list[float] = []
    participant.subscribe(name, lambda message: heard.append(struct.unpack_from("<d", message.payload)[0]))
    return heard


@inside(play)
async def test_pose_precedes_the_odometry_that_is_made_of_it(made: Scene) -> None:
    heard: list[str] = []
    program = made.hub.join("program")
    program.subscribe(f"/{ROBOT}/odom", lambda message: heard.append(message.topic))
    program.subscribe(f"/{ROBOT}/odometry", lambda message: heard.append(message.topic))
    await made.robot.send(ODOMETRY_ID, POSE.pack(1.0, 0.0, 0.0))
    await asyncio.sleep(0.1)
    assert heard == [f"/{ROBOT}/odometry", f"/{ROBOT}/odom"]


@inside(play)
async def test_one_that_only_answers_those_who_answer_each_other_without_end_stays(made: Scene) -> None:
    one, other, relay = (made.hub.join(name) for name in ("one", "other", "relay"))
    for who, question, answer in ((one, "/ping", "/pong"), (other, "/pong", "/ping")):
        who.subscribe(question, lambda _, who=who, answer=answer: who.publish(answer, b""), type_name=TEXT_TYPE)
    relay.subscribe("/ping", lambda _: relay.publish("/relayed", b""), type_name=TEXT_TYPE)
    heard = recorder(made.hub.join("third"), "/relayed")
    made.hub.join("sender").publish("/ping", b"")
    assert one.has_left != other.has_left
    assert not relay.has_left
    assert 2 <= len(heard) <= 20


@inside(play)
async def test_waiting_messages_are_bounded_and_none_is_lost(made: Scene) -> None:
    many, sender = made.hub.join("many"), made.hub.join("sender")
    answering(many, "question", A, [str(number) for number in range(MAX_WAITING + 10)])
    heard = recorder(made.hub.join("all"), A)
    sender.publish(A, text("question"))
    assert sorted(heard) == sorted([text("question"), *(text(str(each)) for each in range(MAX_WAITING + 10))])
    assert made.hub.topics.deliveries.out_of_order == 10
    sender.publish(A, text("later"))
    assert heard[-1] == text("later")


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=6), st.integers(0, 3))
@settings(max_examples=60, deadline=None)
@virtual
async def test_everybody_receives_the_messages_of_all_topics_in_one_order(
    edges: list[tuple[int, int]], first: int
) -> None:
    """Publisher on one topic for each message of another, once."""
    graph = TopicGraph(CATALOG)
    early: list[bytes] = []
    late: list[bytes] = []
    names = [f"/{number}" for number in range(4)]
    listen(graph, names, early)
    for number, (here, there) in enumerate(edges):
        observed: list[bytes] = []

        def relay(message: Message, number: int = number, there: int = there, observed: list[bytes] = observed) -> None:
            if not observed:
                observed.append(message.payload)
                graph.advertise(names[there], "test", type_name=TEXT_TYPE).publish(b"%d" % number, source="test")

        graph.subscribe(names[here], Subscriber(relay, "test", TEXT_TYPE, lambda _: None))
    listen(graph, names, late)
    graph.find(names[first]).publish(b"first", source="test")
    assert early == late
    assert early[0] == b"first"


def listen(graph: TopicGraph, names: list[str], heard: list[bytes]) -> None:
    for name in names:
        graph.subscribe(
            name, Subscriber(lambda message: heard.append(message.payload), "test", TEXT_TYPE, lambda _: None)
        )
