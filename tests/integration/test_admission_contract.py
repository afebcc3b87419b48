"""Every entry point of a velocity asks the admission, and passes on what the admission needs to decide.

The entry points are real; the device is scripted and runs in virtual time. Each row of CONNECTION runs for each entry
point: one row for each kind of refusal, and one for each fact that an entry point passes on (a zero, an epoch, an age,
a component, a departure). The rows of RULES run for the entry points of COMPLETE alone.
tests/unit/core/robot/test_admission.py and tests/property/test_admission.py test the rules themselves.
"""

import ast
import asyncio
import contextlib
import dataclasses
from collections import Counter
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from hostlink.core.config import Config
from hostlink.core.hub.participant import Participant
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Frame
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.robot.admission import LEASE_S, Admission
from hostlink.core.robot.kinematics import DifferentialDrive
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity, Twist
from hostlink.errors import CommandRefused, HostlinkError, RefusalKind
from tests.support import entry_points
from tests.support.command_boards import BOARDS
from tests.support.entry_points import EntryPoint
from tests.support.fake_device import topic
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.participants import ROBOT, Scene, play
from tests.support.scripted_board import DEVICES
from tests.support.virtual_loop import VirtualLoop

HOSTLINK = Path(__file__).parent.parent.parent / "hostlink"

ENTRY_POINTS: list[type[EntryPoint]] = [
    entry_points.RosbridgePublish,
    entry_points.RosbridgePublishAtOnce,
    entry_points.RosbridgeRaw,
    entry_points.TwistStamped,
    entry_points.RosbridgeDrive,
    entry_points.RosbridgeDriveAtOnce,
    entry_points.Page,
    entry_points.RestPut,
    entry_points.FoxglovePublish,
    entry_points.ClientCommand,
    entry_points.ClientDrive,
    entry_points.Teleop,
    entry_points.Play,
    entry_points.RclpyBridge,
    entry_points.Ros1Publisher,
    entry_points.RmwPublisher,
    entry_points.Fleet,
    entry_points.FleetPublisher,
    entry_points.FleetSender,
    entry_points.FleetSenderPublish,
    entry_points.DevicePublisher,
    entry_points.SerialPublisher,
    entry_points.UdpPublisher,
    entry_points.ComponentDrive,
    entry_points.Demo,
]


class Robot:
    """The robot that is driven, as its device and its admission show it."""

    def __init__(self, made: Scene, way: EntryPoint) -> None:
        self.made, self.way, self.refused_before = made, way, Counter[RefusalKind]()

    @property
    def admission(self) -> Admission:
        return self.made.hub.robots.find(ROBOT).gate.admission

    @property
    def refused(self) -> set[RefusalKind]:
        """The kinds of what was refused since `forget`."""
        return set(self.way.refused() - self.refused_before)

    def forget(self) -> None:
        self.refused_before = self.way.refused()

    @property
    def speed_m_s(self) -> float:
        return self.made.speeds()[-1]

    async def stands(self, for_s: float) -> None:
        """Check that the robot stops within the time of a frame and stays stopped."""
        await asyncio.sleep(0.05)
        before = len(self.made.speeds())
        await asyncio.sleep(for_s)
        assert not any(self.made.speeds()[before - 1 :])

    async def moves(self, within_s: float = 0.3) -> None:
        await asyncio.sleep(within_s)
        assert self.speed_m_s > 0.0

    async def connect_again(self) -> None:
        self.made.connect()
        await self.made.robot.is_announced()


Row = Callable[[EntryPoint, Robot], Awaitable[None]]


# -- interruptions ----------------------------------------------------------------------------------------------------


async def stop(robot: Robot) -> None:
    robot.made.hub.robots.find(ROBOT).stop()


async def stop_all(robot: Robot) -> None:
    robot.made.hub.robots.stop_all()


async def lock_and_unlock(robot: Robot) -> None:
    found = robot.made.hub.robots.find(ROBOT)
    found.lock("smoke")
    await asyncio.sleep(0.2)
    found.unlock()


async def reconnect(robot: Robot) -> None:
    await robot.made.robot.aclose()
    await robot.connect_again()


async def come_back_after_a_while(robot: Robot) -> None:
    await robot.made.robot.aclose()
    await asyncio.sleep(3 * LEASE_S)
    await robot.connect_again()


