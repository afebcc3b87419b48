"""Topics of robots of other daemons in the graph here, without a network."""

import asyncio
from collections import Counter
from typing import cast

from hostlink.components.zenoh.fleet_commands import FleetDrivers
from hostlink.components.zenoh.fleet_messages import FleetTopic, FleetTransport, Keys, Sender
from hostlink.components.zenoh.fleet_topics import FIRST_RETRY_S, FleetTopics
from hostlink.components.zenoh.roster import FleetRoster, Neighbour
from hostlink.components.zenoh.session import ZenohSession
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.messages.serialisation import CDR, ROS1
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.memory_zenoh import MemoryNetwork, MemorySession
from tests.support.remote_robots import RecordingHosts, remote_robot
from tests.support.virtual_loop import virtual

ROBOT, PLAN, SCAN = "robot_7", "/robot_7/plan", "/robot_7/scan"


class World:
    """A daemon that knows a robot of another one."""

    def __init__(self, hub: Hub | None = None) -> None:
        self.hub = hub or Hub(Config(), CATALOG, reraises=True)
        self.counts, self.network = Counter[str](), MemoryNetwork()
        session = cast("ZenohSession", MemorySession(self.network, "1a"))
        transport = FleetTransport(session, Keys("fleet"), Sender("lab", "1a"), self.counts)
        roster = FleetRoster(self.counts)
        host = host_in(self.hub, "fleet")
        robots = host.announce_robots(RecordingHosts())
        drivers = FleetDrivers(host, transport, roster)
        self.topics = FleetTopics(host, transport, robots, drivers, roster)
        self.robot = robots.announce(remote_robot(self.hub, ROBOT).known, host="desk")
        self.neighbour = Neighbour(Sender("desk", "2b"), 0.0)

    def show(self, *names: str, type_name: str = "std_msgs/Bool") -> None:
        topics = [FleetTopic(robot=ROBOT, name=name, type=type_name, is_published=True) for name in names]
        self.neighbour.listed[ROBOT] = topics
        self.topics.show(self.robot, self.neighbour)

    def update(self) -> None:
        self.topics.demand()

    def published(self) -> set[str]:
        return {topic.name for topic in self.hub.topics.all() if topic.publishers and ROBOT in topic.name}


@virtual
async def test_topic_with_another_type_here_is_refused_alone_and_shown_once_it_fits() -> None:
    world = World()
    program = world.hub.join("program")
    program.advertise(PLAN, "std_msgs/String")
    world.show(PLAN, SCAN)
    assert world.counts["refused_topics"] == 1
    assert world.published() == {PLAN, SCAN}
    program.leave()
    assert world.published() == {SCAN}
    await asyncio.sleep(FIRST_RETRY_S + 0.1)
    assert world.published() == {PLAN, SCAN}
    world.topics.end()


@virtual
async def test_topic_is_subscribed_at_its_daemon_while_it_is_subscribed_here() -> None:
    world = World()
    world.show(PLAN, SCAN)
    world.update()
    assert world.network.subscribers == []
    program = world.hub.join("program")
    program.subscribe(PLAN, lambda _: None)
    world.update()
    assert len(world.network.subscribers) == 1
    world.show(SCAN)
    assert world.network.subscribers == []
    world.show(PLAN, SCAN)
    world.update()
    assert len(world.network.subscribers) == 1
    program.leave()
    world.update()
    assert world.network.subscribers == []
    world.topics.end()


@virtual
async def test_robot_at_another_daemon_has_its_topics_anew() -> None:
    world = World()
    world.show(PLAN)
    world.hub.join("program").subscribe(PLAN, lambda _: None)
    world.update()
    world.neighbour = Neighbour(Sender("attic", "3c"), 0.0)
    world.show(PLAN)
    assert world.network.subscribers == []
    assert world.published() == {PLAN}
    world.topics.hide(ROBOT)
    assert world.published() == set()


def test_cdr_of_a_type_without_a_definition_is_not_shared() -> None:
    """The other daemon may have the definition, and would take the bytes for those of ROS 1."""

    async def test(here: MemoryHub) -> None:
        world = World(here.hub)
        world.topics.begin()
        device = await here.connect()
        for name, encoding in (("/robot_0/talk", CDR), ("/robot_0/own", ROS1)):
            here.hub.topics.advertise(name, "device", type_name="my_msgs/Own", raw_encoding=encoding)
        await asyncio.sleep(0.5)
        shared = {topic.name for topic, _ in world.topics._here.values()}
        assert shared >= {"/robot_0/odometry", "/robot_0/own"}
        assert "/robot_0/talk" not in shared
        (line,) = here.logged("fleet.topic_refused")
        reason = "my_msgs/Own has no definition here, its messages are cdr"
        assert (line["topic"], line["reason"]) == ("/robot_0/talk", reason)
        world.topics.end()
        await device.aclose()

    in_hub(test)
