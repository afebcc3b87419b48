"""Two daemons of a fleet in one process, without a network and in virtual time."""

import asyncio
import contextlib
import functools
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from hostlink.components.zenoh import fleet_commands
from hostlink.components.zenoh.fleet import FIND_INTERVAL_S, fleet_running, sender_name
from hostlink.components.zenoh.fleet_commands import FleetDrivers
from hostlink.components.zenoh.fleet_messages import (
    ANSWER,
    FleetAnswer,
    FleetCommand,
    FleetTransport,
    Keys,
    Sender,
    State,
    Stop,
    Unlock,
    encode,
)
from hostlink.components.zenoh.roster import SILENT_S, FleetRoster
from hostlink.components.zenoh.session import ZenohSample, ZenohSession
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.components import hosted, supervise
from hostlink.core.config import Config
from hostlink.core.host import Component, Host
from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import BadRequest, CommandRefused, DeviceGone, HostlinkError, RefusalKind
from tests.support.background import meanwhile
from tests.support.fake_device import CATALOG, topic
from tests.support.hosts import host_in
from tests.support.memory_zenoh import MemoryNetwork, MemorySession
from tests.support.participants import (
    NEIGHBOUR,
    ODOMETRY_ID,
    POSE,
    ROBOT,
    Scene,
    ScriptedDevice,
    play,
    publish,
    robot_topics,
)
from tests.support.virtual_loop import inside

DRIVE = PlanarVelocity(0.2)
ODOMETRY = f"/{ROBOT}/odometry"


