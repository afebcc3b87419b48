"""A robot of two boards: motors on one, encoders on the other."""

import asyncio
import contextlib
import struct
from collections.abc import Callable, Sequence

import pytest

from hostlink.cli.explain import explanation
from hostlink.core.config import Config, RobotConfig, WheelsConfig
from hostlink.core.hub.devices import Devices
from hostlink.core.hub.reloader import places_of
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.robot.events import EventKind, RobotEvent
from hostlink.core.robot.velocity import PlanarVelocity
from hostlink.errors import CommandRefused, UnknownTopic
from tests.support.fake_device import topic
from tests.support.memory_hub import MemoryHub, in_hub, velocities
from tests.support.scripted_device import ScriptedDevice

MOTORS, WHEELS, ARM = "10.0.0.2", "10.0.0.3", "10.0.0.4"
COMMAND = [topic(EndpointKind.SUBSCRIBER, 100, "cmd_vel", "geometry_msgs/Twist")]
POSE = [topic(EndpointKind.PUBLISHER, 125, "odom", "geometry_msgs/Pose2D")]
OTHER_COMMAND = [*POSE, topic(EndpointKind.SUBSCRIBER, 101, "other/cmd_vel", "geometry_msgs/Twist")]
CONFIG = Config(robots={"r": RobotConfig(devices=(MOTORS, WHEELS))})
CHOSEN = Config(robots={"r": RobotConfig(devices=(MOTORS, WHEELS), command_device=MOTORS)})
THREE = Config(robots={"r": RobotConfig(devices=(MOTORS, WHEELS, ARM), command_device=MOTORS)})
SLOW = PlanarVelocity(0.25)


async def connected(
    made: MemoryHub, *, wheels: Sequence[DeviceEndpoint] = POSE, first: str = MOTORS
) -> tuple[ScriptedDevice, ScriptedDevice]:
    order = [MOTORS, WHEELS] if first == MOTORS else [WHEELS, MOTORS]
    found = {place: await made.connect(COMMAND if place == MOTORS else wheels, address=place) for place in order}
    await asyncio.sleep(1.0)
    return found[MOTORS], found[WHEELS]


def drive(made: MemoryHub, velocity: PlanarVelocity = SLOW) -> None:
    made.hub.join("program").drive(made.robot("r"), velocity)


def odometry(x: float) -> bytes:
    return struct.pack("<3d", x, 0.0, 0.0)


@pytest.mark.parametrize("first", [MOTORS, WHEELS])
def test_robot_is_commanded_on_one_board_and_measured_by_the_other(first: str) -> None:
    async def test(made: MemoryHub) -> None:
        motors, wheels = await connected(made, first=first)
        await wheels.send(125, odometry(1.5))
        await asyncio.sleep(0.1)
        drive(made)
        await asyncio.sleep(0.1)
        robot = made.robot("r")
        state = robot.state(made.now_s)
        assert [each.name for each in made.hub.robots.here()] == ["r"]
        assert state.odometry is not None
        assert state.odometry.pose is not None
        assert (state.odometry.pose.x_m, state.odometry_topic, state.unreachable) == (1.5, "/odom", None)
        assert velocities(motors)[-1] == (0.25, 0.0)

    in_hub(test, CONFIG)


@pytest.mark.parametrize("first", [MOTORS, WHEELS])
def test_robot_stops_when_its_feedback_board_leaves_and_says_which(first: str) -> None:
    async def test(made: MemoryHub) -> None:
        events: list[RobotEvent] = []
        made.hub.events.observe("test", events.append)
        motors, wheels = await connected(made, first=first)
        program = made.hub.join("program")
        program.drive(made.robot("r"), SLOW)
        await asyncio.sleep(0.1)
        await wheels.aclose()
        await asyncio.sleep(0.2)
        assert velocities(motors)[-1] == (0.0, 0.0)
        missing = f"its device {WHEELS} is not connected"
        assert [each.facts["reason"] for each in events if each.kind is EventKind.STOPPED] == [missing]
        assert made.robot("r").state(made.now_s).unreachable == missing
        assert made.logged("robot.incomplete")[-1]["reason"] == missing
        with pytest.raises(CommandRefused, match=f"r: {missing}"):
            program.drive(made.robot("r"), SLOW)
        program.drive(made.robot("r"), PlanarVelocity())  # a zero is never refused for that
        with pytest.raises(CommandRefused):
            program.drive(made.robot("r"), SLOW)
        again = await made.connect(POSE, address=WHEELS)
        await asyncio.sleep(0.1)
        with pytest.raises(CommandRefused, match="a reconnection of one of its devices"):
            program.drive(made.robot("r"), SLOW)
        program.drive(made.robot("r"), PlanarVelocity())
        program.drive(made.robot("r"), SLOW)
        await again.send(125, odometry(0.5))
        await asyncio.sleep(0.1)
        assert velocities(motors)[-1] == (0.25, 0.0)
        assert made.robot("r").odometry.snapshot(made.now_s) is not None

    in_hub(test, CONFIG)


