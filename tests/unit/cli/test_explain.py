"""`hostlink robots`: how a robot is known, what nothing guards, and why a device is a robot or not."""

import asyncio
import json
import re
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from hostlink.cli.check import check
from hostlink.cli.robots import _robots
from hostlink.cli.settings import load
from hostlink.client import Host
from hostlink.components.gateway.settings import ApiConfig
from hostlink.core.config import Config, RobotConfig, TcpConfig, WheelsConfig
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from tests.support.background import cancelling
from tests.support.fake_device import robot_topics, topic
from tests.support.memory_client import memory_host
from tests.support.memory_hub import MemoryHub, in_hub

MOTORS = [
    topic(EndpointKind.SUBSCRIBER, 110 + each, f"/{side}_motor", "std_msgs/Int16") for each, side in enumerate("lr")
]
CAR = topic(EndpointKind.SUBSCRIBER, 100, "cmd_vel", "geometry_msgs/Twist")
ARM = topic(EndpointKind.SUBSCRIBER, 120, "/arm", "sensor_msgs/JointState")


def shown(
    *boards: Sequence[DeviceEndpoint],
    capsys: pytest.CaptureFixture[str],
    is_explained: bool = True,
    as_json: bool = False,
    config: Config | None = None,
) -> tuple[str, str]:
    """Return what `hostlink robots` writes of these boards, on standard output and standard error."""

    async def test(made: MemoryHub) -> None:
        for number, infos in enumerate(boards):
            await made.connect(infos, address=f"10.0.0.{number + 2}")
        async with cancelling() as tasks, memory_host(made.hub, tasks) as connected:
            host: Host = connected
            await _robots(host, is_explained=is_explained, json=as_json)

    in_hub(test, config)
    captured = capsys.readouterr()
    return captured.out, captured.err


def test_list_has_the_command_and_how_the_motion_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    out, err = shown(robot_topics(), [CAR], capsys=capsys, is_explained=False)
    head, car, robot = sorted(out.splitlines(), key=lambda line: "robot  " not in line)
    assert head.split("age s")[1].split() == ["command", "knows", "its", "motion", "by"]
    assert {tuple(line.split()[-2:]) for line in (car, robot)} == {("no", "odometry"), ("Twist", "pose")}
    assert err == ""


def test_list_warns_of_what_nothing_guards_with_lines_to_copy(capsys: pytest.CaptureFixture[str]) -> None:
    out, err = shown(MOTORS, capsys=capsys, is_explained=False)
    assert out == ""
    first, second, *lines = err.splitlines()
    assert first == "no robot has connected, but 1 device; `hostlink robots --explain` says why"
    assert second == "nothing guards /l_motor, /r_motor of link 1 (10.0.0.2); in hostlink.toml:"
    (name, settings), *_ = tomllib.loads("\n".join(lines))["robots"].items()
    assert (name, settings["address"]) == ("my_robot", "10.0.0.2")
    assert settings["wheels"]["topics"] == ["/l_motor", "/r_motor"]


def test_robot_is_explained_by_its_command_name_and_feedback(capsys: pytest.CaptureFixture[str]) -> None:
    out, _ = shown(robot_topics(), capsys=capsys)
    assert out.splitlines() == [
        "link 1 (10.0.0.2) is the robot robot_0: it takes velocities on /robot_0/velocity_commands "
        "(geometry_msgs/Twist)",
        "  its name: the namespace of its command /robot_0/velocity_commands",
        "  its motion is known by pose, from /robot_0/odometry (geometry_msgs/Pose2D)",
    ]


def test_robot_without_a_name_and_odometry_is_explained(capsys: pytest.CaptureFixture[str]) -> None:
    out, _ = shown([CAR, ARM, *MOTORS[:1]], capsys=capsys)
    assert out.splitlines()[1:] == [
        "  its name: a number, which is kept for 10.0.0.2: its command cmd_vel tells no name",
        "  its motion is known by nothing: no odometry",
        "  topics that look like commands, and that nothing guards: /l_motor (std_msgs/Int16)",
        "  topics that set positions, without a lease: /arm (sensor_msgs/JointState)",
        "  to change that, put these lines into hostlink.toml, and restart hostlink:",
        "    [robots.robot_0]",
        '    locked_topics = ["/l_motor"]',
    ]


