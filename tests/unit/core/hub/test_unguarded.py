"""Endpoints that look like commands of motion and that nothing guards: what stop and lock make of them."""

import asyncio
import struct
from collections.abc import Callable

import pytest

from hostlink.core.config import Config, RobotConfig, WheelsConfig
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.robot.velocity import TWIST_TYPE
from hostlink.errors import CommandRefused, FrameTooLarge, RefusalKind
from tests.support.fake_device import robot_topics, topic
from tests.support.memory_hub import SETTLED_S, MemoryHub, in_hub
from tests.support.participants import publish

LEFT, TWIST = 110, 111  # ids of the board's topics
NUMBER, ZERO = struct.pack("<h", 50), bytes(2)


def board(name: str = "/left_motor", type_name: str = "std_msgs/Int16") -> list[DeviceEndpoint]:
    """Topics of a board whose motor takes numbers, which no rule makes a robot."""
    return [topic(EndpointKind.SUBSCRIBER, LEFT, name, type_name)]


async def send(made: MemoryHub, name: str, type_name: str, payload: bytes) -> None:
    publish(made.hub, name, payload, type_name=type_name)
    await asyncio.sleep(SETTLED_S)


def test_stop_of_all_sends_zero_to_an_unguarded_endpoint_and_names_it() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board())
        await send(made, "/left_motor", "std_msgs/Int16", NUMBER)
        (stopped,) = made.hub.robots.stop_all()
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(LEFT) == [NUMBER, ZERO]
        assert (stopped.topic, stopped.reason, stopped.is_guarded, stopped.is_locked) == (
            "/left_motor", "", False, False,
        )  # fmt: skip
        await send(made, "/left_motor", "std_msgs/Int16", NUMBER)
        assert device.payloads(LEFT)[-1] == NUMBER

    in_hub(test)


@pytest.mark.parametrize("type_name", ["std_msgs/Int16MultiArray", "std_msgs/String", "sensor_msgs/Joy"])
def test_endpoint_without_a_zero_is_named_and_refuses_under_a_lock(type_name: str) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board("/motor_command", type_name))
        (stopped,) = made.hub.robots.stop_all()
        assert stopped.reason == f"{type_name} has no value that surely means stop"
        (locked,) = made.hub.robots.lock_all("a foot")
        assert (locked.is_locked, locked.reason) == (True, stopped.reason)
        with pytest.raises(CommandRefused, match="locked: a foot; to drive it again: hostlink unlock --all"):
            publish(made.hub, "/motor_command", {}, type_name=type_name)
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(LEFT) == []

    in_hub(test)


def test_lock_of_all_holds_for_a_robot_and_for_a_board_without_one() -> None:
    async def test(made: MemoryHub) -> None:
        robot, device = await made.connect(), await made.connect(board(), address="10.0.0.3")
        (locked,) = made.hub.robots.lock_all("a foot", by="ann")
        await asyncio.sleep(SETTLED_S)
        assert (locked.topic, locked.is_locked, locked.reason, locked.robot) == ("/left_motor", True, "", None)
        assert made.robot().gate.lock_reason == "a foot"
        assert (robot.payloads(100)[-1], device.payloads(LEFT)) == (bytes(48), [ZERO])
        with pytest.raises(CommandRefused) as refused:
            publish(made.hub, "/left_motor", NUMBER, type_name="std_msgs/Int16")
        assert (refused.value.kind, refused.value.by) == (RefusalKind.LOCKED, "ann")
        assert str(refused.value) == "/left_motor: locked: a foot; to drive it again: hostlink unlock --all"
        made.hub.robots.unlock_all()
        await send(made, "/left_motor", "std_msgs/Int16", NUMBER)
        assert device.payloads(LEFT) == [ZERO, NUMBER]
        assert made.robot().gate.lock_reason is None

    in_hub(test)


