"""Host: robots by handles, stops of all, the graph, devices and counters as values, and what ends with its run."""

import asyncio
import struct
import weakref
from collections import Counter
from collections.abc import Mapping
from functools import partial

import pytest

from hostlink.core.components import hosted
from hostlink.core.config import Config
from hostlink.core.host import LOCK_REASON, PROGRAM_PRIORITY, Host, PlanarVelocity, Role
from hostlink.core.robot.standstill import StandstillState
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE
from hostlink.errors import BadRequest, CommandRefused, ReloadRefused, UnknownTopic
from tests.support.hosts import host_of
from tests.support.memory_hub import MemoryHub, in_hub, velocities
from tests.support.virtual_loop import inside

FORWARD = PlanarVelocity(0.1)
ODOMETRY_ID = 125
POSE = struct.Struct("<3d")


# -- robots -----------------------------------------------------------------------------------------------------------


@inside(in_hub)
async def test_handle_drives_follows_and_measures_its_robot(made: MemoryHub) -> None:
    device = await made.connect()
    host = host_of(made.hub)
    me, robot, news = host.join("arm"), host.find("robot_0"), list[None]()
    assert (robot.name, robot.link, robot.odometry()) == ("robot_0", device.link.number, None)
    robot.follow(me, lambda: news.append(None))
    await device.send(ODOMETRY_ID, POSE.pack(1.0, 0.0, 0.0))
    await asyncio.sleep(0.05)
    odometry = robot.odometry()
    assert news
    assert odometry is not None
    assert odometry.pose is not None
    assert odometry.pose.x_m == 1.0
    assert robot.drive(me, FORWARD, priority=PROGRAM_PRIORITY, epoch=robot.epoch) == FORWARD
    assert (robot.answer(me), await robot.driven(me, FORWARD)) == (None, FORWARD)
    await asyncio.sleep(0.1)
    assert velocities(device)[-1] == (0.1, 0.0)
    assert robot.limited_by(PlanarVelocity(100.0)) == "max_linear_m_s"
    epoch, since_s = robot.epoch, host.now_s
    robot.stop(by="a button")
    assert robot.epoch != epoch
    ((state, standstill),) = await robot.measure(since_s, wait_s=0.5)
    assert (state.name, standstill.state) == ("robot_0", StandstillState.UNKNOWN)
    assert standstill.reason == robot.why_unknown()
    assert velocities(device)[-1] == (0.0, 0.0)


@inside(in_hub)
async def test_participant_that_has_left_is_kept_nowhere(made: MemoryHub) -> None:
    host, ends = host_of(made.hub), list[weakref.ref[object]]()
    for _ in range(3):
        end = Counter[str]()  # what the callback of a program refers to
        ends.append(weakref.ref(end))
        host.join("arm", on_end=partial(end.update, ("ended",))).leave()
    stays = host.join("arm")
    del end
    assert [each() for each in ends] == [None, None, None]
    host.close()
    assert stays.has_left


@inside(in_hub)
async def test_handle_locks_and_unlocks_its_robot(made: MemoryHub) -> None:
    await made.connect()
    host = host_of(made.hub)
    robot = host.find_to_stop("/robot_0")
    robot.lock(by="a button")
    assert robot.state().lock_reason == LOCK_REASON
    with pytest.raises(CommandRefused):
        robot.drive(host.join("arm"), FORWARD)
    robot.unlock(by="a button")
    assert robot.state().lock_reason is None
    assert robot.endpoints() == []


@inside(in_hub, config=Config())
async def test_handle_of_a_forgotten_robot_knows_it(made: MemoryHub) -> None:
    device = await made.connect()
    host = host_of(made.hub)
    robot = host.find("robot_0")
    motion = robot.recorded_motion()
    assert motion is not None
    assert motion[:3] == ("robot_0", ("/robot_0/odometry", "geometry_msgs/Pose2D"), "/robot_0/velocity_commands")
    await device.aclose()
    await asyncio.sleep(0.1)
    assert (robot.is_known, robot.link) == (True, None)
    made.hub.robots.forget("robot_0")
    assert (robot.is_known, robot.recorded_motion()) == (False, None)
    with pytest.raises(UnknownTopic):
        host.find("robot_0")


@inside(in_hub)
async def test_states_are_made_one_by_one(made: MemoryHub) -> None:
    await made.connect()
    host = host_of(made.hub)
    states = host.states()
    host.stops.lock("later", by="a button")
    assert [state.lock_reason for state in states] == ["later"]


@inside(in_hub)
async def test_stops_of_all_are_sent_at_once_and_measured(made: MemoryHub) -> None:
    device = await made.connect()
    host = host_of(made.hub)
    me = host.join("arm")
    host.find("robot_0").drive(me, FORWARD)
    since_s = host.now_s
    host.stops.stop(by="a button")
    assert (host.stops.endpoints(), await host.stops.settled()) == ([], [])
    ((state, standstill),) = await host.stops.measure(since_s, wait_s=0.1)
    assert (state.name, standstill.state) == ("robot_0", StandstillState.UNKNOWN)
    assert velocities(device)[-1] == (0.0, 0.0)
    host.stops.lock(by="a button")
    assert host.devices.all()["lock_reason"] == LOCK_REASON
    host.stops.unlock(by="a button")
    assert host.devices.all()["lock_reason"] is None