def test_settings_that_apply_or_do_not_fit_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    wheels = WheelsConfig(topics=("/l_motor", "/r_motor"), unit="rad_s")
    car = RobotConfig(wheels=wheels, wheel_radius_m=0.03)
    out, _ = shown(MOTORS, capsys=capsys, config=Config(robots={"car": car}))
    assert "  its name: [robots.car] in hostlink.toml" in out.splitlines()
    assert "  settings: [robots.car] in hostlink.toml" in out.splitlines()
    broken = Config(robots={"car": RobotConfig(wheels=wheels)})
    out, _ = shown(MOTORS, capsys=capsys, config=broken)
    assert out.startswith("link 1 (10.0.0.2) is not a robot: the settings do not fit its topics: ")
    assert "needs wheel_radius_m" in out
    _, err = shown(MOTORS, capsys=capsys, config=broken, is_explained=False)
    assert "link 1 (10.0.0.2) is not car: its settings do not fit: " in err


def test_explanation_as_json_is_the_answer_of_the_daemon(capsys: pytest.CaptureFixture[str]) -> None:
    out, _ = shown(MOTORS, capsys=capsys, as_json=True)
    (device,) = json.loads(out)["devices"]
    assert (device["robot"], device["link"], [each["role"] for each in device["topics"]]) == (
        None,
        1,
        ["unguarded"] * 2,
    )
    assert [each["topic"] for each in device["unguarded"]] == ["/l_motor", "/r_motor"]


LED = topic(EndpointKind.SUBSCRIBER, 130, "/led", "std_msgs/Int16")
FOO = topic(EndpointKind.SUBSCRIBER, 100, "foo", "geometry_msgs/Twist")
SAID = topic(EndpointKind.SUBSCRIBER, 100, "/foo/cmd", "std_msgs/String")
CONFIGURED = Config(robots={"foo": RobotConfig(address="10.0.9.9")})
SEVERAL = Config(robots={"duo": RobotConfig(devices=("10.0.0.2", "10.0.0.3"))})


