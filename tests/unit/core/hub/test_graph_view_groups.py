"""GraphView of a group: a bridge to another graph sees the topics of this one, and not its own."""

import asyncio
from collections.abc import Mapping

import pytest

from hostlink.core.hub.graph_changes import NOTIFY_AFTER_S
from hostlink.core.hub.graph_view import OBSERVERS, Graph, GraphTopic
from hostlink.core.hub.message import Message
from hostlink.core.hub.participant import Participant
from hostlink.errors import BadRequest
from tests.support.fake_device import robot_topics
from tests.support.participants import (
    ODOMETRY_ID,
    POSE,
    ROBOT,
    SERVICE,
    SERVICE_TYPE,
    TEXT_TYPE,
    Scene,
    play,
    text,
)
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import inside

ROS = "ros1"
TEXT = "/talk"  # which no other participant has


def topic_of(graph: Graph, name: str) -> GraphTopic | None:
    return next((topic for topic in graph.topics if topic.name == name), None)


async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
    return {"success": True, "message": ""}


@inside(play)
async def test_the_group_does_not_receive_what_it_publishes(made: Scene) -> None:
    ours, theirs = made.hub.join("outwards", group=ROS), made.hub.join("/talker", group=ROS)
    other, received = made.hub.join("program"), list[bytes]()

    def receive(message: Message) -> None:
        received.append(message.payload)

    ours.subscribe(TEXT, receive)
    for each in (theirs, other):
        each.advertise(TEXT, TEXT_TYPE)
        each.publish(TEXT, text(each.name))
    assert received == [text("program")]


@inside(play)
async def test_participants_without_a_group_receive_their_own_messages(made: Scene) -> None:
    program, received = made.hub.join("program"), list[bytes]()

    def receive(message: Message) -> None:
        received.append(message.payload)

    program.advertise(TEXT, TEXT_TYPE)
    program.subscribe(TEXT, receive)
    program.publish(TEXT, text("mine"))
    assert received == [text("mine")]


@inside(play)
async def test_a_graph_is_what_others_than_the_group_have(made: Scene) -> None:
    ours, other = made.hub.join("outwards", group=ROS), made.hub.join("program")
    for each in (ours, other):
        each.advertise(f"/from_{each.name}", TEXT_TYPE, is_latched=True)
        each.subscribe(f"/to_{each.name}", lambda _: None, type_name=TEXT_TYPE)
        each.provide(f"/of_{each.name}", SERVICE_TYPE, answer)
    graph = ours.graph()
    assert [topic_of(graph, name) for name in ("/from_outwards", "/to_outwards")] == [None, None]
    published, subscribed = topic_of(graph, "/from_program"), topic_of(graph, "/to_program")
    assert (published.type_name, published.is_published, published.is_latched) == (TEXT_TYPE, True, True)
    assert (subscribed.is_published, subscribed.is_subscribed, subscribed.is_velocity) == (False, True, False)
    names = {service.name for service in graph.services}
    assert "/of_program" in names
    assert "/of_outwards" not in names
    assert not any(name.startswith("/rosapi/") for name in names)


@inside(play)
async def test_a_topic_of_both_is_in_the_graph_for_what_the_others_do(made: Scene) -> None:
    ours, other = made.hub.join("outwards", group=ROS), made.hub.join("program")
    ours.advertise(TEXT, TEXT_TYPE, is_latched=True)
    ours.subscribe(TEXT, lambda _: None)
    other.subscribe(TEXT, lambda _: None)
    topic = topic_of(ours.graph(), TEXT)
    assert (topic.is_published, topic.is_subscribed, topic.is_latched) == (False, True, False)


@inside(play)
async def test_a_robots_velocity_is_marked_and_its_odometry_published(made: Scene) -> None:
    graph = made.hub.join("outwards", group=ROS).graph()
    velocity, odometry = (
        topic_of(graph, name)
        for name in (made.hub.robots.find(ROBOT).shown.velocity, made.hub.robots.find(ROBOT).shown.odometry)
    )
    assert (velocity.is_velocity, velocity.is_subscribed, velocity.is_published) == (True, True, False)
    assert (odometry.is_velocity, odometry.is_published) == (False, True)