def test_robot_refuses_while_its_command_board_is_away_and_names_it() -> None:
    async def test(made: MemoryHub) -> None:
        motors, wheels = await connected(made)
        drive(made)
        await asyncio.sleep(0.1)
        await motors.aclose()
        await asyncio.sleep(0.1)
        with pytest.raises(CommandRefused, match=f"its device {MOTORS} is not connected"):
            drive(made)
        again = await made.connect(COMMAND, address=MOTORS)
        await asyncio.sleep(0.1)
        assert set(velocities(again)) == {(0.0, 0.0)}
        await asyncio.sleep(1.0)
        drive(made)
        await wheels.send(125, odometry(2.0))
        await asyncio.sleep(0.1)
        assert velocities(again)[-1] == (0.25, 0.0)
        assert made.robot("r").odometry.count == 1

    in_hub(test, CONFIG)


@pytest.mark.parametrize("first", [MOTORS, WHEELS])
def test_two_boards_that_take_a_velocity_are_refused_until_the_settings_choose(first: str) -> None:
    async def test(made: MemoryHub) -> None:
        motors, wheels = await connected(made, wheels=OTHER_COMMAND, first=first)
        with pytest.raises(CommandRefused, match=r"take a velocity: choose one, with command_device in \[robots.r\]"):
            drive(made)
        made.hub.reconfigure(CHOSEN, places_of(CHOSEN))
        await asyncio.sleep(1.0)
        drive(made)
        await asyncio.sleep(0.1)
        assert velocities(motors)[-1] == (0.25, 0.0)
        assert set(velocities(wheels, 101)) <= {(0.0, 0.0)}
        await wheels.send(125, odometry(2.0))
        await asyncio.sleep(0.1)
        assert made.robot("r").odometry.count == 1

    in_hub(test, CONFIG)


def test_stop_and_lock_cover_the_command_of_the_feedback_board() -> None:
    async def test(made: MemoryHub) -> None:
        _, wheels = await connected(made, wheels=OTHER_COMMAND)
        program = made.hub.join("program")
        twist = struct.pack("<6d", 0.2, 0, 0, 0, 0, 0)
        program.advertise("/other/cmd_vel", "geometry_msgs/Twist")

        async def moved() -> tuple[float, float]:
            with contextlib.suppress(CommandRefused):
                program.publish("/other/cmd_vel", twist)
            await asyncio.sleep(0.1)
            return velocities(wheels, 101)[-1]

        assert await moved() == (0.2, 0.0)
        made.robot("r").stop()
        await asyncio.sleep(0.1)
        assert velocities(wheels, 101)[-1] == (0.0, 0.0)
        await asyncio.sleep(1.0)
        made.robot("r").lock("test")
        assert await moved() == (0.0, 0.0)
        with pytest.raises(CommandRefused, match=r"locked: test; to drive it again: hostlink unlock r$"):
            program.publish("/other/cmd_vel", twist)
        await wheels.aclose()
        wheels = await made.connect(OTHER_COMMAND, address=WHEELS)
        await asyncio.sleep(1.0)
        assert await moved() == (0.0, 0.0)
        made.robot("r").unlock()
        await asyncio.sleep(1.0)
        assert await moved() == (0.2, 0.0)

    in_hub(test, CHOSEN)


def publisher_of(made: MemoryHub, name: str) -> Callable[[], None]:
    """Return what publishes a velocity of 0.2 m/s by this name as one program, and ignores a refusal."""
    program = made.hub.join("program of another topic")
    program.advertise(name, "geometry_msgs/Twist")

    def publish() -> None:
        with contextlib.suppress(CommandRefused):
            program.publish(name, struct.pack("<6d", 0.2, 0, 0, 0, 0, 0))

    return publish


async def publish_for(publish: Callable[[], None], duration_s: float) -> None:
    """Publish ten times a second."""
    for _ in range(round(duration_s / 0.1)):
        publish()
        await asyncio.sleep(0.1)