class World:
    """The daemon `lab` has the robots of the scene; a program at `desk` uses them."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.network = scene, MemoryNetwork()
        self.slept_s = 0.0  # the computer of the desk
        self.desk = Hub(Config(), CATALOG, slept_s=lambda: self.slept_s)
        self.stack = contextlib.AsyncExitStack()

    async def begin(self, drivers: tuple[str, ...]) -> None:
        self.running = self.scene.tasks.create_task(self.desk.run())
        await self.desk.is_running.wait()
        for hub, name, zid in ((self.scene.hub, "lab", "1a"), (self.desk, "desk", "2b")):
            self.desk_session = MemorySession(self.network, zid)
            session = cast("ZenohSession", self.desk_session)
            config = ZenohSettings(name=name, drivers=drivers)
            host = await self.stack.enter_async_context(hosted(hub, "zenoh", Counter()))
            await self.stack.enter_async_context(fleet_running(host, session, config))
        await asyncio.sleep(2.0)  # the second state of a robot has its topics
        self.program = self.desk.join("client 3")

    async def end(self) -> None:
        self.program.leave()
        await self.stack.aclose()
        assert self.desk.robots.remote == {}
        assert self.desk.isolation.crashes == {}
        self.running.cancel()

    def robot(self) -> AnyRobot:
        return self.desk.robots.find(ROBOT)

    async def drive(self, velocity: PlanarVelocity = DRIVE) -> PlanarVelocity:
        self.program.drive(self.robot(), velocity)
        return await self.program.driven(self.robot(), velocity)

    def counts(self, hub: Hub) -> dict[str, int]:
        return dict(hub.counts.components["fleet"]())


def with_fleet(test: Callable[[World], Awaitable[None]], *, drivers: tuple[str, ...] = ("*",)) -> None:
    async def run(scene: Scene) -> None:
        world = World(scene)
        await world.begin(drivers)
        try:
            await test(world)
        finally:
            await world.end()

    play(run)


@pytest.mark.parametrize(
    ("host", "name"),
    [("lab-1.local", "lab-1.local"), ("a b/*$", "a-b---"), ("", "host"), ("x" * 65, "x" * 64), ("a_b", "a_b")],
)
def test_sender_has_the_name_of_its_host_as_far_as_a_key_can_have_it(host: str, name: str) -> None:
    assert sender_name(host) == name


@inside(with_fleet)
async def test_robot_of_another_daemon_is_shown_with_its_host_and_topics(world: World) -> None:
    assert set(world.desk.robots.remote) == {ROBOT, NEIGHBOUR}
    robot = world.robot()
    assert (robot.host, robot.link is not None) == ("lab", True)
    assert world.desk.topics.find(ODOMETRY).type_name == "geometry_msgs/Pose2D"
    assert world.scene.hub.robots.remote == {}


@inside(with_fleet)
async def test_each_of_two_commands_that_are_sent_at_once_has_its_own_answer(world: World) -> None:
    def answer(velocity: PlanarVelocity) -> Awaitable[PlanarVelocity]:
        world.program.drive(world.robot(), velocity)
        found = world.robot().answer(world.program)
        assert found is not None
        return found

    first, second = answer(DRIVE), answer(ZERO)
    assert (await first, await second) == (DRIVE, ZERO)
    world.scene.hub.robots.find(ROBOT).lock("test")
    first, second = answer(DRIVE), answer(ZERO)
    with pytest.raises(CommandRefused, match="locked"):
        await first
    assert await second == ZERO


@inside(with_fleet)
async def test_commands_are_answered_in_order_while_their_daemon_becomes_known(world: World) -> None:
    """Three commands arrive before its token was read, and one between the token and their delivery."""
    wall, keys, answers = MemorySession(world.network, "3c"), Keys(ZenohSettings().fleet_name), list[int]()
    here, there = Sender("lab", "1a"), Sender("wall", "3c")

    def drive(number: int) -> None:
        command = FleetCommand(
            number=number, epoch=None, sent_s=0.0, robot=ROBOT, owner=1, owner_name="client 1",
            velocity=(0.0,) * 6, priority=50,
        )  # fmt: skip
        wall.put(keys.key("drive", there, to=here.zid), encode(command))

    def receive(sample: ZenohSample) -> None:
        answers.append(ANSWER.decode(sample.payload).number)

    wall.subscribe(keys.key("answer", here, to=there.zid), receive)
    wall.declare_token(keys.key("alive", there))
    asyncio.get_running_loop().call_soon(drive, 4)
    for number in (1, 2, 3):
        drive(number)
    await asyncio.sleep(0.1)
    assert answers == [1, 2, 3, 4]


@inside(with_fleet)
async def test_program_drives_a_robot_of_another_daemon_and_its_leave_stops_it(world: World) -> None:
    assert (await world.drive()).x_m_s == 0.2
    assert world.scene.speeds()[-1] == 0.2
    assert world.scene.hub.robots.find(ROBOT).gate.owner_name == "client 3 at desk"
    world.program.leave()
    await asyncio.sleep(0.05)
    assert world.scene.speeds()[-1] == 0.0


@inside(with_fleet)
async def test_lease_of_a_robot_ends_at_its_daemon(world: World) -> None:
    await world.drive()
    await asyncio.sleep(0.6)
    assert world.scene.speeds()[-1] == 0.0


@inside(with_fleet, drivers=("wall*",))
async def test_daemon_that_may_not_drive_is_refused_and_may_send_zero_and_stop(world: World) -> None:
    with pytest.raises(BadRequest, match=r"may only read at lab \(zenoh.drivers there\)"):
        await world.drive()
    assert world.counts(world.scene.hub)["refused"] == 1
    await world.drive(ZERO)
    world.scene.neighbour.drive(world.scene.hub.robots.find(ROBOT), DRIVE)
    await asyncio.sleep(0.05)
    assert world.scene.speeds()[-1] == 0.2
    world.desk.robots.stop_all()
    await asyncio.sleep(0.05)
    assert world.scene.speeds()[-1] == 0.0


@pytest.mark.parametrize(("pattern", "may_drive"), [("desk", True), ("de*", True), ("DESK", False), ("", False)])
def test_drivers_are_matched_by_pattern(pattern: str, *, may_drive: bool) -> None:
    async def test(world: World) -> None:
        with contextlib.nullcontext() if may_drive else pytest.raises(BadRequest):
            await world.drive()

    with_fleet(test, drivers=(pattern,))


@inside(with_fleet)
async def test_refusal_by_the_other_daemon_keeps_kind_and_owner(world: World) -> None:
    world.scene.neighbour.drive(world.scene.hub.robots.find(ROBOT), DRIVE, priority=90)
    with pytest.raises(CommandRefused) as caught:
        await world.drive()
    assert caught.value.kind is RefusalKind.HELD
    assert "neighbour" in str(caught.value.holder)


@inside(with_fleet)
async def test_refusal_reaches_a_driver_that_waits_for_no_answer_with_its_next_command(world: World) -> None:
    world.scene.neighbour.drive(world.scene.hub.robots.find(ROBOT), DRIVE, priority=90)
    world.program.drive(world.robot(), DRIVE)
    await asyncio.sleep(0.05)
    with pytest.raises(CommandRefused):
        world.program.drive(world.robot(), DRIVE)


@inside(with_fleet)
async def test_lock_at_one_daemon_holds_at_all_until_any_unlocks(world: World) -> None:
    world.robot().lock("crossing")
    await asyncio.sleep(0.1)
    here = world.scene.hub.robots.find(ROBOT)
    assert here.gate.lock_reason == "crossing (desk)"
    assert world.robot().state(now_s()).lock_reason == "crossing (desk)"
    with pytest.raises(HostlinkError):
        await world.drive()
    world.robot().unlock()
    await asyncio.sleep(0.1)
    assert here.gate.lock_reason is None


@inside(with_fleet)
async def test_unlock_without_an_answer_is_not_repeated_after_a_later_lock(world: World) -> None:
    here = world.scene.hub.robots.find(ROBOT)
    here.lock("smoke")
    await asyncio.sleep(0.1)
    world.network.deaf.add("2b")
    world.robot().unlock()
    await asyncio.sleep(0.02)
    assert here.gate.lock_reason is None
    here.lock("fire")
    with pytest.raises(DeviceGone, match="has not answered the unlock"):
        await world.desk.gates.settled()
    assert here.gate.lock_reason == "fire"


@inside(with_fleet)
async def test_stop_of_a_dead_daemon_is_reported(world: World) -> None:
    world.network.deaf.add("1a")
    world.desk.robots.stop_all()
    with capture_logs() as logs:
        await asyncio.sleep(2.0)
    assert [(line["what"], line["hosts"]) for line in logs if line["event"] == "fleet.unanswered"] == [
        ("stop", ["lab"])
    ]


@inside(with_fleet)
async def test_stop_that_a_daemon_does_not_answer_is_an_error_for_the_caller(world: World) -> None:
    world.desk.robots.stop_all()
    await world.desk.gates.settled()
    world.network.deaf.add("1a")
    world.desk.robots.stop_all()
    with pytest.raises(DeviceGone, match="lab: has not answered the stop; what is here has"):
        await world.desk.gates.settled()


@inside(with_fleet)
async def test_pose_of_a_robot_of_another_daemon_follows_while_it_is_read(world: World) -> None:
    robot = world.robot()
    for x_m in (1.0, 2.0, 3.0):
        robot.odometry.snapshot(now_s())
        await asyncio.sleep(0.25)  # less than the time between two states
        await world.scene.robot.send(ODOMETRY_ID, POSE.pack(x_m, 0.0, 0.0))
    await asyncio.sleep(0.25)
    found = robot.odometry.snapshot(now_s())
    assert found.pose.x_m == 3.0


@inside(with_fleet)
async def test_command_without_an_answer_is_refused_after_the_lease(world: World) -> None:
    world.network.deaf.add("1a")
    with pytest.raises(DeviceGone, match="lab does not answer"):
        await world.drive()


@inside(with_fleet)
async def test_daemon_that_is_lost_keeps_its_robots_as_not_connected_and_its_drivers_stop(world: World) -> None:
    await world.drive()
    world.network.drop("2b")
    await asyncio.sleep(0.05)
    assert world.scene.speeds()[-1] == 0.0
    world.network.drop("1a")
    await asyncio.sleep(0.1)
    assert world.robot().link is None
    with pytest.raises(CommandRefused) as caught:
        await world.drive()
    assert caught.value.kind is RefusalKind.NOT_CONNECTED


@inside(with_fleet)
async def test_silent_daemon_is_not_driven_until_it_sends_again(world: World) -> None:
    world.network.deaf.add("2b")
    await asyncio.sleep(SILENT_S + 0.5)
    assert world.robot().link is None
    world.network.deaf.clear()
    await asyncio.sleep(2.0)
    assert world.robot().link is not None


@inside(with_fleet)
async def test_topic_is_sent_while_the_other_daemon_subscribes(world: World) -> None:
    heard: list[bytes] = []
    subscription = world.program.subscribe(ODOMETRY, lambda message: heard.append(message.payload))
    await asyncio.sleep(0.3)
    await world.scene.robot.send(125, bytes(24))
    await asyncio.sleep(0.1)
    assert len(heard) == 1
    subscription.close()
    await asyncio.sleep(0.3)
    await world.scene.robot.send(125, bytes(24))
    await asyncio.sleep(0.1)
    assert len(heard) == 1


@inside(with_fleet)
async def test_one_name_at_two_daemons_is_logged_and_driven_only_where_it_is(world: World) -> None:
    with capture_logs() as logs:
        ScriptedDevice(world.desk, robot_topics(ROBOT), address="10.0.0.7")
        await asyncio.sleep(2.0)
    found = [line for line in logs if line["event"] == "fleet.duplicate_name_found"]
    assert {line["robot"] for line in found} == {ROBOT}
    assert (world.robot().host, world.robot().also_at) == (None, ("lab",))
    before = world.scene.speeds()
    await world.drive()
    assert world.scene.speeds() == before


# -- requests of another daemon, one by one ---------------------------------------------------------------------------


class Requests:
    """Requests of a daemon `desk` to the drivers of this one."""

    def __init__(self, scene: Scene, drivers: tuple[str, ...] = ("*",)) -> None:
        self.sent: list[bytes] = []
        self.counts: Counter[str] = Counter()
        self.keys, self.here, self.desk = Keys("fleet"), Sender("lab", "1a"), Sender("desk", "2b")

        class Answers:
            put = staticmethod(lambda _key, payload, **_: self.sent.append(payload))

        self.roster = FleetRoster(self.counts)
        transport = FleetTransport(cast("ZenohSession", Answers()), self.keys, self.here, self.counts, drivers)
        self.drivers = FleetDrivers(host_in(scene.hub, "fleet"), transport, self.roster)
        self.roster.appear(self.desk, now_s())

    def hear(self) -> None:
        self.roster.receive(self.desk, State(sent_s=now_s(), topics=0, robots=()), now_s())

    def request(self, request: object, sender: Sender | None = None) -> FleetAnswer | None:
        self.drivers.receive(ZenohSample(self.keys.key("drive", sender or self.desk, to="1a"), encode(request)))
        return ANSWER.decode(self.sent.pop()) if self.sent else None

    def drive(self, *, owner: int = 1, speed_m_s: float = 0.2, robot: str = ROBOT) -> FleetAnswer:
        velocity = (speed_m_s, 0.0, 0.0, 0.0, 0.0, 0.0)
        answer = self.request(
            FleetCommand(
                number=5, sent_s=now_s(), robot=robot, owner=owner, owner_name="pad", velocity=velocity, priority=10
            )
        )
        assert answer.number == 5
        return answer


def now_s() -> float:
    return asyncio.get_running_loop().time()


@inside(play)
async def test_role_is_checked_before_a_participant_is_made(scene: Scene) -> None:
    requests = Requests(scene, drivers=())
    requests.hear()
    assert requests.drive(robot="robot_9").error == "BadRequest"
    assert requests.drive().error == "BadRequest"
    assert requests.drivers._drivers == {}
    answer = requests.request(Unlock(number=6, robot=ROBOT))
    assert answer.error == "BadRequest"
    assert requests.counts["refused"] == 3


@inside(play)
async def test_drivers_of_one_daemon_are_bounded_and_the_oldest_leaves(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleet_commands, "MAX_DRIVERS", 2)
    requests = Requests(scene)
    requests.hear()
    for owner in (1, 2, 1, 3):
        requests.drive(owner=owner, speed_m_s=0.0)
    assert list(requests.drivers._drivers["2b"]) == [1, 3]
    assert requests.counts["excess_drivers"] == 1
    requests.drivers.tick(now_s() + fleet_commands.IDLE_S - 0.1)
    assert list(requests.drivers._drivers["2b"]) == [1, 3]
    requests.drivers.tick(now_s() + fleet_commands.IDLE_S + 0.1)
    assert requests.drivers._drivers == {}


@inside(play)
async def test_command_of_a_daemon_that_has_sent_no_state_is_refused(scene: Scene) -> None:
    requests = Requests(scene)
    answer = requests.drive()
    assert (answer.error, "just met" in answer.reason) == ("DeviceGone", True)
    requests.hear()
    assert requests.drive().velocity == (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)


@inside(play)
async def test_request_of_an_unknown_daemon_or_without_sense_is_counted_and_not_answered(scene: Scene) -> None:
    requests = Requests(scene)
    assert requests.request(Unlock(number=6, robot=ROBOT), Sender("wall", "3c")) is None
    assert requests.request({"type": "nonsense"}) is None
    assert (requests.counts["unannounced"], requests.counts["malformed"]) == (1, 1)


@inside(play)
async def test_answer_has_the_epoch_of_the_robot_after_an_interruption(scene: Scene) -> None:
    requests = Requests(scene)
    requests.hear()
    before = requests.drive().epoch
    scene.hub.robots.find(ROBOT).stop()
    answer = requests.drive()
    assert before is not None
    assert answer.epoch is not None
    assert answer.epoch > before
    assert answer.error != ""


@inside(play)
async def test_robot_with_several_places_is_driven_by_no_other_daemon(scene: Scene) -> None:
    requests = Requests(scene)
    requests.hear()
    scene.hub.robots.find(ROBOT).also_at = ("desk",)
    assert "also at desk" in requests.drive().reason
    assert requests.drive(speed_m_s=0.0).error == ""


@inside(play)
async def test_messages_of_another_daemons_programs_are_of_no_driver_there(scene: Scene) -> None:
    requests = Requests(scene)
    requests.hear()
    requests.drive(owner=1)
    neighbour = requests.drivers._roster.announced(requests.desk)
    assert neighbour is not None
    scene.neighbour.subscribe("/door", lambda _: None, type_name="std_msgs/Bool")
    for _ in range(2):
        with contextlib.suppress(HostlinkError):
            requests.drivers.publish(neighbour, "/door", b"\1")
    drivers = list(requests.drivers._drivers["2b"].values())
    assert len(drivers) == 2
    assert sorted(driver.participant.name for driver in drivers) == ["pad at desk", "programs at desk"]


@inside(with_fleet)
async def test_motions_are_sent_between_states_only_while_they_are_read(world: World) -> None:
    sent: Counter[str] = Counter()
    listener = MemorySession(world.network, "3c")
    live, state = (
        next(each.key for each in world.network.publishers if f"/{kind}/" in f"{each.key}/" and "1a" in each.key)
        for kind in ("live", "state")
    )

    async def moved(seconds: float) -> Counter[str]:
        sent.clear()
        for number in range(int(seconds / 0.1)):
            await world.scene.robot.send(ODOMETRY_ID, POSE.pack(0.01 * number, 0.0, 0.0))
            await asyncio.sleep(0.1)
        return sent

    for key in (state, live):
        listener.subscribe(key, lambda sample: sent.update((sample.key,)))
        counts = await moved(5.0)
        assert 4 <= counts[state] <= 6
        assert (counts[live] > 2 * counts[state]) is (key == live)


@inside(play)
async def test_end_of_the_fleet_here_stops_what_drivers_at_other_daemons_drive(scene: Scene) -> None:
    requests = Requests(scene)
    requests.hear()
    await asyncio.sleep(0.5)
    assert requests.drive().error == ""
    await asyncio.sleep(0.05)
    assert scene.speeds()[-1] == 0.2
    requests.drivers.leave_all()
    await asyncio.sleep(0.05)
    assert (scene.speeds()[-1], requests.drivers._drivers) == (0.0, {})


@pytest.mark.parametrize(("early_m_s", "is_refused"), [(0.2, True), (0.0, False)])
@inside(play)
async def test_driver_that_commanded_before_the_robot_existed_does_not_move_it(
    scene: Scene, early_m_s: float, *, is_refused: bool
) -> None:
    requests = Requests(scene)
    requests.hear()
    assert requests.drive(robot="robot_9", speed_m_s=early_m_s).error == "UnknownTopic"
    device = ScriptedDevice(scene.hub, robot_topics("robot_9"), address="10.0.0.9")
    await asyncio.sleep(0.2)
    requests.hear()
    assert (requests.drive(robot="robot_9").error != "") is is_refused
    await device.aclose()


@inside(with_fleet)
async def test_daemons_are_found_again_after_a_token_may_have_been_dropped(world: World) -> None:
    subscribed: list[str] = []
    session: Any = next(each[0] for each in world.network.subscribers if each[0].zid == "1a")
    subscribe = session.subscribe_tokens
    session.subscribe_tokens = lambda keys, receive: subscribed.append(keys) or subscribe(keys, receive)
    await asyncio.sleep(2 * FIND_INTERVAL_S)
    assert subscribed == []
    session.counts["dropped"] += 1
    await asyncio.sleep(1.0)
    assert len(subscribed) == 1
    for _ in range(20):
        session.counts["dropped"] += 1
        await asyncio.sleep(FIND_INTERVAL_S / 10)
    assert 2 <= len(subscribed) <= 3


# -- hosts that are out of sight --------------------------------------------------------------------------------------


class Cut:
    """Network between `lab` and `desk`, which is cut and healed."""

    def __init__(self, world: World) -> None:
        self.network = world.network
        self.tokens = [key for key in self.network.tokens if "/alive/" in key]

    def cut(self) -> None:
        self.network.deaf |= {"1a", "2b"}
        for zid in ("1a", "2b"):
            self.network.drop(zid)

    def heal(self) -> None:
        self.network.deaf.clear()
        for key in self.tokens:
            self.network.note_token(key, is_alive=True)


@contextlib.asynccontextmanager
async def driven_at_lab(world: World) -> AsyncIterator[LocalRobot]:
    """A program at the robot's own daemon drives it and ignores refusals."""
    robot = world.scene.hub.robots.find(ROBOT)
    assert isinstance(robot, LocalRobot)

    async def go_on() -> None:
        while True:
            with contextlib.suppress(HostlinkError):
                world.scene.neighbour.drive(robot, DRIVE)
            await asyncio.sleep(0.1)

    async with meanwhile(go_on()):
        await asyncio.sleep(0.3)
        assert world.scene.speeds()[-1] == 0.2
        yield robot


