"""A stop while the daemon, its queues or its socket are busy. All in virtual time: the figures are exact.

The robot hears a velocity some 15 ms after it left the host, the time of its 56 bytes on a 38400 baud line, in the next
of its 33 ms turns.
"""

import asyncio
import itertools
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest
from structlog.testing import capture_logs

from hostlink.core.config import Config, LinkConfig
from hostlink.core.hub.any_robot import AnyRobot
from hostlink.core.hub.gates import MAX_STEPS, TICK_S
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.message import PROGRAM_PRIORITY
from hostlink.core.hub.remote_robot import RemoteRobot
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Frame, Id, encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.admission import LEASE_S, Command
from hostlink.core.robot.velocity import ZERO, PlanarVelocity
from hostlink.errors import CommandRefused, RefusalKind
from hostlink.workbench.sim.robot import SimulatedRobot
from tests.support.fake_device import robot_topics
from tests.support.gates import drive_gate
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.participants import publish
from tests.support.remote_robots import RecordingHosts, connected_robot, reach
from tests.support.ros_lib_device import running_hub
from tests.support.virtual_device import LOOP_S, FirmwareProgram, NumberedRobot
from tests.support.virtual_loop import VirtualLoop, run_virtual
from tests.support.virtual_world import CATALOG, World, world
from tests.support.waiting import expect
from tools.faults import Script

STOP = bytes(48)
LINE_S = 0.020  # one velocity on the line, and what the passthrough adds
SLOW, FAST = PlanarVelocity(x_m_s=0.1), PlanarVelocity(x_m_s=0.3)


def loop() -> VirtualLoop:
    running = asyncio.get_running_loop()
    assert isinstance(running, VirtualLoop)
    return running


async def ready(made: World) -> AnyRobot:
    await expect(made.is_working)
    return made.hub.robots.find("robot_0")


def drive(made: World, velocity: PlanarVelocity = FAST) -> None:
    drive_gate(made.hub.robots.find("robot_0"), velocity, owner="test")


async def driven(made: World, seconds: float = 1.0) -> None:
    for _ in range(round(seconds / 0.1)):
        drive(made)
        await asyncio.sleep(0.1)


def received_at_s(robot: NumberedRobot, since_s: float) -> float:
    """Return when the first stop after `since_s` reached the robot. Check that only stops follow."""
    later = [(at_s, payload) for at_s, payload in robot.commands if at_s >= since_s]
    first = next(number for number, (_, payload) in enumerate(later) if payload == STOP)
    assert {payload for _, payload in later[first:]} == {STOP}
    return later[first][0]


def numbered(test: Callable[[World, NumberedRobot], Awaitable[None]]) -> None:
    async def run() -> None:
        robot = NumberedRobot(CATALOG)
        with capture_logs():
            async with world(Script(), robot) as made:
                await ready(made)
                await driven(made)
                await test(made, robot)

    run_virtual(run())


def simulated(test: Callable[[World, SimulatedRobot], Awaitable[None]]) -> None:
    async def run() -> None:
        program = FirmwareProgram()
        with capture_logs():
            async with world(Script(), program, loop_s=program.loop_s) as made:
                await ready(made)
                await driven(made)
                await test(made, program.robot)

    run_virtual(run())


def test_a_stop_reaches_an_idle_robot_within_a_turn_and_a_line() -> None:
    async def check(made: World, robot: NumberedRobot) -> None:
        since_s = loop().time()
        (await ready(made)).stop()
        await asyncio.sleep(1.0)
        assert received_at_s(robot, since_s) - since_s <= LINE_S + LOOP_S

    numbered(check)


def test_a_loop_that_is_busy_for_95_of_100_delays_a_stop_by_its_own_turns_only() -> None:
    async def burn() -> None:
        while True:
            loop().burn(0.019)
            await asyncio.sleep(0.001)

    async def check(made: World, robot: NumberedRobot) -> None:
        async with asyncio.TaskGroup() as tasks:
            load = tasks.create_task(burn())
            await driven(made)
            since_s = loop().time()
            (await ready(made)).stop()
            await asyncio.sleep(1.0)
            load.cancel()
        # the writer's turn, the relay's two and the device's are each up to 20 ms late here
        assert received_at_s(robot, since_s) - since_s <= LINE_S + LOOP_S + 4 * 0.020

    numbered(check)


