"""Robots, their gates and their links in virtual time, under any order of drivers, locks, and links that come and go.

What must hold, as the device hears it: nothing but zero while it is locked; the first velocity of a session is zero;
never above the limits; without a driver zero within a lease, a tick and the braking, and then three times.
"""

import asyncio
import contextlib
import struct
from typing import NamedTuple

from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from structlog.testing import capture_logs

from hostlink.core.config import Config, LinkConfig, RobotConfig
from hostlink.core.hub.device import Device, endpoints_of
from hostlink.core.hub.gates import TICK_S
from hostlink.core.hub.hub import Hub
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.events import Event, TopicsNegotiated
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import check_type
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.admission import LEASE_S
from hostlink.core.robot.model import find_robot
from hostlink.core.robot.names import Presence
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.core.robot.velocity_gate import ZEROS
from hostlink.errors import CommandRefused, RefusalKind
from tests.support.fake_device import robot_topics
from tests.support.gates import drive_gate
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.strategies import fewer_examples
from tests.support.virtual_loop import VirtualLoop

CATALOG = Catalog()
NAME = "robot_0"
FASTEST = (0.5, 2.0)
owners = st.sampled_from(["page", "script", "demo"])
priorities = st.sampled_from([0, 50, 60])
components = st.sampled_from([0.0, 0.1, -0.3, 0.5, 2.0])


class Heard(NamedTuple):
    """A velocity at the device."""

    at_s: float
    session: int
    linear_m_s: float
    angular_rad_s: float

    @property
    def is_zero(self) -> bool:
        return not self.linear_m_s and not self.angular_rad_s