@pytest.mark.parametrize(
    ("boards", "config", "names"),
    [
        ([("10.0.0.2", [FOO]), ("10.0.0.2", [FOO, LED])], Config(), {"foo": "10.0.0.2"}),
        ([("10.0.0.2", [FOO]), ("10.0.0.3", [FOO])], Config(), {"foo": "10.0.0.2", "foo_2": "10.0.0.3"}),
        ([("10.0.0.2", [FOO])], CONFIGURED, {"foo_2": "10.0.0.2"}),
        ([("10.0.0.2", [FOO]), ("10.0.0.2", [SAID])], Config(), {"foo": "10.0.0.2", "foo_2": "10.0.0.2:7001"}),
        ([("10.0.0.2", [CAR, MOTORS[0]]), ("10.0.0.3", [MOTORS[1]])], SEVERAL, {"duo": None}),
    ],
)
@pytest.mark.parametrize("is_explained", [True, False])
def test_lines_to_copy_are_together_a_settings_file(
    boards: list[tuple[str, list[DeviceEndpoint]]],
    config: Config,
    names: dict[str, str | None],
    is_explained: bool,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    async def test(made: MemoryHub) -> None:
        for number, (address, infos) in enumerate(boards):
            await made.connect(infos, address=address, peer=f"{address}:{7000 + number}")
        await asyncio.sleep(1.0)
        async with cancelling() as tasks, memory_host(made.hub, tasks) as connected:
            host: Host = connected
            await _robots(host, is_explained=is_explained, json=False)

    in_hub(test, config)
    captured = capsys.readouterr()
    text = captured.out if is_explained else captured.err
    is_line = re.compile(r" +(\[robots|[a-z_]+ = )")
    path = tmp_path / "hostlink.toml"
    path.write_text("\n".join(line for line in text.splitlines() if is_line.match(line)))
    found = load(path)
    assert {name: robot.address for name, robot in found.robots.items()} == names
    asyncio.run(
        check(
            replace(found, tcp=TcpConfig(host="127.0.0.1", port=0)).with_tables(api=ApiConfig(port=0)), descriptors=1024
        )
    )
    if "duo" in names:
        assert set(found.robots["duo"].locked_topics) == {"/l_motor", "/r_motor"}
        assert ("put these lines into the table [robots.duo] of hostlink.toml" in text) is is_explained
    assert (re.search(r"the lines of link 1 \(.*\) are for it, too", text) is not None) is (len(boards) > len(names))


POSE = topic(EndpointKind.PUBLISHER, 125, "pose", "geometry_msgs/Pose2D")


def lines_of(link: int, out: str) -> list[str]:
    """Return the lines of one device, without the settings that apply to it."""
    found = re.search(rf"^link {link} .*\n(  .*\n)*", out, re.MULTILINE)
    assert found is not None
    return [line for line in found[0].splitlines() if "in hostlink.toml" not in line]


def test_board_of_a_robot_of_several_is_explained_as_a_part_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    arm = topic(EndpointKind.SUBSCRIBER, 101, "arm/cmd_vel", "geometry_msgs/Twist")
    several = RobotConfig(devices=("10.0.0.2", "10.0.0.3"), command_device="10.0.0.2")
    out, _ = shown([CAR], [POSE, arm], capsys=capsys, config=Config(robots={"duo": several}))
    assert lines_of(1, out) == [
        "link 1 (10.0.0.2) is the robot duo: it takes velocities on /duo/cmd_vel (geometry_msgs/Twist)",
        "  its motion is known by pose",
    ]
    assert lines_of(2, out) == [
        "link 2 (10.0.0.3) is a part of the robot duo, which takes its velocities on another device",
        "  the robot's motion is known by /pose (geometry_msgs/Pose2D)",
        "  velocity topics with a lease of their own, and the robot's limits, stop and lock: /arm/cmd_vel "
        "(geometry_msgs/Twist)",
    ]


def test_velocity_topics_in_space_are_explained_and_settings_that_name_a_wrong_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    drone = RobotConfig(command_topic="foo", kinematics="spatial")
    other = RobotConfig(address="10.0.0.3", command_topic="bar")
    out, _ = shown([FOO], [CAR], capsys=capsys, config=Config(robots={"drone": drone, "other": other}))
    assert lines_of(1, out) == [
        'link 1 (10.0.0.2) is not a robot of the plane, by kinematics = "spatial"',
        "  velocity topics, which take all six numbers, with a lease and a lock: /foo (geometry_msgs/Twist)",
    ]
    assert lines_of(2, out)[0] == (
        "link 2 (10.0.0.3) is the robot other: it takes velocities on /other/cmd_vel (geometry_msgs/Twist)"
    )
    problem = "command_topic names bar, which the board does not announce; its topics are cmd_vel (geometry_msgs/Twist)"
    assert f"  its settings do not fit: {problem}" in lines_of(2, out)


def test_topic_that_was_refused_is_named_with_its_reason(capsys: pytest.CaptureFixture[str]) -> None:
    wrong = CAR._replace(md5="0" * 32)
    out, err = shown([wrong], [*robot_topics(), LED._replace(md5="0" * 32)], capsys=capsys)
    reason = f"cmd_vel: wanted geometry_msgs/Twist md5 {CAR.md5}, got md5 {wrong.md5}"
    assert lines_of(1, out) == [
        "link 1 (10.0.0.2) is not a robot: hostlink refused topics of it, and none of the others takes a velocity",
        f"  refused: {reason}; `hostlink doctor` says what to do",
    ]
    assert "is the robot robot_0" in lines_of(2, out)[0]
    assert "  refused: /led: wanted" in lines_of(2, out)[-1]
    assert err == ""
    _, err = shown([wrong], capsys=capsys, is_explained=False)
    assert err == "no robot has connected, but 1 device; `hostlink robots --explain` says why\n"
