"""The graph is brought up to date by what has changed, and is the same as one that is made anew."""

import random
from collections.abc import Callable

import pytest

from hostlink.core.hub.graph_changes import GraphChanges
from hostlink.core.hub.graph_view import GraphTopic, GraphView
from hostlink.core.hub.node import Node
from hostlink.core.hub.services import Provider, Services
from hostlink.core.hub.topic import DeviceSubscription, Subscriber
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.messages.catalog import Catalog
from hostlink.errors import HostlinkError
from tests.support.virtual_loop import run_virtual

CATALOG = Catalog()
TYPES = ("std_msgs/Bool", "std_msgs/String", "nobody_msgs/Thing")


class World:
    """Topics and services with a user."""

    def __init__(self) -> None:
        self.changes = GraphChanges()
        self.topics, self.services = TopicGraph(CATALOG, self.changes), Services(CATALOG, self.changes)

    def view(self, group: str = "") -> GraphView:
        return GraphView(self.topics, self.services, self.changes, group)

    def provide(self, name: str, key: Node) -> None:
        self.services.provide(Provider(name, "std_srvs/Trigger", key, None))  # type: ignore[arg-type]  # never called


def test_new_robot_costs_in_proportion_to_its_topics() -> None:
    world = World()
    for number in range(1000):
        for name in ("odom", "cmd_vel", "data"):
            world.topics.advertise(f"/robot_{number:03}/{name}", number, type_name="std_msgs/Bool")
    view = world.view()
    before = view.graph()
    version = view.news(-1).version
    assert view.graph().topics is before.topics  # nothing has changed
    for name in ("odom", "cmd_vel", "data"):
        world.topics.advertise(f"/robot_500x/{name}", "new", type_name="std_msgs/Bool")
    after = view.graph()
    known = {id(topic) for topic in before.topics}
    made = [topic.name for topic in after.topics if id(topic) not in known]
    assert made == ["/robot_500x/cmd_vel", "/robot_500x/data", "/robot_500x/odom"]
    assert len(after.topics) == 3003
    assert [topic.name for topic in after.topics] == sorted(topic.name for topic in after.topics)
    news = view.news(version)
    assert (set(news.topics), news.is_whole) == (set(made), False)
    world.topics.leave("new")
    gone = view.news(news.version)
    assert gone.topics == dict.fromkeys(made)
    assert view.graph() == before


@pytest.mark.slow
def test_any_history_of_changes_gives_the_graph_that_is_made_anew() -> None:
    for seed in range(30):
        assert run_virtual(history(random.Random(seed))) > 50


class Reader:
    """Keeps a graph by its news."""

    def __init__(self, world: World, group: str) -> None:
        self.view = world.view(group)
        self._version, self._known = -1, dict[str, GraphTopic | None]()

    def read(self) -> dict[str, GraphTopic]:
        news = self.view.news(self._version)
        self._version = news.version
        self._known = dict(news.topics) if news.is_whole else self._known | dict(news.topics)
        return {name: topic for name, topic in self._known.items() if topic is not None}


KEYS = [*range(4), Node("one"), Node("two", group="ros1"), Node("three", is_daemon=True)]
NODES = [key for key in KEYS if isinstance(key, Node)]
Ends = list[Callable[[], None]]


def publish(world: World, ends: Ends, name: str, dice: random.Random) -> None:
    world.topics.advertise(name, dice.choice(KEYS), type_name=dice.choice(TYPES), is_latched=dice.random() < 0.3)


def subscribe(world: World, ends: Ends, name: str, dice: random.Random) -> None:
    subscriber = Subscriber(lambda _: None, dice.choice(KEYS), dice.choice(("", *TYPES)), lambda _: None)
    place = world.topics.subscribe(name, subscriber)
    ends.append(lambda: world.topics.unsubscribe(*place))


def subscribe_device(world: World, ends: Ends, name: str, dice: random.Random) -> None:
    gate = DeviceSubscription(lambda _: None, is_gate=dice.random() < 0.5)
    world.topics.subscribe_device(name, dice.choice(KEYS), gate, type_name=dice.choice(TYPES))


def unsubscribe(world: World, ends: Ends, name: str, dice: random.Random) -> None:
    if ends:
        ends.pop(dice.randrange(len(ends)))()


def leave(world: World, ends: Ends, name: str, dice: random.Random) -> None:
    key = dice.choice(KEYS)
    world.topics.leave(key)
    world.services.leave(key)


def provide(world: World, ends: Ends, name: str, dice: random.Random) -> None:
    world.provide(name, dice.choice(NODES))


def withdraw(world: World, ends: Ends, name: str, dice: random.Random) -> None:
    world.services.withdraw(name, dice.choice(NODES))


STEPS = (publish, publish, subscribe, subscribe_device, unsubscribe, leave, provide, withdraw)


async def history(dice: random.Random) -> int:
    world, ends, steps = World(), Ends(), 0
    readers = {group: Reader(world, group) for group in ("", "ros1")}
    for _ in range(100):
        try:
            dice.choice(STEPS)(world, ends, f"/{dice.choice('abcdef')}", dice)
        except HostlinkError:
            continue
        steps += 1
        for group, reader in readers.items():
            anew = world.view(group).graph()
            assert reader.view.graph() == anew
            if dice.random() < 0.3:
                assert reader.read() == {topic.name: topic for topic in anew.topics}
    return steps