@pytest.mark.slow
@pytest.mark.parametrize("seen_s", [0.0, 1.0, 100.0])
def test_stop_of_a_host_out_of_sight_is_an_error_and_in_force_when_it_is_seen_again(seen_s: float) -> None:
    async def test(world: World) -> None:
        cut = Cut(world)
        async with driven_at_lab(world):
            cut.cut()
            await asyncio.sleep(seen_s)
            for stop in (world.desk.robots.stop_all, world.robot().stop):
                stop()
                with pytest.raises(DeviceGone, match="lab: has not answered the stop"):
                    await world.desk.gates.settled()
            await asyncio.sleep(seen_s)
            assert world.scene.speeds()[-1] == 0.2
            cut.heal()
            await asyncio.sleep(1.0)
            assert world.scene.speeds()[-1] == 0.0

    with_fleet(test)


ORDERS: dict[str, Callable[[World], object]] = {
    "stop of all": lambda world: world.desk.robots.stop_all(),
    "stop by name": lambda world: world.robot().stop(),
    "lock of all": lambda world: world.desk.robots.lock_all("crossing"),
    "lock by name": lambda world: world.robot().lock("crossing"),
}


@pytest.mark.parametrize("way_s", [0.2, 0.8])
@pytest.mark.parametrize("order", ORDERS)
def test_order_over_a_slow_network_is_in_force_when_it_arrives_and_an_error_if_that_is_late(
    order: str, way_s: float
) -> None:
    async def test(world: World) -> None:
        sent = world.desk_session.put

        def put(key: str, payload: bytes, **options: Any) -> None:
            asyncio.get_running_loop().call_later(way_s, functools.partial(sent, key, payload, **options))

        async with driven_at_lab(world) as there:
            world.desk_session.put = put  # type: ignore[method-assign]
            ORDERS[order](world)
            with (
                pytest.raises(DeviceGone, match="lab: has not answered the")
                if way_s > 0.5
                else contextlib.nullcontext()
            ):
                await world.desk.gates.settled()
            await asyncio.sleep(1.0)
            assert world.scene.speeds()[-1] == 0.0
            assert there.gate.lock_reason == ("crossing (desk)" if "lock" in order else None)
            world.scene.hub.robots.unlock_all()

    with_fleet(test)


