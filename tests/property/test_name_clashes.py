"""Any mix of topics, services, types and names over several devices, in virtual time: two honest robots that were
flashed alike go on.

Invariants: nothing crashes; each honest robot keeps its link, its name and its poses; a command by its name reaches
that robot alone.
"""

import asyncio
import contextlib
import struct
from collections.abc import Callable, Coroutine
from typing import Any

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.frame import Id
from hostlink.core.robot.state import MAX_PRIORITY
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import HostlinkError
from tests.support.fake_device import CATALOG, robot_topics, topic
from tests.support.gates import drive_gate
from tests.support.participants import publish
from tests.support.scripted_device import ScriptedDevice
from tests.support.strategies import fewer_examples
from tests.support.virtual_loop import VirtualLoop

HOMES = ("10.0.0.1", "10.0.0.2")
TWIST, POSE = "geometry_msgs/Twist", "geometry_msgs/Pose2D"
MESSAGE_TYPES = (
    TWIST, POSE, "nav_msgs/Odometry", "geometry_msgs/TwistStamped", "std_msgs/Empty", "std_msgs/Bool",
    "std_msgs/String", "tf/tfMessage", "tf2_msgs/TFMessage", "rosgraph_msgs/Log",
)  # fmt: skip
SERVICE_TYPES = ("std_srvs/Trigger", "std_srvs/SetBool", "std_srvs/Empty")
LEAVES = ("velocity_commands", "odometry", "reset_odometry", "odom", "cmd_vel", "cmd_vel_stamped", "lock", "unlock")
NAMES = (
    *(f"/{robot}/{leaf}" for robot in ("robot_0", "robot_0_2", "robot_0_3", "robot") for leaf in LEAVES),
    *LEAVES, "/tf", "/rosout", "/cmd_vel", "/odom", "/robot_0", "/rosapi/topics", "/", "//", "~", "~odom",
)  # fmt: skip
kinds = st.sampled_from(list(Id)[:6])
names, ids = st.sampled_from(NAMES), st.integers(100, 107)
addresses = st.sampled_from([*HOMES, "10.0.0.9"])


@st.composite
def infos(draw: st.DrawFn) -> DeviceEndpoint:
    """An endpoint with the md5 that its type has."""
    kind = draw(kinds)
    types = MESSAGE_TYPES if kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIBER) else SERVICE_TYPES
    return topic(kind, draw(ids), draw(names), draw(st.sampled_from(types)))


announcements = st.one_of(
    st.lists(infos(), max_size=8),
    st.lists(infos(), max_size=4).map(lambda others: [*robot_topics(), *others]),
    st.lists(infos(), max_size=4).map(lambda others: [*others, *robot_topics("robot_0_2")]),
    st.builds(  # one name in both directions, and of two types
        lambda name: [topic(EndpointKind.SUBSCRIBER, 100, name, TWIST), topic(EndpointKind.PUBLISHER, 125, name, POSE)],
        names,
    ),
    st.builds(
        lambda velocity, odometry: [
            topic(EndpointKind.SUBSCRIBER, 100, velocity, TWIST),
            topic(EndpointKind.PUBLISHER, 125, odometry, "nav_msgs/Odometry"),
            topic(EndpointKind.PUBLISHER, 126, odometry, TWIST),
        ],
        names,
        names,
    ),
)
payloads = st.one_of(
    st.sampled_from(MESSAGE_TYPES).map(lambda name: CATALOG.message(name).encode({})),  # type: ignore[union-attr]
    st.just(struct.pack("<6d", 0.05, 0, 0, 0, 0, 0)),
    st.just(struct.pack("<3d", 77.0, 0, 0)),
    st.binary(max_size=60),
)