async def announce_other_topics(robot: Robot) -> None:
    robot.made.robot.infos.append(topic(EndpointKind.SUBSCRIBER, 102, f"/{ROBOT}/arm_vel", TWIST_TYPE))
    await robot.made.robot.announce()
    await asyncio.sleep(0.1)


async def pause(_: Robot) -> None:
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.burn(3.0)
    await asyncio.sleep(0)


async def stop_and_pause(robot: Robot) -> None:
    """The robot is at rest when the daemon pauses."""
    await stop(robot)
    await asyncio.sleep(2 * LEASE_S)
    await pause(robot)


# -- rows -------------------------------------------------------------------------------------------------------------


async def admitted(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves()
    await robot.moves(2 * LEASE_S)
    assert robot.refused == set()


async def lease_ends(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves()
    way.silence()
    await asyncio.sleep(LEASE_S + 0.05)
    assert robot.speed_m_s == 0.0


async def zero_arms(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves()
    await stop(robot)
    await robot.stands(LEASE_S)
    await way.zero()
    await way.start()
    await robot.moves()


async def silence_arms(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves()
    await stop(robot)
    await robot.stands(LEASE_S)
    way.silence()
    await asyncio.sleep(LEASE_S + 0.1)
    await way.start()
    if not way.goes_on:
        await way.start()  # it was told of the interruption, once
    await robot.moves()


async def lateness_arms_nothing(way: EntryPoint, robot: Robot) -> None:
    """The source is silent for less than a lease; the daemon, which is late but not paused, reads it after more."""
    await way.start()
    await robot.moves()
    await stop(robot)
    await robot.stands(LEASE_S)
    way.silence()
    await asyncio.sleep(0.2)
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.burn(LEASE_S - 0.15)
    await way.start()
    await robot.stands(1.0)


async def current_epoch_arms(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves(0.35)  # no command is on its way
    way.silence()
    await stop(robot)
    await asyncio.sleep(0.2)  # another daemon reports the interruption
    await way.give(entry_points.SPEED_M_S, epoch=way.epoch)
    await robot.moves(0.1)


async def earlier_epoch_is_refused(way: EntryPoint, robot: Robot) -> None:
    before = way.epoch
    await stop(robot)
    for _ in range(8):
        with contextlib.suppress(HostlinkError):
            await way.give(entry_points.SPEED_M_S, epoch=before)
        await asyncio.sleep(0.1)
    assert not any(robot.made.speeds())
    assert robot.refused == {RefusalKind.DISARMED}


async def late_is_refused(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves()
    way.late_s = 1.0
    await asyncio.sleep(LEASE_S + 0.1)
    await robot.stands(1.0)
    assert robot.refused == {RefusalKind.LATE}


async def locked(way: EntryPoint, robot: Robot) -> None:
    robot.made.hub.robots.find(ROBOT).lock("smoke")
    await asyncio.sleep(0.2)  # another daemon reports the lock
    await way.start()
    await robot.stands(1.0)
    assert robot.refused == {RefusalKind.LOCKED}


async def not_connected(way: EntryPoint, robot: Robot) -> None:
    await robot.made.robot.aclose()
    await asyncio.sleep(0.1)
    await way.start()
    await asyncio.sleep(2 * LEASE_S)
    assert robot.refused == {RefusalKind.NOT_CONNECTED}
    await robot.connect_again()
    await robot.stands(1.0)


async def new_robot(way: EntryPoint, robot: Robot) -> None:
    """The robot of before is forgotten: nothing of the new one was known when the stream began."""
    await robot.made.robot.aclose()
    await asyncio.sleep(0.1)
    robot.made.hub.robots.forget(ROBOT)
    await way.start()
    await asyncio.sleep(2 * LEASE_S)
    await robot.connect_again()
    await robot.stands(1.0)
    assert robot.refused == {RefusalKind.DISARMED}
    await way.zero()
    await way.start()
    await robot.moves()


async def resumes(way: EntryPoint, robot: Robot) -> None:
    found = robot.made.hub.robots.find(ROBOT)
    found.config = dataclasses.replace(found.config, resume_after_reconnect_s=5.0)  # applied when its device connects
    robot.admission.resume_after_reconnect_s = 5.0
    await way.start()
    await robot.moves()
    for _ in range(2):
        await come_back_after_a_while(robot)
        await robot.moves(0.5)
    assert robot.refused == {RefusalKind.NOT_CONNECTED}


async def held(way: EntryPoint, robot: Robot) -> None:
    person = robot.made.hub.join("person", priority=100)
    for _ in range(3):
        person.drive(robot.made.hub.robots.find(ROBOT), PlanarVelocity(0.4))
        await way.start()
        await asyncio.sleep(LEASE_S - 0.1)
        assert robot.speed_m_s == 0.4
    assert robot.refused <= {RefusalKind.HELD}


def rival(way: EntryPoint, robot: Robot, speed_m_s: float = 0.4, *, take_over: bool = False) -> Participant:
    """Drive as another program of the same priority, until it leaves."""
    other = robot.made.hub.join("rival", priority=way.priority)
    found = robot.made.hub.robots.find(ROBOT)

    other.drive(found, PlanarVelocity(speed_m_s), take_over=take_over)

    async def drive() -> None:
        while not other.has_left:
            await asyncio.sleep(0.1)
            with contextlib.suppress(HostlinkError):
                other.drive(found, PlanarVelocity(speed_m_s))

    robot.made.tasks.create_task(drive())
    return other


async def held_by_equal(way: EntryPoint, robot: Robot) -> None:
    """The one that drives first keeps the robot."""
    other = rival(way, robot)
    await asyncio.sleep(0.05)
    before = len(robot.made.speeds())
    for _ in range(2):
        await way.start()
        await asyncio.sleep(LEASE_S)
    assert set(robot.made.speeds()[before:]) == {0.4}
    assert robot.refused <= {RefusalKind.HELD}
    other.leave()


async def keeps_from_equal(way: EntryPoint, robot: Robot) -> None:
    """One that was taken over drives again after it let go, and not before."""
    await way.start()
    await robot.moves()
    found = robot.made.hub.robots.find(ROBOT)
    other = robot.made.hub.join("other", priority=way.priority)
    with pytest.raises(CommandRefused, match="with the same priority") as refused:
        other.drive(found, PlanarVelocity(0.4))
    assert refused.value.kind is RefusalKind.HELD
    assert str(refused.value.holder) in str(refused.value)
    await robot.moves()
    assert robot.speed_m_s != 0.4
    robot.forget()
    taker = rival(way, robot, take_over=True)
    await asyncio.sleep(0.05)
    before = len(robot.made.speeds())
    await asyncio.sleep(2 * LEASE_S)
    assert set(robot.made.speeds()[before:]) == {0.4}
    if way.goes_on:
        assert robot.refused == {RefusalKind.HELD}
    taker.leave()
    await robot.stands(2 * LEASE_S)
    if way.goes_on:
        assert robot.refused == {RefusalKind.HELD, RefusalKind.DISARMED}


async def takes_over(way: EntryPoint, robot: Robot) -> None:
    other = rival(way, robot)
    await way.start()
    await asyncio.sleep(LEASE_S)
    assert robot.speed_m_s == 0.4
    way.silence()
    way.take_over = True
    await way.start()
    await asyncio.sleep(0.3)
    before = len(robot.made.speeds())
    await asyncio.sleep(LEASE_S)
    assert set(robot.made.speeds()[before:]) == {entry_points.SPEED_M_S}
    other.leave()


async def goes_on_afterwards(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves()
    person = robot.made.hub.join("person", priority=100)
    for _ in range(5):
        person.drive(robot.made.hub.robots.find(ROBOT), PlanarVelocity(0.4))
        await asyncio.sleep(0.1)
        assert robot.speed_m_s == 0.4
    person.leave()
    await robot.moves(entry_points.AFTERWARDS_S.get(type(way), 0.3))
    assert robot.speed_m_s != 0.4
    assert robot.refused <= {RefusalKind.HELD}


async def zero_of_another(way: EntryPoint, robot: Robot) -> None:
    other = robot.made.hub.join("other")

    async def drive() -> None:
        while True:
            other.drive(robot.made.hub.robots.find(ROBOT), PlanarVelocity(0.4))
            await asyncio.sleep(0.1)

    driving = robot.made.tasks.create_task(drive())
    await asyncio.sleep(0.1)
    await way.zero()
    await asyncio.sleep(0.1)
    assert robot.speed_m_s == 0.4
    assert all(robot.made.speeds()[-2:])
    driving.cancel()


async def not_finite(way: EntryPoint, robot: Robot) -> None:
    refused = None
    try:
        await way.give(float("nan"))
    except HostlinkError as error:
        refused = error
    await asyncio.sleep(0.1)
    assert robot.refused == {RefusalKind.NOT_FINITE} or getattr(refused, "kind", "") == RefusalKind.NOT_FINITE
    assert not any(robot.made.speeds())


async def passed_and_limited(way: EntryPoint, robot: Robot) -> None:
    await way.give(0.0, left_m_s=-3.0)
    await asyncio.sleep(0.1)
    assert robot.made.twists()[-1] == Twist(linear_y_m_s=-1.0)
    assert robot.made.hub.robots.find(ROBOT).gate.current == PlanarVelocity(0.0, -1.0)
    assert robot.refused == set()


async def unsupported(way: EntryPoint, robot: Robot) -> None:
    robot.admission.drive = DifferentialDrive()
    with contextlib.suppress(HostlinkError):
        await way.give(entry_points.SPEED_M_S, left_m_s=0.1)
    await asyncio.sleep(0.1)
    assert robot.refused == {RefusalKind.UNSUPPORTED}
    assert not any(map(any, robot.made.twists()))


async def leaves(way: EntryPoint, robot: Robot) -> None:
    await way.start()
    await robot.moves()
    way.silence()
    await way.vanish()
    await asyncio.sleep(0.05)
    assert robot.speed_m_s == 0.0
    assert not robot.admission.is_held(asyncio.get_running_loop().time())


def interrupted_by(interrupt: Callable[[Robot], Awaitable[None]]) -> Row:
    async def row(way: EntryPoint, robot: Robot) -> None:
        await way.start()
        await robot.moves()
        robot.forget()
        await interrupt(robot)
        await robot.stands(2.0)
        if way.goes_on:
            assert RefusalKind.DISARMED in robot.refused

    return row


#: What each entry point has to do for the admission. A reconnection is one of them: a graph may mirror its publishers
#: again when the device is back, and must not take them for new ones.
CONNECTION: dict[str, Row] = {
    "a command is admitted for a lease": admitted,
    "stop disarms": interrupted_by(stop),
    "come_back_after_a_while disarms": interrupted_by(come_back_after_a_while),
    "pause disarms": interrupted_by(pause),
    "a zero arms": zero_arms,
    "an earlier epoch is refused": earlier_epoch_is_refused,
    "a velocity that is not finite": not_finite,
    "y is passed and limited": passed_and_limited,
    "y is refused for a differential drive": unsupported,
    "a command while locked is refused": locked,
    "a command without device is refused": not_connected,
    "a stream from before a new robot is disarmed": new_robot,
    "a command that is late is refused": late_is_refused,
    "a command is refused while a higher priority holds": held,
    "a command is refused while one of the same priority drives": held_by_equal,
    "one that drives is kept and may be taken over": keeps_from_equal,
    entry_points.TAKES_OVER: takes_over,
    "one that leaves stops": leaves,
}
#: What follows in the admission from the above, whatever the entry point is.
RULES: dict[str, Row] = {
    "the lease ends": lease_ends,
    "stop_all disarms": interrupted_by(stop_all),
    "lock_and_unlock disarms": interrupted_by(lock_and_unlock),
    "reconnect disarms": interrupted_by(reconnect),
    "announce_other_topics disarms": interrupted_by(announce_other_topics),
    "stop_and_pause disarms": interrupted_by(stop_and_pause),
    "a lease of silence arms": silence_arms,
    "a daemon that is late arms nothing": lateness_arms_nothing,
    "the current epoch arms": current_epoch_arms,
    "a stream goes on after a reconnection within resume_after_reconnect_s": resumes,
    "a lower priority goes on afterwards": goes_on_afterwards,
    "a zero of another changes nothing": zero_of_another,
}
ROWS = CONNECTION | RULES
#: A Twist without epoch, a command with one, and a sender that has an admission of its own beside that of the robot.
COMPLETE = (entry_points.RosbridgePublish, entry_points.RosbridgeDrive, entry_points.FleetSender)


def rows_of(entry_point: type[EntryPoint]) -> list[str]:
    """Return the names of the rows that run for an entry point."""
    rows = ROWS if entry_point in COMPLETE else CONNECTION
    return [name for name in rows if name not in entry_point.cannot]


#: What gives velocities in the source, and the entry points here that come that way. A `drive`, `command`, `follow` or
#: `publish` that is not here is a way by which a robot may be driven without a test.
SITES: dict[str, tuple[type[EntryPoint], ...]] = {
    "components/gateway/rosbridge.py: robot.drive": (
        entry_points.RosbridgeDrive, entry_points.RosbridgeDriveAtOnce, entry_points.Page,
    ),
    "components/gateway/rosbridge.py: self.participant.publish_twist": (entry_points.RosbridgePublishAtOnce,),
    "components/gateway/rest.py: robot.drive": (entry_points.RestPut,),
    "components/gateway/rosbridge.py: self.participant.publish": (
        entry_points.RosbridgePublish, entry_points.RosbridgeRaw, entry_points.TwistStamped,
    ),
    "components/gateway/foxglove.py: self.participant.publish": (entry_points.FoxglovePublish,),
    "cli/demo.py: self._participant.drive": (entry_points.Demo,),
    "core/host.py: participant.drive": (entry_points.ComponentDrive,),
    "cli/play.py: driven.drive": (entry_points.Play,),
    "cli/teleop.py: self._robot.command": (entry_points.Teleop,),
    "cli/calibration_session.py: robot.command": (entry_points.ClientCommand,),
    "cli/step.py: self._robot.command": (entry_points.ClientCommand,),
    "cli/play.py: host.publish": (entry_points.RosbridgePublish,),  # --as-program; it leaves out what may move a robot
    "cli/topics.py: host.publish": (entry_points.RosbridgePublish,),
    "client/robot.py: self._driver.drive": (entry_points.ClientDrive,),
    "client/robot.py: self._driver.command": (entry_points.ClientCommand,),
    "client/motion.py: self._driver.drive": (entry_points.ClientDrive,),
    "client/motion.py: held.drive": (entry_points.ClientDrive,),
    "client/host.py: self._topics.publish": (entry_points.RosbridgePublish, entry_points.RosbridgeRaw),
    "components/ros2/velocity.py: robot.command": (entry_points.RclpyBridge,),
    "components/ros1/topics.py: participant.publish": (entry_points.Ros1Publisher,),
    "components/zenoh/rmw_bridge.py: self.participant.publish": (entry_points.RmwPublisher,),
    "components/zenoh/rmw_bridge.py: publisher.publish": (entry_points.RmwPublisher,),
    "components/zenoh/rmw_bridge.py: self._publishers.publish": (entry_points.RmwPublisher,),
    "components/zenoh/fleet_commands.py: self._here.drive": (entry_points.Fleet,),
    "components/zenoh/fleet_commands.py: self._participant(neighbour, _PUBLISHER, 'programs').publish": (
        entry_points.FleetPublisher,
    ),
    "components/zenoh/fleet_topics.py: self._drivers.publish": (entry_points.FleetPublisher,),
    "core/hub/device.py: topic.publish": (
        entry_points.DevicePublisher, entry_points.SerialPublisher, entry_points.UdpPublisher,
    ),
    "core/hub/gates.py: self.gates.command": (entry_points.RosbridgeDrive, entry_points.RosbridgePublish),
    "core/hub/gates.py: self.command": (entry_points.RosbridgePublish, entry_points.TwistStamped),
    "core/hub/participant.py: known.publish": (entry_points.RosbridgePublish,),
    "core/hub/participant.py: robot.command": (entry_points.RosbridgeDrive,),
    "core/hub/robot_handle.py: participant.drive": (entry_points.RosbridgeDrive, entry_points.RestPut),
    "core/hub/participant.py: target.receive_twist": (entry_points.RosbridgePublishAtOnce,),
    "core/hub/gates.py: self.receive_twist": (entry_points.RosbridgePublish, entry_points.TwistStamped),
    "core/hub/gates.py: gate.command": (entry_points.RosbridgeDrive,),
    "core/hub/robots_here.py: participant.drive": (entry_points.Fleet,),
    "core/hub/remote_robot.py: self.provision.drive": (entry_points.FleetSender, entry_points.FleetSenderPublish),
    "core/hub/providers.py: self._provider.drive": (entry_points.FleetSender, entry_points.FleetSenderPublish),
}  # fmt: skip
#: What has the same name, and gives no velocity.
OTHERS = {
    "components/gateway/events.py: robot.follow": "poses",
    "core/hub/robot_handle.py: participant.follow": "poses",
    "components/gateway/rest.py: self._owner(request).publish": "the reset of the odometry",
    "components/gateway/rosbridge.py: self._topics.publish": "an advertisement",
    "cli/calibration_session.py: self._drives.follow": "calls Drives.follow",
    "cli/calibrate.py: self._session.follow": "calls calibration_session.py",
    "cli/teleop.py: watched.follow": "events",
    "cli/play.py: device.publish": "a played device obeys nobody, and its velocities drive nobody",
    "cli/step.py: host.publish": "gains",
    "components/ros2/routes.py: echoes.publish": "to ROS 2",
    "components/ros2/routes.py: publisher.publish": "to ROS 2",
    "components/zenoh/fleet.py: self._robots.follow": "poses",
    "components/zenoh/fleet_topics.py: self._participant.publish": "what a device elsewhere sends; no velocity",
    "core/hub/device.py: self.link.session.publish": "to the device",
    "core/host.py: self._follower.follow": "poses",
    "core/hub/diagnostics_topic.py: self._participant.publish": "diagnostics",
    "core/hub/gates.py: link.session.publish": "to the device",
    "core/hub/robot_topic_publisher.py: topic.publish": "odometry",
    "core/hub/rosout.py: self._participant.publish": "lines of the log",
}


#: Components that know the core by `Host` alone, as import rows check: they drive by `Host.drive`.
BEHIND_HOST = ("components/mqtt/",)
MAY_DRIVE = ("drive", "command", "follow", "publish", "publish_twist", "receive_twist")


def calls_that_may_drive() -> set[str]:
    """Every call of that name outside of the simulation, the laboratory and the boards."""
    found = set()
    for path in HOSTLINK.rglob("*.py"):
        name = path.relative_to(HOSTLINK).as_posix()
        if name.startswith(("workbench/sim/", "workbench/lab/", "firmware/", *BEHIND_HOST)):
            continue
        source = path.read_text()
        if not any(f".{verb}(" in source for verb in MAY_DRIVE):  # parsing the whole tree would take seconds
            continue
        for node in ast.walk(ast.parse(source)):
            is_method = isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
            if is_method and node.func.attr in MAY_DRIVE:
                text = ast.unparse(node.func)
                if not text.startswith("app."):
                    found.add(f"{name}: {text}")
    return found


@pytest.mark.slow
def test_every_call_that_may_drive_belongs_to_an_entry_point() -> None:
    """A new one needs an entry point in tests/support/entry_points.py; what gives no velocity is noted in OTHERS."""
    assert calls_that_may_drive() == SITES.keys() | OTHERS.keys()
    assert {each for ways in SITES.values() for each in ways} == set(ENTRY_POINTS)


def test_command_is_made_in_two_places_alone() -> None:
    made = [
        path.relative_to(HOSTLINK).as_posix()
        for path in HOSTLINK.rglob("*.py")
        if "Command(" in (source := path.read_text())
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Command"
    ]
    assert sorted(made) == ["core/hub/gates.py", "core/hub/participant.py"]


def test_rows_that_an_entry_point_cannot_express_exist() -> None:
    for entry_point in ENTRY_POINTS:
        assert entry_point.cannot.keys() <= ROWS.keys()


@pytest.mark.slow
@pytest.mark.parametrize("protocol", DEVICES)
@pytest.mark.parametrize(
    ("entry_point", "row"), [(entry_point, row) for entry_point in ENTRY_POINTS for row in rows_of(entry_point)]
)
def test_row_holds_for_entry_point(entry_point: type[EntryPoint], row: str, protocol: str) -> None:
    async def test(made: Scene) -> None:
        way = entry_point(made)
        robot = Robot(made, way)
        await way.begin()
        robot.forget()
        try:
            await ROWS[row](way, robot)
        finally:
            await way.end()

    play(test, make_device=DEVICES[protocol])


#: What every board hears of every entry point, whatever its type of command.
OF_EVERY_BOARD = [
    each for each in ENTRY_POINTS if each not in (entry_points.RosbridgeRaw, entry_points.Play, entry_points.Demo)
]


@pytest.mark.slow
@pytest.mark.parametrize("protocol", DEVICES)
@pytest.mark.parametrize("entry_point", OF_EVERY_BOARD)
@pytest.mark.parametrize("name", BOARDS)
def test_board_of_each_command_type_obeys_the_admission(
    name: str, entry_point: type[EntryPoint], protocol: str
) -> None:
    """Lease, limit, stop, lock, reboot of the board and end of the source, by what the board received.

    `RosbridgeRaw` publishes a Twist on the device's own topic; `Play` and `Demo` end with their first refusal.
    """
    board = BOARDS[name]

    async def test(made: Scene) -> None:
        way, found = entry_point(made), made.hub.robots.find_here(ROBOT)
        await way.begin()
        lines = []

        def newest() -> list[tuple[int, bytes]]:
            return [(number, made.robot.payloads(info.id)[-1]) for number, info in enumerate(board.infos)]

        async def moves(event: str) -> None:
            await asyncio.sleep(0.5)
            heard = newest()
            lines.append((event, heard))
            assert not any(board.is_at_rest(number, payload) for number, payload in heard if number in board.motors), (
                lines
            )

        async def rests(event: str, for_s: float = 1.0) -> None:
            await asyncio.sleep(0.1)
            before = [len(made.robot.payloads(info.id)) for info in board.infos]
            lines.append((event, newest()))
            await asyncio.sleep(for_s)
            for number, info in enumerate(board.infos):
                since = made.robot.payloads(info.id)[before[number] - 1 :]
                assert since, lines
                assert all(board.is_at_rest(number, payload) for payload in since), lines

        async def again() -> None:
            await way.zero()
            await asyncio.sleep(LEASE_S + 0.2)
            await way.start()

        await rests("connected")
        await way.start()
        await moves("driven")
        assert max(board.largest(number, payload) for number, payload in newest()) <= 1.0  # the usual limit
        way.silence()
        await asyncio.sleep(LEASE_S)
        await rests("the lease has ended")
        await again()
        await moves("driven again")
        found.stop()
        await rests("stopped")
        await again()
        await moves("armed by a zero")
        found.lock("smoke")
        await rests("locked")
        found.unlock()
        await rests("unlocked")
        await again()
        await moves("armed by a zero again")
        await made.robot.aclose()
        made.connect()
        await made.robot.is_announced()
        await rests("rebooted")
        await again()
        await moves("armed after the reboot")
        way.silence()
        await way.vanish()
        await rests("the source has left")
        await way.end()
        assert made.hub.robots.find_here(ROBOT) is found

    config = Config() if board.config is None else Config(robots={ROBOT: board.config})
    play(test, config, board.infos, DEVICES[protocol])


@pytest.mark.parametrize("name", BOARDS)
def test_guardian_has_frames_that_stop_each_command_type(name: str) -> None:
    """The guardian writes one frame for each command topic after the daemon was killed; each frame means rest."""
    board = BOARDS[name]

    async def test(made: MemoryHub) -> None:
        device = await made.connect(board.infos, address="10.0.0.1")
        zeros, _ = made.guard.watched[device.link.number]
        stream = FrameStream()
        frames = list(stream.feed(b"".join(zeros)))
        assert [frame.topic_id for frame in frames if isinstance(frame, Frame)] == [info.id for info in board.infos]
        for number, frame in enumerate(frames):
            assert isinstance(frame, Frame)
            assert board.is_at_rest(number, frame.payload)
        assert device.link.last_frames == (b"".join(zeros),)  # the daemon's own last words are the same
        made.hub.join("driver").drive(made.robot(ROBOT), PlanarVelocity(0.2))
        await asyncio.sleep(0.1)
        assert made.guard.driven == {device.link.number}
        await device.aclose()

    in_hub(test, Config() if board.config is None else Config(robots={ROBOT: board.config}))


def test_stream_of_ros2_that_is_not_planar_is_refused_and_disarmed_by_a_stop() -> None:
    """tests/unit/core/hub/test_gates.py has the same for what is published. `cannot` would name all other ways here."""

    async def test(made: Scene) -> None:
        way = entry_points.RclpyBridge(made)
        robot = Robot(made, way)
        await way.begin()
        for number in range(10):
            await way.give_twist(Twist(entry_points.SPEED_M_S, angular_x_rad_s=0.1))
            await asyncio.sleep(0.1)
            if number == 5:
                await stop(robot)
        assert robot.refused == {RefusalKind.UNSUPPORTED}
        await way.give(entry_points.SPEED_M_S)
        await asyncio.sleep(0.1)
        assert RefusalKind.DISARMED in robot.refused
        assert not any(map(any, made.twists()))
        await way.end()

    play(test)


def test_each_kind_of_refusal_and_each_row_runs_for_an_entry_point() -> None:
    assert {row for entry_point in COMPLETE for row in rows_of(entry_point)} == set(ROWS)