@pytest.mark.slow
@inside(with_fleet)
async def test_lock_of_a_host_out_of_sight_is_shown_refuses_and_is_in_force_when_it_is_seen_again(world: World) -> None:
    cut = Cut(world)
    async with driven_at_lab(world) as there:
        cut.cut()
        await asyncio.sleep(2.0)
        world.robot().lock("crossing")
        assert world.robot().state(now_s()).lock_reason == "crossing (desk)"
        with pytest.raises(DeviceGone, match="lab: has not answered the lock"):
            await world.desk.gates.settled()
        with pytest.raises(CommandRefused) as caught:
            await world.drive()
        assert caught.value.kind is RefusalKind.LOCKED
        await asyncio.sleep(60.0)
        cut.heal()
        await asyncio.sleep(1.5)
        assert there.gate.lock_reason == "crossing (desk)"
        assert world.scene.speeds()[-1] == 0.0
        assert world.robot().state(now_s()).lock_reason == "crossing (desk)"
        world.robot().unlock()
        await world.desk.gates.settled()
        await asyncio.sleep(1.5)
        assert (there.gate.lock_reason, world.robot().state(now_s()).lock_reason) == (None, None)


@inside(with_fleet)
async def test_unlock_of_a_host_out_of_sight_is_an_error_and_withdraws_the_lock(world: World) -> None:
    cut = Cut(world)
    cut.cut()
    await asyncio.sleep(2.0)
    world.robot().lock("crossing")
    with pytest.raises(DeviceGone):
        await world.desk.gates.settled()
    world.robot().unlock()
    assert world.robot().state(now_s()).lock_reason is None
    with pytest.raises(DeviceGone, match="lab: has not answered the unlock"):
        await world.desk.gates.settled()
    cut.heal()
    await asyncio.sleep(2.0)
    assert world.scene.hub.robots.find(ROBOT).gate.lock_reason is None


