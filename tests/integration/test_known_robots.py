"""Known robots: how long they are kept and what they cost, for many devices with any names. In virtual time."""

import asyncio
import time
from collections import deque
from collections.abc import Awaitable, Callable

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import Config, LinkConfig, RobotConfig
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Node
from hostlink.core.hub.robots import MAX_AWAY
from hostlink.core.hub.topic import Subscriber
from hostlink.core.hub.topic_graph import TopicGraph
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.message_type import MessageType
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import CommandRefused
from tests.support.fake_device import CATALOG, robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.growth import is_linear
from tests.support.scripted_device import ScriptedDevice
from tests.support.virtual_loop import run_virtual

FORGET_S = 60.0
CONFIG = Config(link=LinkConfig(forget_robot_after_s=FORGET_S), robots={"mower": RobotConfig()})


def with_hub(test: Callable[[Hub], Awaitable[None]], config: Config = CONFIG) -> None:
    """Run the test with a hub that ends with the first crash."""

    async def run() -> None:
        hub = Hub(config, CATALOG, reraises=True)
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(hub.run())
            await hub.is_running.wait()
            await test(hub)
            running.cancel()

    with capture_logs():
        run_virtual(run())


async def visit(hub: Hub, infos: list[DeviceEndpoint], *, address: str = "10.0.0.2") -> None:
    device = ScriptedDevice(hub, infos, address=address)
    await asyncio.sleep(0.01)
    await device.aclose()
    await asyncio.sleep(0.01)


def known(hub: Hub) -> list[str]:
    return [robot.name for robot in hub.robots.all()]


def entries(thing: object, observed: set[int] | None = None) -> int:
    """Count the entries of an object's containers, and of those of the project's objects in it."""
    observed = set() if observed is None else observed
    if id(thing) in observed or isinstance(thing, (str, bytes, type)):
        return 0
    observed.add(id(thing))
    if isinstance(thing, dict):
        return len(thing) + sum(entries(each, observed) for pair in thing.items() for each in pair)
    if isinstance(thing, (list, tuple, set, frozenset, deque)):
        return len(thing) + sum(entries(each, observed) for each in thing)
    if not type(thing).__module__.startswith("hostlink.") or isinstance(thing, (Catalog, MessageType, Config)):
        return 0
    fields = [*getattr(thing, "__dict__", {}), *getattr(type(thing), "__slots__", ())]
    return sum(entries(getattr(thing, name, None), observed) for name in fields)


@pytest.mark.slow
def test_a_crowd_that_came_and_left_is_forgotten() -> None:
    async def check(hub: Hub) -> None:
        counts = []
        for number in range(300):
            await visit(hub, robot_topics(f"crowd_{number}"), address=f"10.0.{number % 7}.2")
            if number in (199, 299):
                counts.append(entries(hub))
        assert len(known(hub)) == MAX_AWAY
        assert hub.robots.forgotten == 300 - MAX_AWAY
        assert len(hub.services.all()) == 2 * MAX_AWAY
        assert counts[1] <= counts[0] * 1.02, counts
        await asyncio.sleep(FORGET_S)
        assert known(hub) == []
        assert hub.services.all() == []
        assert [each.name for each in hub.topics.all()] == ["/diagnostics", "/rosout"]

    with_hub(check)


def test_one_device_with_many_names_leaves_as_little() -> None:
    async def check(hub: Hub) -> None:
        device = ScriptedDevice(hub, [], address="10.0.0.2")
        for number in range(2 * MAX_AWAY):
            device.infos = robot_topics(f"name_{number}")
            await device.announce()
            await asyncio.sleep(0.01)
        assert len(known(hub)) == MAX_AWAY + 1
        await device.aclose()

    with_hub(check)


@pytest.mark.slow
def test_a_locked_robot_is_not_forgotten_and_is_locked_when_it_is_back() -> None:
    async def check(hub: Hub) -> None:
        await visit(hub, robot_topics("robot_0"))
        hub.robots.find("robot_0").lock("a person is near")
        for number in range(MAX_AWAY + 10):
            await visit(hub, robot_topics(f"crowd_{number}"), address=f"10.0.1.{number}")
        await asyncio.sleep(10 * FORGET_S)
        assert known(hub) == ["robot_0"]
        device = ScriptedDevice(hub, robot_topics("robot_0"), address="10.0.0.2")
        await asyncio.sleep(0.1)
        with pytest.raises(CommandRefused, match="a person is near"):
            drive_gate(hub.robots.find("robot_0"), PlanarVelocity(x_m_s=0.1), owner="test")
        await device.aclose()
        await asyncio.sleep(FORGET_S)
        hub.robots.find("robot_0").unlock()
        await asyncio.sleep(FORGET_S - 1.0)
        assert known(hub) == ["robot_0"]
        await asyncio.sleep(1.1)
        assert known(hub) == []

    with_hub(check)