def test_thousand_commands_at_once_are_sent_as_one_before_the_stop() -> None:
    async def check(made: World, robot: NumberedRobot) -> None:
        since_s = loop().time()
        for number in range(1000):
            drive(made, PlanarVelocity(x_m_s=0.1 + number / 10_000))
        (await ready(made)).stop()
        await asyncio.sleep(1.0)
        assert received_at_s(robot, since_s) - since_s <= LINE_S + LOOP_S
        assert len([at_s for at_s, payload in robot.commands if at_s >= since_s and payload != STOP]) <= 1

    numbered(check)


def test_a_thousand_messages_of_other_topics_do_not_delay_a_stop() -> None:
    async def check(made: World, robot: SimulatedRobot) -> None:
        assert robot.controls[0].target_ticks_s > 0
        for number in range(500):
            for wheel in "lr":
                publish(made.hub, f"/robot_0/pid_tune_{wheel}", {"x": 20.0 + number / 1000}, source="test")
        since_s = loop().time()
        (await ready(made)).stop()
        await expect(lambda: robot.controls[0].target_ticks_s == 0)
        # a turn for what was on the line already, and the 5 ms between two looks of `expect`
        assert loop().time() - since_s <= LINE_S + LOOP_S + LOOP_S + 0.005
        await asyncio.sleep(1.0)
        assert robot.controls[0].kp == pytest.approx(20.499)  # the newest came, after the stop

    simulated(check)


def test_stalled_daemon_sends_only_zero_afterwards() -> None:
    """Only the robot's own watchdog can stop it during the stall. Earlier commands must not move it afterwards."""

    async def check(made: World, robot: SimulatedRobot) -> None:
        sent = len(made.taps[-1].written)
        loop().burn(3.0)
        robot.advance(loop().time())
        assert robot.controls[0].target_ticks_s == 0
        await asyncio.sleep(1.0)
        later = [frame for frame in made.taps[-1].written[sent:] if frame[5:7] == b"\x64\x00"]
        assert {frame[7:-1] for frame in later} == {STOP}
        assert robot.speed_m_s == pytest.approx(0.0, abs=0.01)

    simulated(check)


def test_commands_that_waited_during_a_stall_are_refused_and_zeros_are_sent() -> None:
    async def check(made: World, robot: NumberedRobot) -> None:
        since_s = loop().time()
        loop().burn(3.0)
        for _ in range(60):
            with pytest.raises(CommandRefused, match=r"velocity is 3\.\d s old"):
                drive(made)
        drive(made, ZERO)
        for kind in (RefusalKind.LATE, RefusalKind.DISARMED):  # of a flood some is read later
            await asyncio.sleep(0.2)
            with pytest.raises(CommandRefused) as refused:
                drive(made)
            assert refused.value.kind is kind
        await asyncio.sleep(LEASE_S + 0.01)
        assert {payload for at_s, payload in robot.commands if at_s > since_s} == {STOP}
        drive(made)
        await expect(lambda: robot.commands[-1][1] != STOP)

    numbered(check)


@pytest.mark.slow
def test_robot_that_was_idle_for_minutes_is_driven_at_once_unless_the_daemon_stalled() -> None:
    async def check(made: MemoryHub) -> None:
        await made.connect()
        await asyncio.sleep(300.0)
        drive_gate(made.robot(), FAST, owner="test")
        await asyncio.sleep(300.0)
        loop().burn(0.7)
        with pytest.raises(CommandRefused, match=r"velocity is 0\.\d s old"):
            drive_gate(made.robot(), FAST, owner="test")
        await asyncio.sleep(0.3)
        drive_gate(made.robot(), FAST, owner="test")
        assert [log["seconds"] for log in made.logged("daemon.stalled")] == [pytest.approx(0.7, abs=0.11)]

    in_hub(check, Config(link=LinkConfig(silence_timeout_s=None, idle_timeout_s=None)))


class OtherDaemon(RecordingHosts):
    """Another daemon with one robot, which takes any received velocity as new."""

    def __init__(self) -> None:
        super().__init__()
        self.driven: list[PlanarVelocity] = []

    def drive(self, robot: RemoteRobot, command: Command[PlanarVelocity]) -> None:
        assert command.priority == PROGRAM_PRIORITY
        super().drive(robot, command)
        self.driven.append(command.velocity)