@inside(with_fleet)
async def test_stop_of_a_daemon_that_is_silent_is_an_error(world: World) -> None:
    world.network.deaf.add("2b")
    await asyncio.sleep(SILENT_S + 0.5)
    world.desk.robots.stop_all()
    with pytest.raises(DeviceGone, match="lab: has not answered the stop"):
        await world.desk.gates.settled()


LEFT_MOTOR, SPEECH = 110, 111  # ids of the topics of a board that is not a robot
NUMBER = b"\x32\x00"


@contextlib.asynccontextmanager
async def board_at_lab(world: World) -> AsyncIterator[ScriptedDevice]:
    """A board that no rule recognises, with a motor that runs and a topic without a zero; unlocked at the end."""
    infos = [
        topic(EndpointKind.SUBSCRIBER, LEFT_MOTOR, "/left_motor", "std_msgs/Int16"),
        topic(EndpointKind.SUBSCRIBER, SPEECH, "/motor_command", "std_msgs/String"),
    ]
    device = ScriptedDevice(world.scene.hub, infos, address="10.0.0.9")
    await asyncio.sleep(0.5)
    publish(world.scene.hub, "/left_motor", NUMBER, type_name="std_msgs/Int16")
    await asyncio.sleep(0.5)
    assert device.payloads(LEFT_MOTOR) == [NUMBER]
    yield device
    world.scene.hub.robots.unlock_all()
    await device.aclose()
    await asyncio.sleep(0.5)


@pytest.mark.parametrize("verb", ["stop", "lock"])
def test_stop_and_lock_of_all_cover_the_boards_of_another_daemon_and_name_them(verb: str) -> None:
    async def test(world: World) -> None:
        async with board_at_lab(world) as device:
            robots, is_locked = world.desk.robots, verb == "lock"
            assert (robots.lock_all("a foot") if is_locked else robots.stop_all()) == []  # none is here
            found = {each.topic: each for each in await world.desk.gates.settled()}
            assert device.payloads(LEFT_MOTOR) == [NUMBER, bytes(2)]
            assert {each.host for each in found.values()} == {"lab"}
            assert {name: (each.is_locked, each.reason) for name, each in found.items()} == {
                "/left_motor": (is_locked, ""),
                "/motor_command": (is_locked, "std_msgs/String has no value that surely means stop"),
            }

    with_fleet(test)