class Clashes(RuleBasedStateMachine):
    """Two honest robots, and up to six other devices."""

    @initialize()
    def begin(self) -> None:
        self.runner = asyncio.Runner(loop_factory=VirtualLoop)
        self.honest: list[ScriptedDevice] = []
        self.others: list[ScriptedDevice] = []
        self.names: list[str] = []
        self.commanded: list[set[float]] = [set(), set()]
        self.by_name: set[float] = set()  # the speeds that no topic carried
        self.speeds = 0
        self.now(self.build())

    async def build(self) -> None:
        self.hub = Hub(Config(), CATALOG, reraises=True)
        self.tasks = [asyncio.get_running_loop().create_task(self.hub.run())]
        await self.hub.is_running.wait()
        for number, home in enumerate(HOMES):
            device = ScriptedDevice(self.hub, robot_topics(), address=home)
            self.honest.append(device)
            self.tasks.append(asyncio.get_running_loop().create_task(self.talk(device, float(number + 1))))
            await asyncio.sleep(1.0)
            robot = self.hub.robots.of_link(device.link)
            self.names.append(robot.name)
        assert self.names == ["robot_0", "robot_0_2"]

    async def talk(self, device: ScriptedDevice, x_m: float) -> None:
        for turn in range(1_000_000):
            await device.send(125, struct.pack("<3d", x_m, 0, 0))
            if turn % 25 == 0:
                await device.send(Id.TIME, bytes(8))
            await asyncio.sleep(0.1)

    def now(self, work: Coroutine[Any, Any, None]) -> None:
        with capture_logs():
            self.runner.run(work)
        for task in self.tasks:
            if task.done():  # the hub ends with the first crash, and says which
                task.result()

    # -- what happens -------------------------------------------------------------------------------------------------

    @rule(seconds=st.sampled_from([0.01, 0.1, 0.6, 4.0]))
    def time_passes(self, seconds: float) -> None:
        self.now(asyncio.sleep(seconds))

    @precondition(lambda self: len(self.others) < 6)
    @rule(announced=announcements, address=addresses)
    def connect(self, announced: list[DeviceEndpoint], address: str) -> None:
        async def act() -> None:
            self.others.append(ScriptedDevice(self.hub, announced, address=address))
            await asyncio.sleep(0.01)

        self.now(act())

    @precondition(lambda self: self.others)
    @rule(data=st.data(), announced=announcements)
    def announce_other_topics(self, data: st.DataObject, announced: list[DeviceEndpoint]) -> None:
        async def act() -> None:
            device.infos = announced
            await device.announce()

        device = data.draw(st.sampled_from(self.others))
        self.now(act())

    @precondition(lambda self: self.others)
    @rule(data=st.data(), payload=payloads)
    def publish(self, data: st.DataObject, payload: bytes) -> None:
        """On each topic that it announced a message of its type, and anything on any id."""

        async def act() -> None:
            for info in device.infos:
                type_ = CATALOG.message(info.type)
                if info.kind is EndpointKind.PUBLISHER and type_ is not None:
                    await device.send(info.id, type_.encode({}))
            await device.send(topic_id, payload)
            await asyncio.sleep(0.01)

        device, topic_id = data.draw(st.sampled_from(self.others)), data.draw(ids)
        self.now(act())

    @precondition(lambda self: self.others)
    @rule(data=st.data())
    def vanish(self, data: st.DataObject) -> None:
        device = data.draw(st.sampled_from(self.others))
        self.others.remove(device)
        self.now(device.aclose())

    @rule(name=names, type_name=st.sampled_from(MESSAGE_TYPES), payload=payloads)
    def a_program_publishes(self, name: str, type_name: str, payload: bytes) -> None:
        self.try_now(lambda: publish(self.hub, name, payload, source="program", type_name=type_name))

    @rule(name=names, lock=st.booleans())
    def lock(self, name: str, lock: bool) -> None:
        """A robot, if there is one of that name."""
        robot_name = name.split("/")[1] if name.count("/") > 1 else "robot_0"

        def act() -> None:
            robot = self.hub.robots.find(robot_name)
            if lock:
                robot.lock("smoke")
            else:
                robot.unlock()

        self.try_now(act)

    @rule(number=st.sampled_from([0, 1]), by=st.sampled_from(["name", "velocity_commands", "cmd_vel"]))
    def drive(self, number: int, by: str) -> None:
        """Drive at a speed that no robot was driven at before."""
        self.speeds += 1
        speed = self.speeds / 10_000

        async def act() -> None:
            robot, velocity = self.hub.robots.find(self.names[number]), PlanarVelocity(x_m_s=speed)
            robot.unlock()
            robot.stop()  # of two sources with the same priority the first keeps it
            epoch = robot.admission.epoch  # the driver knows that it was interrupted
            if by == "name":
                drive_gate(robot, velocity, owner="driver", priority=MAX_PRIORITY, epoch=epoch)
            else:
                try:
                    publish(
                        self.hub,
                        f"/{robot.name}/{by}",
                        velocity.encode(),
                        source="driver",
                        priority=MAX_PRIORITY,
                        type_name=TWIST,
                        epoch=epoch,
                    )
                except HostlinkError:  # another device means something else by that name
                    assert by == "cmd_vel"
                    return
            await asyncio.sleep(0.2)
            if by != "cmd_vel":
                assert speed in self.speeds_at(number)

        self.commanded[number].add(speed)
        if by == "name":
            self.by_name.add(speed)
        self.now(act())

    def try_now(self, act: Callable[[], object]) -> None:
        async def tried() -> None:
            with contextlib.suppress(HostlinkError):
                act()
            await asyncio.sleep(0.01)

        self.now(tried())

    # -- what must hold -----------------------------------------------------------------------------------------------

    def speeds_at(self, number: int) -> set[float]:
        return {struct.unpack("<6d", payload)[0] for payload in self.honest[number].payloads(100)}

    @precondition(lambda self: len(getattr(self, "names", ())) == 2)
    @invariant()
    def nothing_crashes(self) -> None:
        assert not self.hub.isolation.crashes

    @precondition(lambda self: len(getattr(self, "names", ())) == 2)
    @invariant()
    def the_honest_keep_their_links_and_names(self) -> None:
        for device, name in zip(self.honest, self.names, strict=True):
            robot = self.hub.robots.find(name)
            assert robot.link is device.link
            assert self.hub.robots.of_link(device.link) is robot

    @precondition(lambda self: len(getattr(self, "names", ())) == 2)
    @invariant()
    def their_poses_are_their_own(self) -> None:
        async def check_poses() -> None:
            for number, name in enumerate(self.names):
                estimate = self.hub.robots.find(name).odometry.snapshot(asyncio.get_running_loop().time())
                assert estimate.pose.x_m == number + 1
                assert (estimate.restarts, estimate.ignored) == (0, 0)
                assert estimate.age_s < 0.2

        self.now(check_poses())

    @precondition(lambda self: len(getattr(self, "names", ())) == 2)
    @invariant()
    def commands_reach_whom_they_are_for(self) -> None:
        for number in (0, 1):
            assert not self.speeds_at(number) & self.commanded[1 - number]
        heard = [frame.payload for device in self.others for _, frame in device.heard if len(frame.payload) == 48]
        assert not {struct.unpack("<6d", payload)[0] for payload in heard} & self.by_name

    def teardown(self) -> None:
        if not hasattr(self, "runner"):
            return

        async def end() -> None:
            for task in [*self.tasks, *(device.task for device in (*self.honest, *self.others))]:
                task.cancel()
            await asyncio.sleep(0.1)

        self.runner.run(end())
        self.runner.close()


class TestClashes(Clashes.TestCase):  # type: ignore[misc,name-defined]
    """Every order of what may happen."""

    settings = fewer_examples(2, stateful_step_count=25)