@asynccontextmanager
async def with_other_daemon() -> AsyncIterator[tuple[Hub, OtherDaemon]]:
    """A hub without devices that has long been alone."""
    hub, other = Hub(Config(), CATALOG, reraises=True), OtherDaemon()
    with capture_logs():
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(hub.run(), name="hub")
            await hub.is_running.wait()
            await asyncio.sleep(60.0)
            reach(hub, other)
            connected_robot(hub, "far", other)
            await asyncio.sleep(60.0)
            yield hub, other
            running.cancel()


@pytest.mark.parametrize("way", ["by name", "by topic"])
def test_commands_that_waited_during_a_stall_drive_no_robot_of_another_daemon(way: str) -> None:
    """That one cannot know how long they have waited here."""

    async def run() -> list[PlanarVelocity]:
        async with with_other_daemon() as (hub, other):
            program = hub.join("program")

            def drive(velocity: PlanarVelocity) -> None:
                if way == "by name":
                    program.drive(hub.robots.find("far"), velocity)
                else:
                    program.publish("/far/cmd_vel", velocity.encode())

            drive(FAST)
            loop().burn(3.0)
            for _ in range(5):
                with pytest.raises(CommandRefused, match=r"velocity is 3\.\d s old"):
                    drive(FAST)
            drive(ZERO)
            await asyncio.sleep(LEASE_S + 0.01)
            drive(FAST)
            return other.driven

    assert run_virtual(run()) == [FAST, ZERO, FAST]


def test_command_that_arrived_a_lease_ago_drives_no_robot_of_another_daemon() -> None:
    """A joystick whose old connection seems alive is known seconds after it has sent something."""

    async def run() -> list[PlanarVelocity]:
        async with with_other_daemon() as (hub, other):
            topic = hub.topics.find("/far/cmd_vel")
            with pytest.raises(CommandRefused, match=r"far: velocity is 0\.6 s old"):
                topic.publish(FAST.encode(), source="joystick", at_s=loop().time() - 0.6)
            topic.publish(SLOW.encode(), source="joystick", at_s=loop().time() - 0.1)
            return other.driven

    assert run_virtual(run()) == [SLOW]


def test_a_device_with_hundreds_of_velocities_leaves_each_turn_of_the_loop_to_others() -> None:
    """Four of them held the loop for 30 ms whenever they announced something else."""

    async def run() -> list[int]:
        async with running_hub(Hub(Config(), CATALOG, reraises=True)) as hub:
            host_end, device_end = memory_pair()
            hub.spawn(hub.links.serve(hub.links.open(host_end, ROSSERIAL)), name="link")
            twist = robot_topics()[1]
            topics = [twist._replace(id=100 + each, name=f"/{each}/cmd_vel") for each in range(256)]
            infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in topics)
            await device_end.send(infos + encode(Id.TIME, bytes(8)))
            stepped = [0]
            while stepped[-1] < len(topics):
                await asyncio.sleep(0)
                stepped.append(sum(not each.gate.is_new_device for each in hub.robots.drivables()))
            await device_end.aclose()
            return [later - earlier for earlier, later in itertools.pairwise(stepped)]

    assert max(run_virtual(run())) <= MAX_STEPS


# -- a socket that takes nothing --------------------------------------------------------------------------------------


class Deaf:
    """A device that has announced its topics and then does not read."""

    def __init__(self, hub: Hub, end: MemoryTransport) -> None:
        self.hub = hub
        self._end = end
        self._stream = FrameStream()

    async def announce(self) -> None:
        await self._end.receive()
        infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics())
        await self._end.send(infos + encode(Id.TIME, bytes(8)))

    async def velocities(self, count: int) -> list[bytes]:
        """Read on until so many velocities came."""
        found: list[bytes] = []
        while len(found) < count:
            data = await self._end.receive()
            found += [
                item.payload for item in self._stream.feed(data) if isinstance(item, Frame) and item.topic_id == 100
            ]
        return found


@asynccontextmanager
async def deaf(room_bytes: int, write_timeout_s: float = 5.0) -> AsyncIterator[Deaf]:
    hub = Hub(Config(link=LinkConfig(write_timeout_s=write_timeout_s)), CATALOG, reraises=True)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(hub.run())
        await hub.is_running.wait()
        host_end, device_end = memory_pair(room_bytes=room_bytes)
        device = Deaf(hub, device_end)
        hub.spawn(hub.links.serve(hub.links.open(host_end, ROSSERIAL)), name="link")
        await device.announce()
        assert await device.velocities(3) == [STOP] * 3
        yield device
        running.cancel()