@inside(with_fleet)
async def test_lock_of_all_holds_at_another_daemon_until_the_unlock_of_all(world: World) -> None:
    lab = world.scene.hub
    async with board_at_lab(world) as device:
        world.desk.robots.lock_all("a foot")
        await world.desk.gates.settled()
        with pytest.raises(CommandRefused, match=re.escape("/left_motor: locked: a foot (desk)")):
            publish(lab, "/left_motor", NUMBER, type_name="std_msgs/Int16")
        assert lab.robots.find(ROBOT).gate.lock_reason == "a foot (desk)"
        world.desk.robots.unlock_all()
        await world.desk.gates.settled()
        assert lab.robots.find(ROBOT).gate.lock_reason is None
        publish(lab, "/left_motor", NUMBER, type_name="std_msgs/Int16")
        await asyncio.sleep(0.5)
        assert device.payloads(LEFT_MOTOR)[-1] == NUMBER
        lab.robots.lock_all("a cable")  # what was locked there is unlocked from the desk, too
        await asyncio.sleep(1.5)
        world.desk.robots.unlock_all()
        await world.desk.gates.settled()
        assert lab.robots.boards.lock_reason is None
        assert lab.robots.find(ROBOT).gate.lock_reason is None


@pytest.mark.slow
@inside(with_fleet)
async def test_lock_of_all_is_in_force_at_a_host_out_of_sight_when_it_is_seen_again(world: World) -> None:
    async with board_at_lab(world) as device:
        cut = Cut(world)
        cut.cut()
        await asyncio.sleep(2.0)
        world.desk.robots.lock_all("a foot")
        with pytest.raises(DeviceGone, match="lab: has not answered the lock"):
            await world.desk.gates.settled()
        assert device.payloads(LEFT_MOTOR) == [NUMBER]
        cut.heal()
        await asyncio.sleep(1.5)
        assert world.scene.hub.robots.boards.lock_reason == "a foot (desk)"
        assert set(device.payloads(LEFT_MOTOR)[1:]) == {bytes(2)}


@inside(with_fleet)
async def test_unlock_of_all_withdraws_a_lock_that_a_host_out_of_sight_has_not_heard(world: World) -> None:
    cut = Cut(world)
    cut.cut()
    await asyncio.sleep(2.0)
    world.desk.robots.lock_all("a foot")
    with contextlib.suppress(DeviceGone):
        world.desk.robots.unlock_all()
    cut.heal()
    await asyncio.sleep(2.0)
    assert world.scene.hub.robots.boards.lock_reason is None


def test_daemon_that_may_not_drive_locks_every_board_and_unlocks_none() -> None:
    async def test(world: World) -> None:
        async with board_at_lab(world):
            world.desk.robots.lock_all("a foot")
            await world.desk.gates.settled()
            world.desk.robots.unlock_all()
            with pytest.raises(DeviceGone, match="may only read"):
                await world.desk.gates.settled()
            assert world.scene.hub.robots.boards.lock_reason == "a foot (desk)"

    with_fleet(test, drivers=("nobody",))


@inside(with_fleet)
async def test_order_of_an_earlier_caller_is_not_waited_for_by_a_later_one(world: World) -> None:
    world.network.deaf.add("1a")
    world.desk.robots.stop_all()
    with pytest.raises(DeviceGone):
        await world.desk.gates.settled()
    before_s = now_s()
    await world.desk.gates.settled()
    assert now_s() == before_s


@inside(with_fleet)
async def test_lock_for_a_host_out_of_sight_holds_for_its_robot_here(world: World) -> None:
    Cut(world).cut()
    await asyncio.sleep(2.0)
    world.robot().lock("crossing")
    device = ScriptedDevice(world.desk, robot_topics(ROBOT), address="10.0.0.7")
    await asyncio.sleep(1.0)
    robot = world.desk.robots.find(ROBOT)
    assert (robot.host, robot.state(now_s()).lock_reason) == (None, "crossing (desk)")
    await device.aclose()


@inside(with_fleet)
async def test_program_that_sees_no_answers_drives_no_robot_of_another_host(world: World) -> None:
    """The daemon of the program is deaf: its commands arrive, and no user there sees what the robot does."""
    await world.drive()
    world.network.deaf.add("2b")
    refusals: list[str] = []
    for _ in range(30):
        try:
            world.program.drive(world.robot(), DRIVE)
        except HostlinkError as error:
            refusals.append(str(error))
        await asyncio.sleep(0.05)
    assert any("lab does not answer" in text for text in refusals)
    assert world.scene.speeds()[-1] == 0.0
    world.network.deaf.clear()
    await asyncio.sleep(1.5)
    assert (await world.drive()).x_m_s == 0.2


@pytest.mark.parametrize("before_s", [0.4, 0.25, 0.05, -0.05, -0.25])
@pytest.mark.parametrize("gap_s", [0.45, 0.55, 0.65, 0.8])
def test_gap_between_two_hosts_undoes_no_stop(before_s: float, gap_s: float) -> None:
    """A program streams without a pause. Its commands wait from `before_s` before the stop on; its host is deaf."""

    async def test(world: World) -> None:
        loop = asyncio.get_running_loop()
        began_s, sent, waiting = math.inf, world.desk_session.put, list[Callable[[], None]]()

        def put(key: str, payload: bytes, **options: Any) -> None:
            if loop.time() < began_s:
                sent(key, payload, **options)
            else:
                waiting.append(functools.partial(sent, key, payload, **options))

        async def stream() -> None:
            while True:
                with contextlib.suppress(HostlinkError):
                    world.program.drive(world.robot(), DRIVE)
                await asyncio.sleep(0.1)

        world.desk_session.put = put  # type: ignore[method-assign]
        async with meanwhile(stream()):
            await asyncio.sleep(1.0)
            assert world.scene.speeds()[-1] == 0.2
            loop.call_later(0.5, world.scene.hub.robots.find(ROBOT).stop)
            await asyncio.sleep(0.5 - before_s)
            began_s = loop.time()
            world.network.deaf.add("2b")
            await asyncio.sleep(gap_s)
            world.network.deaf.clear()
            began_s, count = math.inf, len(world.scene.speeds())
            for each in waiting:
                each()
            await asyncio.sleep(3.0)
            assert not any(world.scene.speeds()[count:])

    with_fleet(test)