@pytest.mark.parametrize("address", ["10.0.0.2", "10.0.0.3"])  # of the board that commands the robot, or of another
def test_lock_and_stop_send_one_zero_to_an_unguarded_endpoint_of_a_robot(address: str) -> None:
    async def test(made: MemoryHub) -> None:
        velocity = topic(EndpointKind.SUBSCRIBER, TWIST, "/cmd_vel", TWIST_TYPE)
        boards = {each: [velocity] if each == "10.0.0.2" else [] for each in ("10.0.0.2", "10.0.0.3")}
        boards[address] += board()
        devices = {each: await made.connect(infos, address=each) for each, infos in boards.items()}
        for act in (lambda: made.hub.robots.lock_all("a foot"), made.hub.robots.stop_all, made.robot("r").lock):
            await asyncio.sleep(SETTLED_S)
            devices[address].heard.clear()
            replaced = devices[address].link.session.outbox.replaced
            act()
            await asyncio.sleep(SETTLED_S)
            assert devices[address].payloads(LEFT) == [ZERO]
            assert devices[address].link.session.outbox.replaced == replaced  # no zero replaced a first one

    in_hub(test, Config(robots={"r": RobotConfig(devices=("10.0.0.2", "10.0.0.3"))}))


def test_lock_of_all_survives_a_reconnection_and_holds_for_what_connects_later() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board())
        made.hub.robots.lock_all("a foot")
        await device.aclose()
        await asyncio.sleep(SETTLED_S)
        again = await made.connect(board())
        assert again.payloads(LEFT) == [ZERO]
        with pytest.raises(CommandRefused, match="locked: a foot"):
            publish(made.hub, "/left_motor", NUMBER, type_name="std_msgs/Int16")
        await made.connect(address="10.0.0.3")
        assert made.robot().gate.lock_reason == "a foot"

    in_hub(test)


def test_stop_of_a_robot_sends_zero_to_what_else_its_board_takes_and_to_no_other_board() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect([*robot_topics(), *board()])
        other = await made.connect(board("/right_motor"), address="10.0.0.3")
        for name in ("/left_motor", "/right_motor"):
            await send(made, name, "std_msgs/Int16", NUMBER)
        made.robot().stop()
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(LEFT) == [NUMBER, ZERO]
        assert other.payloads(LEFT) == [NUMBER]
        assert [each.topic for each in made.robot().unguarded_endpoints] == ["/left_motor"]

    in_hub(test)


@pytest.mark.parametrize("stop", [LocalRobot.stop, LocalRobot.lock])
def test_zero_of_a_robot_that_does_not_fit_keeps_no_zero_from_the_rest_of_its_board(
    stop: Callable[[LocalRobot], None],
) -> None:
    async def test(made: MemoryHub) -> None:
        velocity = topic(EndpointKind.SUBSCRIBER, TWIST, "/robot_0/cmd_vel", TWIST_TYPE, buffer_bytes=16)
        device = await made.connect([velocity, *board()])
        await send(made, "/left_motor", "std_msgs/Int16", NUMBER)
        with pytest.raises(FrameTooLarge):
            stop(made.robot())
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(LEFT) == [NUMBER, ZERO]

    in_hub(test)


def test_lock_of_a_robot_refuses_what_else_its_board_takes() -> None:
    async def test(made: MemoryHub) -> None:
        gripper = topic(EndpointKind.SUBSCRIBER, TWIST, "/gripper_angle", "std_msgs/Int16")
        lamp = topic(EndpointKind.SUBSCRIBER, TWIST + 1, "/lamp", "std_msgs/Int16")
        device = await made.connect([*robot_topics(), *board(), gripper, lamp])
        made.robot().lock("a foot")
        for name in ("/left_motor", "/gripper_angle"):
            with pytest.raises(CommandRefused, match=f"{name}: locked: a foot; to drive it again: hostlink unlock rob"):
                publish(made.hub, name, NUMBER, type_name="std_msgs/Int16")
        await send(made, "/lamp", "std_msgs/Int16", NUMBER)
        assert device.payloads(LEFT) == [ZERO]
        assert device.payloads(TWIST) == []  # a zero could move a servo
        assert device.payloads(TWIST + 1) == [NUMBER]
        made.robot().unlock()
        await send(made, "/gripper_angle", "std_msgs/Int16", NUMBER)
        assert device.payloads(TWIST) == [NUMBER]

    in_hub(test, Config(robots={"robot_0": RobotConfig(locked_topics=("/gripper_angle",))}))


def test_zero_is_sent_instead_of_older_commands_that_wait() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(board())
        for number in range(8):  # in one turn of the loop
            publish(made.hub, "/left_motor", struct.pack("<h", number + 1), type_name="std_msgs/Int16")
        made.hub.robots.stop_all()
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(LEFT)[-1] == ZERO

    in_hub(test)


