"""Wrong settings of a board that is a robot by itself: they never take its name, limits, stop and lock away."""

import asyncio
import re
import struct

import pytest

from hostlink.core.config import (
    Config,
    EncodersConfig,
    FeedbackConfig,
    JoyConfig,
    RobotConfig,
    WheelsConfig,
    WordsConfig,
)
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.robot.velocity import TWIST_TYPE
from hostlink.errors import CommandRefused
from tests.support.fake_device import service_server, topic
from tests.support.memory_hub import SETTLED_S, MemoryHub, in_hub
from tests.support.participants import publish

TWIST, HOME = 100, "10.0.0.2"
FAST = struct.pack("<6d", 50, 0, 0, 0, 0, 0)
JOY, FLOAT, INT, TEXT = "sensor_msgs/Joy", "std_msgs/Float32", "std_msgs/Int32", "std_msgs/String"


def to(number: int, name: str, type_name: str = TWIST_TYPE, buffer_bytes: int = 512) -> DeviceEndpoint:
    return topic(EndpointKind.SUBSCRIBER, TWIST + number, name, type_name, buffer_bytes=buffer_bytes)


def sent(number: int, name: str, type_name: str = INT) -> DeviceEndpoint:
    return topic(EndpointKind.PUBLISHER, 125 + number, name, type_name)


def slow(**settings: object) -> RobotConfig:
    """Settings of a robot at HOME that must not be faster than 0.2 m/s."""
    return RobotConfig(address=HOME, max_linear_m_s=0.2, **settings)


def words(topic_name: str = "c", stop: str = "S") -> WordsConfig:
    return WordsConfig(topic=topic_name, forward="F", backward="B", left="L", right="R", stop=stop)


WHEELS = {"kinematics": "differential", "wheel_separation_m": 0.2}
ENCODERS = EncodersConfig(
    topics=("lt", "rt"), wheels=("front_left", "right"), unit="ticks", ticks_per_turn=1000, wheel_radius_m=0.05
)
WRONG = {
    "typo": (slow(command_topic="cmd_vle"), [], "command_topic names cmd_vle, .* \\(did you mean cmd_vel\\?\\)"),
    "wheels": (
        slow(**WHEELS, wheels=WheelsConfig(topics=("l", "rr"))),
        [to(1, "l", FLOAT), to(2, "r", FLOAT)],
        "wheels.topics names rr, which the board does not announce \\(did you mean r\\?\\)",
    ),
    "joy": (slow(joy=JoyConfig(topic="jjoy")), [to(1, "joy", JOY)], "joy.topic names jjoy, .*mean joy"),
    "type of a wheel": (
        slow(**WHEELS, wheels=WheelsConfig(topics=("l", "r"))),
        [to(1, "l", FLOAT), to(2, "r", TEXT)],
        "std_msgs/String is not a number",
    ),
    "type of words": (slow(words=words()), [to(1, "c", "std_msgs/Int16")], "'F' is not a value of std_msgs/Int16"),
    "encoders": (slow(**WHEELS, encoders=ENCODERS), [sent(0, "lt"), sent(1, "rt")], "not a wheel of this drive"),
}


@pytest.mark.parametrize(("config", "others", "problem"), WRONG.values(), ids=WRONG)
def test_board_that_is_a_robot_by_itself_is_one_with_its_name_and_limits(
    config: RobotConfig, others: list[DeviceEndpoint], problem: str
) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect([to(0, "cmd_vel"), *others])
        robot = made.robot("slow")
        assert robot.shown.velocity == "/slow/cmd_vel"  # two such boards share no topic
        publish(made.hub, robot.shown.velocity, FAST, type_name=TWIST_TYPE)
        await asyncio.sleep(SETTLED_S)
        heard = [struct.unpack("<6d", payload)[0] for payload in device.payloads(TWIST)]
        assert max(heard) == pytest.approx(0.2)
        robot.lock("a foot")
        with pytest.raises(CommandRefused, match="locked: a foot"):
            publish(made.hub, robot.shown.velocity, FAST, type_name=TWIST_TYPE)
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(TWIST)[-1] == bytes(48)
        (refused,) = made.logged("robot.settings_refused")
        assert refused["robot"] == "slow"
        (number,) = made.hub.robots.devices
        noted = made.hub.robots.devices[number].diagnosis.noted["settings_refused"]
        assert re.search(problem, noted), noted

    in_hub(test, Config(robots={"slow": config}))