@inside(with_fleet)
async def test_command_that_waited_here_moves_a_robot_of_another_host_for_the_rest_of_its_lease(world: World) -> None:
    """A command that is 0.3 s old when it is sent: the robot stops 0.5 s after its arrival here."""
    await world.drive(ZERO)
    world.program.drive(world.robot(), DRIVE, received_s=now_s() - 0.3)
    await asyncio.sleep(0.1)
    assert world.scene.speeds()[-1] == 0.2
    await asyncio.sleep(0.2)
    assert world.scene.speeds()[-1] == 0.0


@inside(with_fleet)
async def test_program_whose_computer_has_slept_drives_robots_of_other_hosts(world: World) -> None:
    """The clock of its event loop stood still for a minute, as that of a laptop whose lid was closed."""
    await world.drive()
    sent = world.desk_session.put
    world.network.drop("2b")
    await asyncio.sleep(1.0)

    def put_later(key: str, payload: bytes, **options: Any) -> None:
        """All times of the desk are by a clock that lacks a minute."""
        decoded = json.loads(payload)
        if "sent_s" in decoded:
            decoded["sent_s"] -= 60.0
        sent(key, json.dumps(decoded).encode(), **options)

    world.desk_session.put = put_later  # type: ignore[method-assign]
    world.slept_s = 60.0
    world.network.note_token(Keys(ZenohSettings().fleet_name).key("alive", Sender("desk", "2b")), is_alive=True)
    await asyncio.sleep(1.5)
    assert (await world.drive()).x_m_s == 0.2


@inside(with_fleet)
async def test_daemon_whose_messages_do_not_arrive_although_it_has_a_token_is_connected_anew(world: World) -> None:
    """The state of Zenoh after a freeze of one host: no subscription of one side is known to the other."""
    world.network.mute.add(("1a", "2b"))
    await asyncio.sleep(SILENT_S + 0.5)
    assert world.robot().link is None
    assert world.network.closed == []
    await asyncio.sleep(4.0)
    assert world.network.closed == [("2b", "1a")]
    assert world.robot().link is not None


@inside(with_fleet)
async def test_daemon_that_stays_silent_is_connected_anew_at_a_limited_rate(world: World) -> None:
    world.network.deaf.add("2b")
    await asyncio.sleep(29.5)
    assert 3 <= len(world.network.closed) <= 5


@inside(with_fleet)
async def test_daemon_that_hears_no_other_tells_its_users(world: World) -> None:
    told: list[str] = []
    rosout = world.desk.topics.find("/rosout")
    world.program.subscribe("/rosout", lambda message: told.append(rosout.type.decode(message.payload)["msg"]))
    cut = Cut(world)
    cut.cut()
    await asyncio.sleep(0.3)
    assert [text.partition(" (")[0] for text in told] == ["this host hears no other host of the fleet"]
    cut.heal()
    await asyncio.sleep(1.5)
    assert told[1:] == ["every host of the fleet is heard again"]


@inside(play)
async def test_stop_that_is_repeated_is_answered_and_obeyed_once(scene: Scene) -> None:
    requests = Requests(scene)
    requests.hear()

    def stop(*to: str) -> FleetAnswer | None:
        requests.drivers.receive_stop(
            ZenohSample(requests.keys.key("stop", requests.desk), encode(Stop(number=7, robot=ROBOT, to=to)))
        )
        return ANSWER.decode(requests.sent.pop()) if requests.sent else None

    robot = scene.hub.robots.find(ROBOT)
    epoch = robot.admission.epoch
    assert stop("3c") is None
    assert robot.admission.epoch == epoch
    assert stop().number == 7
    stopped = robot.admission.epoch
    assert stopped > epoch
    answer = stop("1a")
    assert [each.name for each in answer.robots]
    assert robot.admission.epoch == stopped


@inside(with_fleet)
async def test_second_daemon_of_a_name_is_told(world: World) -> None:
    with capture_logs() as logs:
        world.network.note_token(Keys(ZenohSettings().fleet_name).key("alive", Sender("lab", "4d")), is_alive=True)
        await asyncio.sleep(0.1)
    found = [line for line in logs if line["event"] == "fleet.duplicate_host_found"]
    assert [line["host"] for line in found] == ["lab", "lab"]  # at lab, and at desk


# -- a failure of the component ---------------------------------------------------------------------------------------


class Failing(Component[ZenohSettings]):
    """The fleet over a network in memory, which fails when a test says so."""

    name = "zenoh"
    settings_type = ZenohSettings

    def __init__(self, settings: ZenohSettings, session: MemorySession, failure: "asyncio.Queue[Exception]") -> None:
        super().__init__(settings)
        self.session, self.failure = session, failure

    async def run(self, host: Host) -> None:
        async with fleet_running(host, cast("ZenohSession", self.session), self.settings):
            raise await self.failure.get()


class Supervised(World):
    """Both daemons with supervised components, each of which a test can let fail."""

    async def begin(self, drivers: tuple[str, ...]) -> None:
        self.running = self.scene.tasks.create_task(self.desk.run())
        await self.desk.is_running.wait()
        self.sessions: dict[str, MemorySession] = {}
        self.failures: dict[str, asyncio.Queue[Exception]] = {}
        self.components = [self._start(*each, drivers) for each in ((self.scene.hub, "lab"), (self.desk, "desk"))]
        await asyncio.sleep(2.0)
        self.program = self.desk.join("client 3")

    def _start(self, hub: Hub, name: str, drivers: tuple[str, ...]) -> "asyncio.Task[None]":
        failure = self.failures[name] = asyncio.Queue()
        numbers = itertools.count(1)

        def make() -> Failing:
            session = self.sessions[name] = MemorySession(self.network, f"{next(numbers)}{name}")
            return Failing(ZenohSettings(name=name, drivers=drivers), session, failure)

        return self.scene.tasks.create_task(supervise(hub, "zenoh", make))

    def fail(self, name: str, error: Exception) -> None:
        """Let the component of a daemon fail."""
        self.failures[name].put_nowait(error)

    async def end(self) -> None:
        self.program.leave()
        for each in self.components:
            each.cancel()
        await asyncio.sleep(0.1)
        assert self.desk.robots.remote == {}
        self.scene.hub.isolation.crashes.pop("component", None)  # the failure of the test
        self.running.cancel()

    @contextlib.asynccontextmanager
    async def streaming(self, refusals: list[HostlinkError]) -> AsyncIterator[None]:
        """A program at the desk drives the robot of the lab, and ignores refusals."""

        async def stream() -> None:
            while True:
                try:
                    robot = self.desk.robots.find(ROBOT, driver=lambda: self.program)
                    self.program.drive(robot, DRIVE)
                except HostlinkError as error:
                    refusals.append(error)
                await asyncio.sleep(0.1)

        async with meanwhile(stream()):
            await asyncio.sleep(1.0)
            assert (self.scene.speeds()[-1], refusals) == (0.2, [])
            yield