def test_every_velocity_topic_of_the_robot_stops_when_one_of_its_boards_leaves() -> None:
    async def test(made: MemoryHub) -> None:
        events: list[RobotEvent] = []
        made.hub.events.observe("test", events.append)
        _, wheels = await connected(made, wheels=POSE)
        infos = [
            topic(EndpointKind.SUBSCRIBER, 101, "other/cmd_vel", "geometry_msgs/Twist"),
            topic(EndpointKind.SUBSCRIBER, 102, "other/left_motor", "std_msgs/Int16"),
        ]
        arm = await made.connect(infos, address=ARM)
        await asyncio.sleep(1.0)
        publish = publisher_of(made, "/other/cmd_vel")
        await publish_for(publish, 0.5)
        assert velocities(arm, 101)[-1] == (0.2, 0.0)
        made.hub.join("program").publish("/other/left_motor", struct.pack("<h", 50))
        await wheels.aclose()
        await publish_for(publish, 0.5)
        assert arm.payloads(102)[-2:] == [struct.pack("<h", 50), bytes(2)]  # nothing guards it: it gets a zero
        assert velocities(arm, 101)[-1] == (0.0, 0.0)
        missing = f"robot r: its device {WHEELS} is not connected"
        assert [each.facts["reason"] for each in events if each.kind is EventKind.STOPPED] == [missing]
        refused = [each.facts["reason"] for each in events if each.kind is EventKind.REFUSED]
        assert set(refused) == {f"/other/cmd_vel: {missing}"}
        wheels = await made.connect(POSE, address=WHEELS)
        await publish_for(publish, 1.0)
        assert velocities(arm, 101)[-1] == (0.0, 0.0)  # its source has not let go
        await asyncio.sleep(1.0)
        await publish_for(publish, 0.5)
        assert velocities(arm, 101)[-1] == (0.2, 0.0)

    in_hub(test, THREE)


@pytest.mark.parametrize("has_robot_been", [False, True])
def test_board_of_a_robot_obeys_no_velocity_before_the_other_boards_are_there(has_robot_been: bool) -> None:
    async def test(made: MemoryHub) -> None:
        if has_robot_been:
            motors, wheels = await connected(made, wheels=OTHER_COMMAND)
            await motors.aclose()
        else:
            wheels = await made.connect(OTHER_COMMAND, address=WHEELS)
        await asyncio.sleep(1.0)
        publish = publisher_of(made, "/other/cmd_vel")
        await publish_for(publish, 0.5)
        assert set(velocities(wheels, 101)) == {(0.0, 0.0)}
        await made.connect(COMMAND, address=MOTORS)
        await publish_for(publish, 1.0)
        assert set(velocities(wheels, 101)) == {(0.0, 0.0)}
        await asyncio.sleep(1.0)
        await publish_for(publish, 0.5)
        assert velocities(wheels, 101)[-1] == (0.2, 0.0)

    in_hub(test, CHOSEN)


def test_reload_that_makes_one_robot_of_two_leaves_neither_a_robot_by_itself() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect(OTHER_COMMAND, address=WHEELS)  # before the one that has the robot's name
        await made.connect([topic(EndpointKind.SUBSCRIBER, 100, "r/cmd_vel", "geometry_msgs/Twist")], address=MOTORS)
        await asyncio.sleep(1.0)
        assert {each.name for each in made.hub.robots.here()} == {"r", "other"}
        made.hub.reconfigure(CONFIG, places_of(CONFIG))
        await asyncio.sleep(1.0)
        assert [each.name for each in made.hub.robots.here() if each.connection is not None] == ["r"]
        with pytest.raises(CommandRefused, match="take a velocity: choose one"):
            drive(made)

    in_hub(test)


def test_reload_that_takes_a_board_away_leaves_the_other_a_robot_by_itself() -> None:
    async def test(made: MemoryHub) -> None:
        motors, _ = await connected(made)
        alone = Config(robots={"r": RobotConfig(address=MOTORS)})
        made.hub.reconfigure(alone, places_of(alone))
        await asyncio.sleep(1.0)
        drive(made)
        await asyncio.sleep(0.1)
        assert velocities(motors)[-1] == (0.25, 0.0)
        made.hub.reconfigure(CONFIG, places_of(CONFIG))
        await asyncio.sleep(1.0)
        drive(made)
        await asyncio.sleep(0.1)
        assert velocities(motors)[-1] == (0.25, 0.0)
        assert made.robot("r").parts

    in_hub(test, CONFIG)