@pytest.mark.parametrize(
    ("config", "infos"),
    [
        (slow(command_topic="/drive_it"), [to(0, "drive_it")]),
        (slow(command_topic="drive_it"), [to(0, "/drive_it")]),
        (slow(**WHEELS, wheels=WheelsConfig(topics=("/l", "r"))), [to(0, "l", FLOAT), to(1, "/r", FLOAT)]),
        (slow(words=words("/c")), [to(0, "c", TEXT)]),
    ],
)
def test_names_of_topics_fit_with_or_without_a_slash_in_front(config: RobotConfig, infos: list[DeviceEndpoint]) -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect(infos)
        robot = made.robot("slow")
        assert [topic.name for topic in robot.topics.commands] == [info.name for info in infos]
        assert not made.logged("robot.settings_refused")

    in_hub(test, Config(robots={"slow": config}))


def test_lock_refuses_a_topic_that_the_settings_name_with_a_slash_and_a_topic_may_command_nothing() -> None:
    config = slow(locked_topics=("/gripper",), not_commands=("/arm/cmd_vel",))

    async def test(made: MemoryHub) -> None:
        await made.connect([to(0, "cmd_vel"), to(1, "gripper", "std_msgs/Int16"), to(2, "arm/cmd_vel")])
        robot = made.robot("slow")
        assert len(robot.beside) == 1
        robot.lock("a foot")
        with pytest.raises(CommandRefused, match="locked: a foot"):
            publish(made.hub, "/slow/gripper", bytes(2), type_name="std_msgs/Int16")

    in_hub(test, Config(robots={"slow": config}))


@pytest.mark.parametrize(
    ("config", "problem"),
    [
        (
            slow(locked_topics=("grippper",)),
            "locked_topics names grippper, which the board does not announce (did you mean gripper?)",
        ),
        (
            slow(not_commands=("arm/cmdvel",)),
            "not_commands names arm/cmdvel, which the board does not announce (did you mean arm/cmd_vel?)",
        ),
        (
            slow(feedback=FeedbackConfig(topic="ododm")),
            "feedback.topic names ododm, which the board does not announce (did you mean odom?)",
        ),
        (
            slow(stop_service="halt_it"),
            "stop_service names halt_it, which the board does not announce (did you mean halt?)",
        ),
        (
            RobotConfig(devices=(HOME,), command_topic="cmd_vle"),
            "command_topic names cmd_vle, which none of its boards announces (did you mean cmd_vel?); its topics are "
            "cmd_vel (geometry_msgs/Twist), gripper (std_msgs/Int16), arm/cmd_vel (geometry_msgs/Twist)",
        ),
        (slow(locked_topics=("/gripper",), not_commands=("/arm/cmd_vel",), stop_service="/halt"), None),
        (RobotConfig(devices=(HOME, "10.0.0.3"), locked_topics=("lamp",)), None),  # the other board may have it
    ],
)
def test_name_in_the_settings_that_no_board_of_the_robot_announces_is_a_finding(
    config: RobotConfig, problem: str | None
) -> None:
    infos = [to(0, "cmd_vel"), to(1, "gripper", "std_msgs/Int16"), to(2, "arm/cmd_vel")]
    infos += [sent(0, "odom", "nav_msgs/Odometry"), *service_server("halt", "std_srvs/Empty", 126, 110)]

    async def test(made: MemoryHub) -> None:
        await made.connect(infos)
        (device,) = made.hub.robots.devices.values()
        assert device.diagnosis.noted.get("settings_refused") == problem
        assert len(made.logged("robot.settings_refused")) == (problem is not None)

    in_hub(test, Config(robots={"slow": config}))


@pytest.mark.parametrize(
    ("config", "type_name"),
    [(slow(words=words(stop="S" * 600)), TEXT), (slow(joy=JoyConfig(topic="c", axes=63, buttons=63)), JOY)],
)
def test_command_whose_stop_does_not_fit_the_board_drives_nothing_and_is_named(
    config: RobotConfig, type_name: str
) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect([to(0, "c", type_name)])
        assert made.hub.robots.here() == []
        (refused,) = made.logged("robot.settings_refused")
        assert re.search(
            r"what stops it does not fit the board: c: frame of \d+ bytes, the device takes 512", refused["reason"]
        )
        await device.aclose()
        await asyncio.sleep(SETTLED_S)
        by_itself = await made.connect([to(0, "c", type_name), to(1, "cmd_vel")])
        robot = made.robot("slow")
        publish(made.hub, robot.shown.velocity, FAST, type_name=TWIST_TYPE)
        await asyncio.sleep(SETTLED_S)
        assert max(struct.unpack("<6d", each)[0] for each in by_itself.payloads(TWIST + 1)) == pytest.approx(0.2)
        assert by_itself.payloads(TWIST) == []

    in_hub(test, Config(robots={"slow": config}))