def test_lock_of_all_covers_six_numbers_of_a_device_that_is_not_a_robot() -> None:
    config = Config(robots={"drone": RobotConfig(command_topic="/thrusters", kinematics="spatial")})

    async def test(made: MemoryHub) -> None:
        device = await made.connect([topic(EndpointKind.SUBSCRIBER, TWIST, "/thrusters", "geometry_msgs/Twist")])
        climb = struct.pack("<6d", 0, 0, 0.5, 0, 0, 0)
        await send(made, "/thrusters", "geometry_msgs/Twist", climb)
        assert device.payloads(TWIST)[-1] == climb
        (locked,) = made.hub.robots.lock_all("a foot")
        await asyncio.sleep(SETTLED_S)
        assert (locked.topic, locked.is_guarded, locked.is_locked, locked.reason) == ("/thrusters", True, True, "")
        assert device.payloads(TWIST)[-1] == bytes(48)
        with pytest.raises(CommandRefused, match="to drive it again: hostlink unlock --all"):
            publish(made.hub, "/thrusters", climb, type_name="geometry_msgs/Twist")
        await device.aclose()
        await asyncio.sleep(SETTLED_S)
        await made.connect([topic(EndpointKind.SUBSCRIBER, TWIST, "/thrusters", "geometry_msgs/Twist")])
        with pytest.raises(CommandRefused, match="locked: a foot"):
            publish(made.hub, "/thrusters", climb, type_name="geometry_msgs/Twist")

    in_hub(test, config)


def test_settings_that_do_not_fit_leave_the_wheels_unguarded_and_named() -> None:
    wheels = WheelsConfig(topics=("/left_motor",), unit="rad_s")  # which needs a wheel radius

    async def test(made: MemoryHub) -> None:
        await made.connect(board())
        assert made.logged("robot.settings_refused")
        assert [each.topic for each in made.hub.robots.stop_all()] == ["/left_motor"]

    in_hub(test, Config(robots={"car": RobotConfig(wheels=wheels)}))


@pytest.mark.parametrize(
    ("name", "config", "is_sent"),
    [
        ("/left_motor", Config(), False),
        ("/left_motor", Config(robots={"r": RobotConfig(address="10.0.0.2", not_commands=("left_motor",))}), True),
        ("/lifter", Config(robots={"r": RobotConfig(address="10.0.0.2", locked_topics=("lifter",))}), False),
        ("/lifter", Config(), True),
        ("/big_wheel/lamp", Config(), True),  # of a robot that is named big_wheel
    ],
)
def test_latched_message_is_not_sent_again_where_it_may_move_something(
    name: str, config: Config, *, is_sent: bool
) -> None:
    async def test(made: MemoryHub) -> None:
        source = made.hub.join("program")
        source.advertise(name, "std_msgs/Int16", is_latched=True)
        infos = [*board(name), topic(EndpointKind.SUBSCRIBER, TWIST, "/big_wheel/cmd_vel", TWIST_TYPE)]
        device = await made.connect(infos if "wheel" in name else board(name))
        source.publish(name, NUMBER)
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(LEFT) == [NUMBER]
        made.hub.robots.stop_all()
        device.heard.clear()
        await device.announce()
        await device.announce()
        await asyncio.sleep(SETTLED_S)
        await device.aclose()
        again = await made.connect(device.infos)
        assert (NUMBER in device.payloads(LEFT), NUMBER in again.payloads(LEFT)) == (is_sent, is_sent)

    in_hub(test, config)


def test_zero_is_repeated_under_a_lock_and_not_after_it() -> None:
    """A datagram with the first one may be lost."""

    async def test(made: MemoryHub) -> None:
        device = await made.connect(board())
        made.hub.robots.lock_all("a foot")
        await asyncio.sleep(2.2)
        assert device.payloads(LEFT) == 5 * [ZERO]  # at once, and every 0.5 s
        made.hub.robots.unlock_all()
        await asyncio.sleep(2.2)
        await send(made, "/left_motor", "std_msgs/Int16", NUMBER)
        assert device.payloads(LEFT) == [*(5 * [ZERO]), NUMBER]

    in_hub(test)