@pytest.mark.parametrize("is_command_away", [False, True])
def test_topic_that_nothing_guards_is_refused_while_a_board_is_missing_and_its_zero_is_not(
    *, is_command_away: bool
) -> None:
    number = struct.pack("<h", 77)
    infos = [
        topic(EndpointKind.SUBSCRIBER, 102, "left_motor", "std_msgs/Int16"),
        topic(EndpointKind.SUBSCRIBER, 103, "motor_word", "std_msgs/String"),
        topic(EndpointKind.SUBSCRIBER, 104, "gripper_speed", "std_msgs/Int16"),
    ]

    async def test(made: MemoryHub) -> None:
        program = made.hub.join("program")

        async def refused(name: str, payload: bytes) -> str:
            reason = ""
            try:
                program.publish(name, payload)
            except CommandRefused as error:
                reason = f"{error.kind}: {error}"
            await asyncio.sleep(0.1)
            return reason

        motors, wheels = await connected(made)
        arm = await made.connect(infos, address=ARM)
        await asyncio.sleep(1.0)
        assert await refused("/left_motor", number) == ""
        away = MOTORS if is_command_away else WHEELS
        await (motors if is_command_away else wheels).aclose()
        await asyncio.sleep(0.1)
        why = f"not_connected: /left_motor: robot r: its device {away} is not connected"
        assert [await refused("/left_motor", number) for _ in range(3)] == [why] * 3
        assert await refused("/left_motor", bytes(2)) == ""
        assert set(arm.payloads(102)[1:]) == {bytes(2)}
        # Nothing stops these but their own source.
        assert await refused("/motor_word", struct.pack("<I4s", 4, b"stop")) == ""
        assert await refused("/gripper_speed", number) == ""
        await arm.aclose()
        arm = await made.connect(infos, address=ARM)
        assert arm.payloads(102) == [bytes(2)]  # it may still obey an old message
        assert await refused("/left_motor", number) == why
        await made.connect(COMMAND if is_command_away else POSE, address=away)
        assert await refused("/left_motor", number) == ""
        assert arm.payloads(102)[-1] == number

    robot = RobotConfig(devices=(MOTORS, WHEELS, ARM), locked_topics=("gripper_speed",))
    in_hub(test, Config(robots={"r": robot}))


# -- two boards for one place -----------------------------------------------------------------------------------------

NAMED = Config(robots={"r": RobotConfig(devices=("base", "enc"))})
BASE = [topic(EndpointKind.SUBSCRIBER, 100, "base/cmd_vel", "geometry_msgs/Twist")]
ENC = [topic(EndpointKind.PUBLISHER, 125, "enc/odom", "geometry_msgs/Pose2D")]
RIVAL = "10.0.0.9"


def position(made: MemoryHub) -> float:
    pose = made.robot("r").state(made.now_s).odometry
    assert pose is not None
    assert pose.pose is not None
    return pose.pose.x_m


def test_rival_of_a_feedback_board_tells_nothing_and_does_not_replace_it_while_the_robot_is_driven() -> None:
    async def test(made: MemoryHub) -> None:
        motors = await made.connect(BASE, address=MOTORS)
        wheels = await made.connect(ENC, address=WHEELS)
        await asyncio.sleep(1.0)
        await wheels.send(125, odometry(1.0))
        rival = await made.connect(ENC, address=RIVAL)
        twice = made.logged("robot.device_twice")
        assert [(each["robot"], each["device"], each["peer"]) for each in twice] == [("r", "enc", RIVAL)]
        drive(made)
        await rival.send(125, odometry(7.0))
        await wheels.send(125, odometry(1.25))
        await asyncio.sleep(0.1)
        assert (velocities(motors)[-1], position(made)) == ((0.25, 0.0), 1.25)
        program = made.hub.join("program")
        await asyncio.sleep(1.0)
        program.drive(made.robot("r"), SLOW)
        await wheels.aclose()
        await rival.send(125, odometry(9.0))
        await asyncio.sleep(0.2)
        assert (velocities(motors)[-1], position(made)) == ((0.0, 0.0), 1.25)
        with pytest.raises(CommandRefused, match="r: its device enc is not connected"):
            program.drive(made.robot("r"), SLOW)
        again = await made.connect(ENC, address=WHEELS)  # within three seconds: it has its place again
        await asyncio.sleep(5.0)
        await again.send(125, odometry(2.0))
        await rival.send(125, odometry(9.0))
        await asyncio.sleep(0.1)
        assert position(made) == 2.0
        assert not made.logged("robot.device_replaced")

    in_hub(test, NAMED)