def test_a_robot_that_is_driven_while_others_are_forgotten_drives_on() -> None:
    async def check(hub: Hub) -> None:
        device = ScriptedDevice(hub, robot_topics("robot_0"), address="10.0.0.9")
        await asyncio.sleep(0.1)
        robot = hub.robots.find("robot_0")
        for number in range(MAX_AWAY + 10):
            drive_gate(robot, PlanarVelocity(x_m_s=0.1), owner="test")
            await visit(hub, robot_topics(f"crowd_{number}"), address=f"10.0.1.{number}")
        assert robot.gate.owner_name == "test"
        await device.aclose()

    with_hub(check)


@pytest.mark.parametrize(
    ("steady_one", "rebooting_one"),
    [
        (robot_topics("robot_0"), robot_topics("robot_1")),
        (robot_topics("robot_0"), [topic(EndpointKind.PUBLISHER, 125, "/lidar", "std_msgs/Bool")]),
        (
            [topic(EndpointKind.PUBLISHER, 125, "/imu", "std_msgs/Bool")],
            [topic(EndpointKind.PUBLISHER, 125, "/lidar", "std_msgs/Bool")],
        ),
    ],
    ids=["robots", "a robot and a sensor", "sensors"],
)
def test_a_board_that_reboots_proves_nothing_about_another_behind_its_address(
    steady_one: list[DeviceEndpoint], rebooting_one: list[DeviceEndpoint]
) -> None:
    def codes(hub: Hub, device: ScriptedDevice) -> set[str]:
        return {each.code for each in hub.diagnoses.of(device.link)}

    async def check(hub: Hub) -> None:
        steady = ScriptedDevice(hub, steady_one, address="10.0.0.2")
        for _ in range(4):
            await visit(hub, rebooting_one)
        rebooting = ScriptedDevice(hub, rebooting_one, address="10.0.0.2")
        await asyncio.sleep(1.5)
        assert "reboots" in codes(hub, rebooting)
        assert "reboots" not in codes(hub, steady)
        for device in (steady, rebooting):
            await device.aclose()

    with_hub(check)


# -- what it costs ----------------------------------------------------------------------------------------------------


def flood(count: int) -> list[DeviceEndpoint]:
    """Publishers of poses and subscribers to velocities, which a person would pair one by one."""
    pairs = [
        [
            topic(EndpointKind.SUBSCRIBER, 100 + number, f"/n{number}/cmd_vel", "geometry_msgs/Twist"),
            topic(EndpointKind.PUBLISHER, 30_000 + number, f"/n{number}/odom", "geometry_msgs/Pose2D"),
        ]
        for number in range(count // 2)
    ]
    return [info for pair in pairs for info in pair]


def test_a_device_with_more_topics_than_are_allowed_has_so_many_and_no_more() -> None:
    async def check(hub: Hub) -> None:
        began_s = time.process_time()
        device = ScriptedDevice(hub, flood(4000), address="10.0.0.2")
        await asyncio.sleep(1.0)
        assert time.process_time() - began_s < 3.0  # 0.4 s; each with each took 11
        assert len(device.link.session.topics) == 256
        assert len(hub.topics.all()) < 270
        assert device.link.session.counts.excess_topics == 4000 - 256
        assert known(hub) == ["n0"]
        await device.aclose()

    with_hub(check)


@pytest.mark.slow
@pytest.mark.parametrize("is_alike", [True, False], ids=["flashed alike", "each its own"])
def test_cost_of_a_connection_is_independent_of_the_number_of_robots(is_alike: bool) -> None:
    def seconds(count: int) -> float:
        spent_s = 0.0

        async def check(hub: Hub) -> None:
            nonlocal spent_s
            began_s = time.process_time()
            devices = []
            for number in range(count):
                name = "robot_0" if is_alike else f"r{number}"
                address = f"10.1.{number // 250}.{number % 250}"
                devices.append(ScriptedDevice(hub, robot_topics(name), address=address))
                await asyncio.sleep(0.001)
            for device in devices:
                await device.aclose()
            spent_s = time.process_time() - began_s

        with_hub(check, Config())
        return spent_s

    assert is_linear(seconds, 50)


def test_twenty_thousand_subscriptions_of_one_topic_cost_little() -> None:
    graph = TopicGraph(CATALOG)
    began_s = time.process_time()
    subscriber = Subscriber(lambda _: None, Node("client"), "", lambda _: None)
    places = [graph.subscribe("/x", subscriber) for _ in range(20_000)]
    for place in reversed(places):
        graph.unsubscribe(*place)
    assert time.process_time() - began_s < 2.0  # 0.2 s; a copy of all for each took 16
    assert graph.all() == []