# -- values -----------------------------------------------------------------------------------------------------------


@inside(in_hub)
async def test_graph_names_topics_services_and_nodes(made: MemoryHub) -> None:
    await made.connect()
    host = host_of(made.hub)
    graph, me = host.graph, host.join("client 1 (a browser)")
    me.advertise("/chatter", "std_msgs/String")

    async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
        return {}

    me.provide("/reset", "std_srvs/Empty", answer)
    assert (graph.publishers("chatter"), graph.subscribers("/chatter")) == ({"/client_1"}, set())
    assert graph.publishers("/robot_0/odometry") == {"/robot_0"}
    assert (graph.provider("/reset"), graph.provider("/other")) == ("/client_1", "")
    assert graph.nodes() == {"/hostlink", "/robot_0", "/client_1"}
    publishers, _, providers = graph.by_node()
    assert (publishers["/chatter"], providers["/reset"]) == ({"/client_1"}, {"/client_1"})
    chatter, velocity = graph.topic("chatter"), graph.velocity_topic("/robot_0/cmd_vel")
    assert chatter is not None
    assert (chatter.name, chatter.type_name, chatter.is_published) == ("/chatter", "std_msgs/String", True)
    assert velocity is not None
    assert velocity[:2] == ("/robot_0/cmd_vel", TWIST_TYPE)
    assert graph.velocity_topic("/chatter") is graph.velocity_topic("/none") is graph.topic("/none") is None
    (robot,) = graph.robots()
    assert robot.velocity_topics["/robot_0/cmd_vel_stamped"] == TWIST_STAMPED_TYPE
    with pytest.raises(UnknownTopic):
        graph.publishers("/none")


@inside(in_hub)
async def test_measures_are_copies_of_the_counters(made: MemoryHub) -> None:
    device = await made.connect()
    host = host_of(made.hub)
    made.hub.counts.refused["no_key"] += 1
    found = host.measures.daemon()
    made.hub.counts.refused["no_key"] += 1
    assert (found.links, found.refused, found.fleet_robots) == (1, {"no_key": 1}, {})
    assert found.kept["queues"] == (0, 0)
    host.find("robot_0").drive(host.join("arm"), FORWARD)
    ((robot,), (link,)) = list(host.measures.robots()), list(host.measures.links())
    assert (robot.name, robot.is_connected, robot.is_driven, robot.commanded) == ("robot_0", True, True, FORWARD)
    assert (link.robot, link.address) == ("robot_0", device.link.address)


@inside(in_hub)
async def test_capture_of_an_unknown_link_names_the_known_ones(made: MemoryHub) -> None:
    device = await made.connect()
    host = host_of(made.hub)
    number = device.link.number
    found = host.devices.capture(number)
    assert (found.number, found.protocol, found.lost, found.seconds) == (number, "rosserial", (0, 0), None)
    assert sum(len(data) for _, is_from_device, data in found.pieces if is_from_device) == found.position[0]
    with pytest.raises(UnknownTopic, match=str(number)):
        host.devices.capture(None, shown="none")


# -- its end ----------------------------------------------------------------------------------------------------------


@inside(in_hub, reraises=False)
async def test_crash_of_work_that_is_not_vital_ends_nothing_else(made: MemoryHub) -> None:
    async def crash() -> None:
        raise ValueError

    async with hosted(made.hub, "gateway", Counter()) as host:
        host.spawn(crash(), name="a connection", is_vital=False)
        await asyncio.sleep(0.1)
        me = host.join("client 1")
        assert not me.has_left
    assert made.hub.isolation.crashes["task"] == 1
    assert me.has_left


@inside(in_hub, reraises=False)
async def test_service_of_the_daemon_precedes_and_outlives_a_failure(made: MemoryHub) -> None:
    async with hosted(made.hub, "gateway", Counter()) as host:
        daemon = host.join_as_daemon()

        async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
            return {}

        daemon.provide("/own", "std_srvs/Empty", answer)
        with pytest.raises(BadRequest, match="hostlink's own"):
            host.join("a program").provide("/own", "std_srvs/Empty", answer)
        daemon.fail(ValueError("a bug"))
        assert not daemon.has_left
        assert daemon.role is Role.DRIVE
    assert daemon.has_left
    assert host.graph.services() == [(name, "std_srvs/Trigger") for name, _ in host.graph.services()]


@inside(in_hub)
async def test_check_of_a_reload_ends_with_the_run(made: MemoryHub) -> None:
    async with hosted(made.hub, "gateway", Counter()) as host:
        host.on_reload(lambda _: lambda: None)
        assert len(made.hub.reloader.prepares) == 1
        with pytest.raises(ReloadRefused):
            await host.reload()
    assert made.hub.reloader.prepares == []


@inside(in_hub)
async def test_parameter_that_a_component_changes_is_one_for_devices(made: MemoryHub) -> None:
    host: Host = host_of(made.hub)
    host.parameters["/gain"] = 2.5
    assert made.hub.parameters["/gain"] == 2.5