def test_rival_takes_the_place_of_a_board_that_left_when_the_robot_has_stopped() -> None:
    limited = RobotConfig(devices=("base", "enc"), max_linear_deceleration_m_s2=0.05)

    async def test(made: MemoryHub) -> None:
        motors = await made.connect(BASE, address=MOTORS)
        wheels = await made.connect(ENC, address=WHEELS)
        rival = await made.connect(ENC, address=RIVAL)
        await asyncio.sleep(1.0)
        drive(made)
        await asyncio.sleep(0.1)
        await wheels.aclose()
        await asyncio.sleep(4.0)
        assert velocities(motors)[-1][0] > 0.0  # slows down for 5 s
        assert not made.logged("robot.device_replaced")
        await asyncio.sleep(2.0)
        assert velocities(motors)[-1] == (0.0, 0.0)
        replaced = made.logged("robot.device_replaced")
        assert [(each["robot"], each["device"], each["peer"]) for each in replaced] == [("r", "enc", RIVAL)]
        await rival.send(125, odometry(3.0))
        drive(made)
        await asyncio.sleep(0.1)
        assert (velocities(motors)[-1], position(made)) == ((0.25, 0.0), 3.0)

    in_hub(test, Config(robots={"r": limited}))


def test_rival_of_the_command_board_is_not_driven_and_locks_and_reloads_leave_it_so() -> None:
    async def test(made: MemoryHub) -> None:
        motors = await made.connect(BASE, address=MOTORS)
        await made.connect(ENC, address=WHEELS)
        rival = await made.connect(BASE, address=RIVAL)
        await asyncio.sleep(1.0)
        publish = publisher_of(made, "/base/cmd_vel")
        drive(made)
        await publish_for(publish, 0.3)
        assert velocities(motors)[-1] == (0.25, 0.0)
        assert set(velocities(rival)) == {(0.0, 0.0)}
        assert [each.name for each in made.hub.robots.here()] == ["r"]
        await asyncio.sleep(1.0)
        changed = Config(robots={"r": RobotConfig(devices=("base", "enc"), not_commands=("x",))})
        made.hub.reconfigure(changed, places_of(changed))
        await asyncio.sleep(1.0)
        drive(made)
        await publish_for(publish, 0.3)
        assert velocities(motors)[-1] == (0.25, 0.0)
        made.robot("r").lock("test")
        count = len(velocities(rival))
        await asyncio.sleep(0.2)
        assert len(velocities(rival)) > count  # the zeros of the lock
        await motors.aclose()
        await asyncio.sleep(5.0)
        made.robot("r").unlock()
        await asyncio.sleep(1.0)
        drive(made)
        await asyncio.sleep(0.1)
        assert velocities(rival)[-1] == (0.25, 0.0)

    in_hub(test, NAMED)


# -- a stop and a lock before all boards have connected ---------------------------------------------------------------

ARM_COMMANDS = [
    topic(EndpointKind.SUBSCRIBER, 101, "arm/cmd_vel", "geometry_msgs/Twist"),
    topic(EndpointKind.SUBSCRIBER, 102, "left_motor", "std_msgs/Int16"),
]


def test_stop_of_a_robot_of_the_settings_reaches_the_board_that_is_connected_and_names_the_other() -> None:
    async def test(made: MemoryHub) -> None:
        arm = await made.connect(ARM_COMMANDS, address=WHEELS)
        await asyncio.sleep(1.0)
        arm.heard.clear()
        robot = made.hub.robots.find_to_stop("r")
        robot.stop()
        await asyncio.sleep(0.1)
        assert velocities(arm, 101)[-1] == (0.0, 0.0)
        assert arm.payloads(102) == [bytes(2)]
        assert robot.why_unknown() == f"its device {MOTORS} is not connected"
        assert robot.state(made.now_s).link is None

    in_hub(test, CHOSEN)