def counting(made: Scene, name: str) -> tuple[Participant, list[Graph]]:
    """A participant, and the graph at each notice of a change."""
    participant, graphs = made.hub.join(name, group=ROS), list[Graph]()
    participant.watch_graph(lambda: graphs.append(participant.graph()))
    return participant, graphs


async def settle() -> None:
    await asyncio.sleep(2 * NOTIFY_AFTER_S)


@inside(play)
async def test_a_watcher_is_notified_at_the_beginning_and_once_for_many_changes(made: Scene) -> None:
    _, graphs = counting(made, "outwards")
    await settle()
    assert len(graphs) == 1
    program = made.hub.join("program")
    for number in range(20):
        program.advertise(f"/topic_{number}", TEXT_TYPE)
    await settle()
    assert len(graphs) == 2
    assert topic_of(graphs[-1], "/topic_19") is not None
    await settle()
    assert len(graphs) == 2


@inside(play)
async def test_each_kind_of_change_is_noticed(made: Scene) -> None:
    _, graphs = counting(made, "outwards")
    program = made.hub.join("program")
    subscription = program.subscribe(TEXT, lambda _: None, type_name=TEXT_TYPE)
    program.advertise("/other", TEXT_TYPE)
    program.provide(SERVICE, SERVICE_TYPE, answer)
    await settle()
    for change in (
        subscription.close,
        lambda: program.unadvertise("/other"),
        lambda: program.withdraw(SERVICE),
        lambda: program.provide(SERVICE, SERVICE_TYPE, answer),
        program.leave,
    ):
        before = len(graphs)
        change()
        await settle()
        assert len(graphs) == before + 1, change


@inside(play)
async def test_robot_that_connects_or_leaves_is_noticed(made: Scene) -> None:
    _, graphs = counting(made, "outwards")
    third = ScriptedDevice(made.hub, robot_topics("robot_2"), address="10.0.0.3")
    await asyncio.sleep(0.5)
    odometry = made.hub.robots.find("robot_2").shown.odometry
    assert topic_of(graphs[-1], odometry) is not None
    await third.aclose()
    await settle()
    assert topic_of(graphs[-1], odometry) is None


@inside(play)
async def test_messages_change_nothing(made: Scene) -> None:
    participant, graphs = counting(made, "outwards")
    participant.subscribe(f"/{ROBOT}/odometry", lambda _: None)
    await settle()
    before = len(graphs)
    for _ in range(10):
        await made.robot.send(ODOMETRY_ID, POSE.pack(0.1, 0.2, 0.3))
    await settle()
    assert len(graphs) == before


@inside(play)
async def test_one_that_has_left_watches_no_more(made: Scene) -> None:
    participant, graphs = counting(made, "outwards")
    await settle()
    participant.leave()
    made.hub.join("program").advertise(TEXT, TEXT_TYPE)
    await settle()
    assert len(graphs) == 1
    with pytest.raises(BadRequest, match="has left"):
        participant.watch_graph(lambda: None)


@inside(play)
async def test_a_watcher_that_fails_ends_its_participant_alone(made: Scene) -> None:
    failing, (_, graphs) = made.hub.join("failing", group=ROS), counting(made, "outwards")

    def fail() -> None:
        raise RuntimeError("a bug of the watcher")

    failing.watch_graph(fail)
    await settle()
    assert failing.has_left
    assert graphs
    await made.neighbour_works()


@inside(play)
async def test_recorder_alone_imports_no_topic_from_another_graph(made: Scene) -> None:
    ours, other = made.hub.join("outwards", group=ROS), made.hub.join("program")
    made.hub.join_daemon(group=OBSERVERS).subscribe(TEXT, lambda _: None)
    ours.advertise(TEXT, TEXT_TYPE)
    assert topic_of(ours.graph(), TEXT) is None
    other.subscribe(TEXT, lambda _: None)
    found = topic_of(ours.graph(), TEXT)
    assert found.is_subscribed