@pytest.mark.parametrize(
    ("wheels", "type_name"),
    [
        (WheelsConfig(topics=("l", "r"), unit="pwm", full=500, rest=1500), "std_msgs/UInt8"),
        (WheelsConfig(topics=("l", "r"), unit="pwm", full=255), "std_msgs/Int8"),
        (WheelsConfig(topics=("l", "r"), unit="m_s"), "std_msgs/Int16"),
    ],
)
def test_wheels_whose_type_cannot_hold_the_numbers_are_sent_none(wheels: WheelsConfig, type_name: str) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect([to(0, "l", type_name), to(1, "r", type_name)])
        await asyncio.sleep(1.0)
        assert (made.hub.robots.here(), device.payloads(TWIST), device.payloads(TWIST + 1)) == ([], [], [])
        (refused,) = made.logged("robot.settings_refused")
        assert refused["robot"] == "slow"

    in_hub(test, Config(robots={"slow": slow(**WHEELS, wheels=wheels)}))


def test_suggestion_is_for_the_table_that_has_the_address_of_the_board() -> None:
    async def test(made: MemoryHub) -> None:
        await made.connect([to(0, "left_motor", "std_msgs/Int16"), to(1, "right_motor", "std_msgs/Int16")])
        await made.connect([to(0, "motor", "std_msgs/Int16")], address="10.0.0.3")
        await made.connect([to(0, "motor", "std_msgs/Int16")], address="10.0.0.4")
        first, second, third = made.hub.robots.devices.values()
        assert first.suggestion == '[robots.slow.wheels]\ntopics = ["left_motor", "right_motor"]\nunit = "pwm"'
        assert second.suggestion == ""  # its table has a command with a wrong topic
        assert "wheels.topics names motr" in second.refused_settings
        assert third.suggestion.startswith('[robots.my_robot]\naddress = "10.0.0.4"\n')

    wrong = RobotConfig(address="10.0.0.3", wheels=WheelsConfig(topics=("motr",)))
    in_hub(test, Config(robots={"slow": slow(), "wrong": wrong}))


@pytest.mark.parametrize(("type_name", "rest"), [("std_msgs/Int16", struct.pack("<h", 1500)), ("std_msgs/UInt8", None)])
def test_stop_of_all_sends_a_motor_with_wrong_settings_its_number_at_rest(type_name: str, rest: bytes | None) -> None:
    wheels = WheelsConfig(topics=("/l", "rr"), unit="pwm", full=500, rest=1500)

    async def test(made: MemoryHub) -> None:
        device = await made.connect([to(0, "l", type_name), to(1, "r", type_name)])
        first, second = made.hub.robots.stop_all()
        await asyncio.sleep(SETTLED_S)
        assert device.payloads(TWIST) == ([] if rest is None else [rest])  # at zero it would turn
        assert first.reason == ("" if rest else "std_msgs/UInt8 has no value that surely means stop")
        assert second.reason == ""

    in_hub(test, Config(robots={"slow": slow(**WHEELS, wheels=wheels)}))


def test_right_board_takes_the_name_of_one_with_a_wrong_topic_whose_lock_holds_for_both() -> None:
    async def test(made: MemoryHub) -> None:
        wrong, right = [to(0, "cmd_vel")], [to(0, "l", FLOAT), to(1, "r", FLOAT)]
        device = await made.connect(wrong)
        made.robot("slow").lock("a foot")
        await asyncio.sleep(5.0)
        await made.connect(right)
        await asyncio.sleep(5.0)
        assert made.robot("slow").topics.velocity == "l"
        assert device.link not in made.hub.links.all()  # the device connects again
        await made.connect(wrong)
        await asyncio.sleep(5.0)
        assert [each.name for each in made.hub.robots.here()] == ["robot_0", "slow"]
        assert made.robot("slow").gate.lock_reason == "a foot"
        assert made.robot().gate.lock_reason == "it may be slow: a foot"

    in_hub(test, Config(robots={"slow": slow(**WHEELS, wheels=WheelsConfig(topics=("l", "r")))}))