def test_a_socket_that_was_full_delivers_the_stop_and_nothing_that_was_commanded_before_it() -> None:
    """Frames in the kernel's buffer cannot be taken back: here two. Of all later frames only the newest is left."""

    async def run() -> None:
        async with deaf(room_bytes=2 * 56) as device:
            robot = device.hub.robots.find("robot_0")
            for number in range(20):
                velocity = PlanarVelocity(x_m_s=0.1 + number / 100)
                drive_gate(robot, velocity, owner="test")
                await asyncio.sleep(0.1)
            assert robot.link is not None
            assert robot.link.session.outbox.oldest_s(loop().time()) < 0.2  # the newest; those before it are gone
            robot.stop()
            heard = await device.velocities(5)
        speeds = [struct.unpack_from("<d", payload)[0] for payload in heard]
        assert speeds[:3] == pytest.approx([0.1, 0.11, 0.12])  # two in the room, one that was being written
        assert speeds[3:] == [0.0, 0.0]

    with capture_logs():
        run_virtual(run())


def test_a_socket_that_stays_full_ends_its_link() -> None:
    async def run() -> None:
        async with deaf(room_bytes=56, write_timeout_s=2.0) as device:
            robot = device.hub.robots.find("robot_0")
            drive_gate(robot, FAST, owner="test")
            robot.stop()
            await asyncio.sleep(2.5)
            assert robot.link is None

    with capture_logs() as lines:
        run_virtual(run())
    assert next(line["reason"] for line in lines if line["event"] == "link.closed") == "broken"


def test_a_velocity_that_waited_for_the_loop_has_the_rest_of_its_lease_alone() -> None:
    """The velocity may have arrived when the turn of the loop began that lasted 0.4 s."""

    async def check(made: World, robot: NumberedRobot) -> None:
        loop().burn(0.4)
        since_s = loop().time()
        drive(made, SLOW)
        await asyncio.sleep(1.0)
        # 0.1 s are left of its lease; a beat of the loop may be as far from the turn's beginning as two ticks
        assert received_at_s(robot, since_s) - since_s <= 0.1 + 3 * TICK_S + LINE_S + LOOP_S

    numbered(check)


def test_velocity_that_waited_while_another_client_stopped_the_robot_disarms_its_source() -> None:
    async def check(made: World, robot: NumberedRobot) -> None:
        robot_0, program = await ready(made), made.hub.join("program")
        await asyncio.sleep(1.0)
        came_s = loop().time()
        await asyncio.sleep(0.2)
        made.hub.robots.find("robot_0").stop(by="another client")
        for received_s in (came_s, None, None):
            with pytest.raises(CommandRefused, match=r"a stop by another client") as refused:
                program.drive(robot_0, SLOW, received_s=received_s)
            assert refused.value.kind is RefusalKind.DISARMED
            await asyncio.sleep(0.1)
        await asyncio.sleep(LEASE_S)
        program.drive(robot_0, SLOW)
        received_at_s(robot, came_s)

    numbered(check)


def test_stop_and_velocity_that_a_late_loop_reads_at_once_have_no_order() -> None:
    """A source that began to drive after the stop is not refused until it pauses."""

    async def check(made: World, robot: NumberedRobot) -> None:
        robot_0, program = await ready(made), made.hub.join("program")
        await asyncio.sleep(1.0)
        loop().burn(0.3)
        made.hub.robots.find("robot_0").stop(by="another client")
        program.drive(robot_0, SLOW)
        await asyncio.sleep(0.1)
        program.drive(robot_0, SLOW)

    numbered(check)


def test_a_zero_is_obeyed_however_old_it_is() -> None:
    async def check(made: World, robot: NumberedRobot) -> None:
        robot_0, topic = await ready(made), made.hub.topics.find("/robot_0/velocity_commands")
        program = made.hub.join("program", priority=60)
        program.drive(robot_0, FAST, sent_s=loop().time())
        await asyncio.sleep(0.1)
        since_s = loop().time()
        program.drive(robot_0, ZERO, sent_s=since_s - 9.0)
        await asyncio.sleep(0.2)
        assert received_at_s(robot, since_s) - since_s <= LINE_S + LOOP_S
        program.drive(robot_0, FAST)
        await asyncio.sleep(0.1)
        since_s = loop().time()
        topic.publish(ZERO.encode(), source=program, at_s=since_s - 9.0)
        await asyncio.sleep(0.2)
        assert received_at_s(robot, since_s) - since_s <= LINE_S + LOOP_S

    numbered(check)