@pytest.mark.parametrize("is_part_connected", [False, True])
def test_lock_of_a_robot_of_the_settings_holds_for_boards_that_connect_later(*, is_part_connected: bool) -> None:
    async def test(made: MemoryHub) -> None:
        if is_part_connected:
            arm = await made.connect(ARM_COMMANDS, address=WHEELS)
            await asyncio.sleep(1.0)
        made.hub.robots.find_to_stop("r").lock("test")
        if not is_part_connected:
            arm = await made.connect(ARM_COMMANDS, address=WHEELS)
        motors = await made.connect(COMMAND, address=MOTORS)
        await asyncio.sleep(1.0)
        publish = publisher_of(made, "/arm/cmd_vel")
        await publish_for(publish, 0.3)
        with pytest.raises(CommandRefused, match="locked: test"):
            drive(made)
        with pytest.raises(CommandRefused, match="locked: test"):
            made.hub.join("program").publish("/left_motor", struct.pack("<h", 5))
        await asyncio.sleep(0.1)
        assert {*velocities(motors), *velocities(arm, 101)} == {(0.0, 0.0)}
        assert set(arm.payloads(102)) == {bytes(2)}
        made.robot("r").unlock()
        await asyncio.sleep(1.0)
        drive(made)
        await publish_for(publish, 0.3)
        assert (velocities(motors)[-1], velocities(arm, 101)[-1]) == ((0.25, 0.0), (0.2, 0.0))

    in_hub(test, CHOSEN)


def test_stream_to_a_robot_that_is_stopped_before_its_first_connection_does_not_move_it() -> None:
    alone = Config(robots={"r": RobotConfig(address=MOTORS)})

    async def test(made: MemoryHub) -> None:
        program = made.hub.join("program")
        robot = made.hub.robots.find_to_stop("r")
        motors = None
        for count in range(20):
            with contextlib.suppress(CommandRefused):
                program.drive(robot, SLOW)
            await asyncio.sleep(0.1)
            if count == 5:
                motors = await made.connect(COMMAND, address=MOTORS)
        assert motors is not None
        assert made.hub.robots.find("r") is robot
        assert set(velocities(motors)) == {(0.0, 0.0)}
        await asyncio.sleep(1.0)
        program.drive(robot, SLOW)
        await asyncio.sleep(0.1)
        assert velocities(motors)[-1] == (0.25, 0.0)
        assert robot.state(made.now_s).velocity_topic == "/r/cmd_vel"

    in_hub(test, alone)


def test_stop_of_a_name_that_the_settings_lack_is_refused() -> None:
    async def test(made: MemoryHub) -> None:
        with pytest.raises(UnknownTopic):
            made.hub.robots.find_to_stop("s")
        assert not made.hub.robots.here()

    in_hub(test, CHOSEN)


def test_robot_whose_wheels_are_on_two_boards_says_so_of_both() -> None:
    wheels = WheelsConfig(topics=("left_motor", "right_motor"), unit="m_s")
    robot = RobotConfig(devices=(MOTORS, WHEELS), wheels=wheels, wheel_separation_m=0.2)

    async def test(made: MemoryHub) -> None:
        for number, (name, address) in enumerate((("left_motor", MOTORS), ("right_motor", WHEELS))):
            await made.connect(
                [topic(EndpointKind.SUBSCRIBER, 100 + number, name, "std_msgs/Float32")], address=address
            )
        why = (
            "its command topics must be on one device, and they are on several: "
            f"left_motor on {MOTORS}, right_motor on {WHEELS}"
        )
        views = Devices(made.hub).all()["devices"]
        assert [(each["part_of"], each["refused"]) for each in views] == [("r", why)] * 2
        assert all("takes its velocities on another device" not in line for line in explanation(views))
        noted = [each.diagnosis.noted["settings_refused"] for each in made.hub.robots.devices.values()]
        assert noted == [why] * 2
        robot = made.hub.robots.find_to_stop("r")
        robot.lock("test")
        assert robot.why_unknown() == why
        robot.unlock()
        with pytest.raises(CommandRefused, match="its command topics must be on one device"):
            drive(made)

    in_hub(test, Config(robots={"r": robot}))


def test_reload_of_another_setting_interrupts_no_robot_whose_boards_are_given_by_names() -> None:
    async def test(made: MemoryHub) -> None:
        motors = await made.connect(BASE, address=MOTORS)
        await made.connect(ENC, address=WHEELS)
        await asyncio.sleep(1.0)
        program = made.hub.join("program")
        program.drive(made.robot("r"), SLOW)
        slower = Config(robots={"r": RobotConfig(devices=("base", "enc"), max_linear_m_s=0.1)})
        assert made.hub.reconfigure(slower, places_of(slower)) == {}
        program.drive(made.robot("r"), SLOW)
        await asyncio.sleep(0.1)
        assert velocities(motors)[-1] == (0.1, 0.0)

    in_hub(test, NAMED)