class Drivers(RuleBasedStateMachine):
    """A robot with a device that only listens."""

    @initialize(deceleration=st.sampled_from([None, 0.5, 2.0]), uart_bytes_s=st.sampled_from([None, 3840]))
    def begin(self, deceleration: float | None, uart_bytes_s: int | None) -> None:
        self.braking_s = 0.0 if deceleration is None else FASTEST[0] / deceleration
        self.uart_bytes_s = uart_bytes_s
        self.heard: list[Heard] = []
        self.sessions = 0
        self.is_eager = False
        self.link: Link | None = None
        self.locked_since: int | None = None  # how many velocities were heard before
        self.driven_until_s = 0.0
        self.runner = asyncio.Runner(loop_factory=VirtualLoop)
        config = RobotConfig(
            max_linear_m_s=FASTEST[0], max_angular_rad_s=FASTEST[1], max_linear_deceleration_m_s2=deceleration
        )
        self.runner.run(self.build(config))

    async def build(self, config: RobotConfig) -> None:
        self.hub = Hub(Config(robots={NAME: config}), CATALOG, reraises=True)
        self.gates, self.robots, self.diagnoses = self.hub.gates, self.hub.robots, self.hub.diagnoses
        self.tasks = [asyncio.get_running_loop().create_task(self.gates.run())]
        await self.connect()

    async def connect(self) -> None:
        self.sessions += 1
        host_end, device_end = memory_pair()
        session = Session(check=lambda info: check_type(CATALOG, info), uart_bytes_s=self.uart_bytes_s)
        self.link = Link(host_end, session, LinkConfig(), number=self.sessions, on_event=self.react)
        device = Device(self.link, self.diagnoses.begin(self.link), Presence(), self.hub, self.robots, lambda _: None)
        self.robots.devices[self.link.number] = device
        loop = asyncio.get_running_loop()
        self.tasks.append(loop.create_task(self.serve(self.link)))
        self.tasks.append(loop.create_task(self.listen(device_end, self.sessions)))
        await asyncio.sleep(1.0)
        assert self.robots.find(NAME).link is self.link

    def react(self, link: Link, event: Event) -> None:
        if isinstance(event, TopicsNegotiated) and event.is_changed:
            robot = find_robot(endpoints_of(event.topics))
            assert robot is not None
            self.robots.appear(NAME, robot, robot, self.robots.devices[link.number])
            if self.is_eager and self.locked_since is None:
                fast = PlanarVelocity(x_m_s=FASTEST[0])
                drive_gate(self.robots.find(NAME), fast, owner="eager")
                self.driven_until_s = asyncio.get_running_loop().time() + LEASE_S

    async def serve(self, link: Link) -> None:
        await link.run()
        self.robots.vanish(self.robots.devices.pop(link.number))

    async def listen(self, end: MemoryTransport, session: int) -> None:
        stream = FrameStream()
        infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics(NAME))
        with contextlib.suppress(OSError):
            while data := await end.receive():
                for frame in stream.feed(data):
                    assert isinstance(frame, Frame)
                    if frame.topic_id == Id.PUBLISHER:
                        await end.send(infos + encode(Id.TIME, bytes(8)))
                    elif frame.topic_id == 100:
                        twist = struct.unpack("<6d", frame.payload)
                        now_s = asyncio.get_running_loop().time()
                        self.heard.append(Heard(now_s, session, twist[0], twist[5]))

    def run_for(self, seconds: float) -> None:
        self.runner.run(asyncio.sleep(seconds))
        assert not any(task.done() and task.exception() for task in self.tasks)

    # -- what happens -------------------------------------------------------------------------------------------------

    @rule(seconds=st.sampled_from([0.01, 0.05, 0.1, 0.3, 0.6]))
    def time_passes(self, seconds: float) -> None:
        self.run_for(seconds)

    @rule(owner=owners, priority=priorities, linear_m_s=components, angular_rad_s=components)
    def drive(self, owner: str, priority: int, linear_m_s: float, angular_rad_s: float) -> None:
        async def now() -> None:
            robot = self.robots.find(NAME)
            velocity = PlanarVelocity(x_m_s=linear_m_s, yaw_rad_s=angular_rad_s)
            kind = holder = None
            try:
                drive_gate(robot, velocity, owner=owner, priority=priority)
            except CommandRefused as refused:
                kind, holder = refused.kind, refused.holder
            assert (kind is RefusalKind.LOCKED) == (self.locked_since is not None and not velocity.is_zero)
            assert (kind is RefusalKind.NOT_CONNECTED) <= (robot.link is None)
            if kind is RefusalKind.HELD:  # also by a source that this one has overtaken at an equal priority
                assert str(holder) != owner
            else:
                assert (kind is not None) <= (robot.gate.owner_name != owner)
            if kind is None and not velocity.is_zero:
                self.driven_until_s = asyncio.get_running_loop().time() + LEASE_S

        self.runner.run(now())

    @rule(owner=owners)
    def leave(self, owner: str) -> None:
        async def now() -> None:
            if self.robots.find(NAME).gate.owner_name == owner:
                self.driven_until_s = asyncio.get_running_loop().time()
            self.gates.release(owner)

        self.runner.run(now())

    @rule()
    def stop(self) -> None:
        async def now() -> None:
            self.robots.find(NAME).stop()
            self.driven_until_s = asyncio.get_running_loop().time()

        self.runner.run(now())

    @rule()
    def lock(self) -> None:
        async def now() -> None:
            await asyncio.sleep(0)  # what has left the host has been heard
            self.robots.find(NAME).lock("smoke")
            self.driven_until_s = asyncio.get_running_loop().time()

        self.run_for(0.02)  # a velocity that was put before is on its way
        self.runner.run(now())
        self.locked_since = len(self.heard)

    @rule()
    def unlock(self) -> None:
        async def now() -> None:
            self.robots.find(NAME).unlock()

        self.runner.run(now())
        self.locked_since = None

    @precondition(lambda self: self.link is not None)
    @rule()
    def lose_the_link(self) -> None:
        async def now() -> None:
            self.link.end(LinkEnd.REPLACED)
            await asyncio.sleep(0.1)
            assert self.robots.find(NAME).link is None

        self.runner.run(now())
        self.link = None

    @precondition(lambda self: self.link is None)
    @rule(is_eager=st.booleans())
    def find_the_link(self, is_eager: bool) -> None:
        """Connect the device again. An eager driver commands at the very moment that the robot appears."""
        self.is_eager = is_eager
        self.runner.run(self.connect())

    # -- what must hold -----------------------------------------------------------------------------------------------

    @precondition(lambda self: hasattr(self, "runner"))
    @invariant()
    def never_above_the_limits(self) -> None:
        for heard in self.heard:
            assert abs(heard.linear_m_s) <= FASTEST[0] + 1e-9
            assert abs(heard.angular_rad_s) <= FASTEST[1] + 1e-9

    @precondition(lambda self: hasattr(self, "runner"))
    @invariant()
    def the_first_of_a_session_is_zero(self) -> None:
        sessions = [heard.session for heard in self.heard]
        assert all(self.heard[sessions.index(session)].is_zero for session in set(sessions))

    @precondition(lambda self: getattr(self, "locked_since", None) is not None)
    @invariant()
    def nothing_but_zero_while_it_is_locked(self) -> None:
        assert all(heard.is_zero for heard in self.heard[self.locked_since :])

    @precondition(lambda self: hasattr(self, "runner"))
    @invariant()
    def without_a_driver_it_stands(self) -> None:
        now_s = self.runner.get_loop().time()
        due_s = self.driven_until_s + self.braking_s + 2 * TICK_S + 0.02  # 56 bytes on the line
        late = [heard for heard in self.heard if heard.at_s > due_s]
        assert all(heard.is_zero for heard in late)
        mine = [heard for heard in self.heard if heard.session == self.sessions]
        if self.link is not None and now_s > due_s + ZEROS * (TICK_S + 0.02):
            assert all(heard.is_zero for heard in mine[-ZEROS:])
            assert len(mine) >= ZEROS

    def teardown(self) -> None:
        if not hasattr(self, "runner"):
            return
        self.run_for(LEASE_S + self.braking_s + 0.5)
        self.without_a_driver_it_stands()

        async def end() -> None:
            for task in self.tasks:
                task.cancel()
            await asyncio.wait(self.tasks)

        self.runner.run(end())
        self.runner.close()


class TestDrivers(Drivers.TestCase):  # type: ignore[misc,name-defined]
    """Every order of what may happen."""

    settings = fewer_examples(2, stateful_step_count=30)

    def runTest(self) -> None:  # noqa: N802 - unittest's
        with capture_logs():
            super().runTest()


def test_a_zero_beside_a_stop_takes_none_of_its_zeros() -> None:
    """On a slow line two zeros of one moment leave as one."""
    drivers = Drivers()
    drivers.begin(deceleration=None, uart_bytes_s=3840)
    drivers.drive(owner="page", priority=0, linear_m_s=0.1, angular_rad_s=0.0)
    drivers.stop()
    drivers.drive(owner="page", priority=0, linear_m_s=0.0, angular_rad_s=0.0)
    drivers.teardown()
    assert [heard.linear_m_s for heard in drivers.heard[-ZEROS - 1 :]] == [0.1, *[0.0] * ZEROS]