def with_failures(test: Callable[[Supervised], Awaitable[None]]) -> None:
    async def run(scene: Scene) -> None:
        world = Supervised(scene)
        await world.begin(("*",))
        try:
            await test(world)
        finally:
            await world.end()

    play(run)


@pytest.mark.parametrize("is_mute", [False, True], ids=["in order", "mute"])
@pytest.mark.parametrize("failing", ["lab", "desk"])
def test_failure_of_the_fleet_at_either_end_stops_the_robot_and_its_next_start_does_not_move_it(
    failing: str, *, is_mute: bool
) -> None:
    """`mute`: nothing that the component says at its end is heard, and what it calls fails."""

    def refuse(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a bug of the session")

    async def test(world: Supervised) -> None:
        refusals = list[HostlinkError]()
        async with world.streaming(refusals):
            world.fail(failing, ValueError("a bug"))
            if is_mute:
                world.sessions[failing].put = refuse  # type: ignore[method-assign]
            await asyncio.sleep(0.05)
            if failing == "lab" or not is_mute:
                assert world.scene.speeds()[-1] == 0.0
            else:  # its daemon cannot know it before the lease ends
                await asyncio.sleep(0.5)
                assert world.scene.speeds()[-1] == 0.0
            assert failing == "lab" or world.desk.robots.remote == {}
            count = len(world.scene.speeds())
            await asyncio.sleep(8.0)  # it is started again; the program has let nothing go
            assert not any(world.scene.speeds()[count:])
            assert world.robot().link is not None
        await world.drive(ZERO)
        assert (await world.drive()).x_m_s == 0.2
        assert refusals

    with_failures(test)


@pytest.mark.parametrize("order", ORDERS)
def test_order_that_was_not_obeyed_when_the_fleet_failed_is_in_force_after_its_next_start(order: str) -> None:
    async def test(world: Supervised) -> None:
        async with driven_at_lab(world) as there:
            world.network.deaf.add("1lab")
            ORDERS[order](world)
            with pytest.raises(DeviceGone, match="lab: has not answered the"):
                await world.desk.gates.settled()
            world.fail("desk", ValueError("a bug"))
            await asyncio.sleep(2.0)
            assert world.scene.speeds()[-1] == 0.2
            shown = world.robot().state(now_s()).lock_reason
            assert shown == ("crossing (desk)" if "lock" in order else None)
            world.network.deaf.clear()
            await asyncio.sleep(3.0)
            assert world.scene.speeds()[-1] == 0.0
            assert there.gate.lock_reason == ("crossing (desk)" if "lock" in order else None)
            assert await world.desk.gates.settled() == []
            world.scene.hub.robots.unlock_all()

    with_failures(test)


@pytest.mark.parametrize("order", ["stop of all", "lock of all"])
def test_order_between_two_runs_of_the_fleet_is_an_error_and_in_force_after_the_next_start(order: str) -> None:
    async def test(world: Supervised) -> None:
        async with driven_at_lab(world) as there:
            world.fail("desk", ValueError("a bug"))
            await asyncio.sleep(0.1)
            assert world.desk.robots.all() == []
            ORDERS[order](world)
            with pytest.raises(DeviceGone, match="lab: has not answered the"):
                await world.desk.gates.settled()
            await asyncio.sleep(4.0)
            assert world.scene.speeds()[-1] == 0.0
            assert there.gate.lock_reason == ("crossing (desk)" if "lock" in order else None)
            world.desk.robots.stop_all()
            assert await world.desk.gates.settled() == []
            world.scene.hub.robots.unlock_all()

    with_failures(test)


@inside(with_failures)
async def test_unlock_that_was_not_answered_when_the_fleet_failed_is_not_repeated(world: Supervised) -> None:
    here = world.scene.hub.robots.find(ROBOT)
    here.lock("smoke")
    await asyncio.sleep(0.1)
    world.network.deaf.add("1lab")
    world.robot().unlock()
    world.fail("desk", ValueError("a bug"))
    await asyncio.sleep(2.0)
    world.network.deaf.clear()
    await asyncio.sleep(3.0)
    assert here.gate.lock_reason == "smoke"
    here.unlock()


@inside(with_failures)
async def test_bug_in_an_order_ends_the_run_is_told_to_its_caller_and_stops_what_is_here(world: Supervised) -> None:
    device = ScriptedDevice(world.desk, robot_topics("robot_9"), address="10.0.0.9")
    await asyncio.sleep(0.5)
    here = world.desk.robots.find("robot_9")
    world.program.drive(here, DRIVE)

    def refuse(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a bug of the session")

    world.sessions["desk"].put = refuse  # type: ignore[method-assign]
    world.desk.robots.stop_all()
    with pytest.raises(DeviceGone, match=r"zenoh: the component has failed: .*a bug of the session"):
        await world.desk.gates.settled()
    await asyncio.sleep(0.5)
    assert world.desk.robots.find_here("robot_9").gate.current.is_zero
    assert [each.code for each in world.desk.diagnoses.own.values()] == ["component_failed"]
    assert world.desk.robots.remote == {}
    await asyncio.sleep(4.0)
    assert world.robot().link is not None
    world.desk.robots.stop_all()
    assert await world.desk.gates.settled() == []
    await device.aclose()
