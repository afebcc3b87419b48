"""Public board programs, replayed as devices: each that moves is a robot, by itself or by a setting.

tests/sketches.json has their topics, as facts. `pytest -s -k table` prints what each of them is.
"""

import asyncio
import json
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from hostlink.cli.settings import load
from hostlink.core.config import Config, RobotConfig
from hostlink.core.hub.reloader import places_of
from hostlink.core.hub.robot import LocalRobot
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.robot.model import Endpoint, actuators, find_robot, suggestion, unguarded
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, ZERO, PlanarVelocity
from hostlink.errors import CommandRefused
from tests.support.fake_device import CATALOG
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.participants import publish
from tests.support.scripted_device import ScriptedDevice

PROGRAMS: list[dict[str, Any]] = json.loads((Path(__file__).parent.parent / "sketches.json").read_text())["programs"]
BY_ITSELF, BY_A_SETTING, ACTUATORS, NEITHER = "robot by itself", "robot by a setting", "actuators", "neither"
BY_TYPE = (TWIST_TYPE, TWIST_STAMPED_TYPE, "ackermann_msgs/AckermannDrive", "ackermann_msgs/AckermannDriveStamped")
ADDRESS, NAME = "10.0.0.2", "mine"
#: Commands of a type that is the project's own: nothing can encode them. A lock refuses them.
UNKNOWN_TYPES = ("scr_proto/SpeedCommand", "custom_msgs/ThrusterSpeeds")


def endpoints(program: dict[str, Any]) -> list[Endpoint]:
    return [Endpoint(each["name"], each["type"], each["direction"] == "to_device") for each in program["topics"]]


def infos(program: dict[str, Any]) -> list[DeviceEndpoint]:
    """Announcement of its board, with the ids that rosserial gives."""
    made = []
    for number, each in enumerate(endpoints(program)):
        known = CATALOG.message(each.type_name)
        md5 = "0" * 32 if known is None else known.md5
        kind = EndpointKind.SUBSCRIBER if each.is_to_device else EndpointKind.PUBLISHER
        made.append(DeviceEndpoint(kind, 100 + number, each.name, each.type_name, md5, 512))
    return made


def what_it_is(program: dict[str, Any]) -> str:
    topics = endpoints(program)
    if find_robot(topics) is not None:
        return BY_ITSELF
    if unguarded(topics):
        return BY_A_SETTING
    return ACTUATORS if actuators(topics) else NEITHER


def settings_of(program: dict[str, Any]) -> str:
    """Lines of hostlink.toml that the finding of its board suggests."""
    return suggestion(unguarded(endpoints(program)), NAME, ADDRESS)


def has_robot(program: dict[str, Any]) -> bool:
    what = what_it_is(program)
    return what == BY_ITSELF or (what == BY_A_SETTING and "locked_topics" not in settings_of(program))


def config_of(text: str) -> Config:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hostlink.toml"
        path.write_text(text)
        return load(path)


async def takes_a_velocity_and_a_zero(made: MemoryHub, device: ScriptedDevice, robot: LocalRobot) -> None:
    """Check that every command topic of the robot hears something that moves, and then rest."""
    ids = {info.name: info.id for info in device.infos if info.kind is EndpointKind.SUBSCRIBER}
    topics = [ids[topic.name] for topic in robot.commands.topics]
    zeros = list(robot.commands.encode(ZERO))
    await asyncio.sleep(0.1)
    driver = made.hub.join("driver")
    driver.drive(robot, PlanarVelocity(0.2))
    await asyncio.sleep(0.2)
    moving = [device.payloads(topic)[-1] for topic in topics]
    assert [payload[16:] for payload in moving] != [zero[16:] for zero in zeros] or moving != zeros
    driver.drive(robot, ZERO)
    await asyncio.sleep(0.2)
    at_rest = [device.payloads(topic)[-1] for topic in topics]
    for topic, payload, zero in zip(robot.commands.topics, at_rest, zeros, strict=True):
        is_stamped = topic.type_name.endswith(("Stamped", "/Joy", "/JointState"))
        assert payload[16:] == zero[16:] if is_stamped else payload == zero  # the stamp is another
    assert moving != at_rest


def only_robot(made: MemoryHub, device: ScriptedDevice) -> LocalRobot:
    robot = made.hub.robots.of_link(device.link)
    assert robot is not None
    return robot


ROBOTS = [program for program in PROGRAMS if has_robot(program)]
BY_SETTING = [program for program in ROBOTS if what_it_is(program) == BY_A_SETTING]


def ident(program: dict[str, Any]) -> str:
    return str(program["id"])


@pytest.mark.parametrize("program", PROGRAMS, ids=ident)
def test_every_program_that_moves_is_a_robot_or_says_how_it_becomes_one(program: dict[str, Any]) -> None:
    what = what_it_is(program)
    assert what != NEITHER or not program["moves_by"]
    types = {
        each["type"]
        for each in program["topics"]
        if each["name"] in program["moves_by"] and each["direction"] == "to_device"
    }
    if types & set(BY_TYPE):
        assert what == BY_ITSELF
    if what == BY_A_SETTING and not has_robot(program):
        assert types & set(UNKNOWN_TYPES)
        assert config_of(settings_of(program)).robots[NAME].locked_topics


@pytest.mark.parametrize("program", [each for each in ROBOTS if each not in BY_SETTING], ids=ident)
def test_a_robot_by_itself_takes_a_velocity_and_a_zero(program: dict[str, Any]) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(infos(program), address=ADDRESS)
        await takes_a_velocity_and_a_zero(made, device, only_robot(made, device))
        await device.aclose()

    in_hub(test)


@pytest.mark.parametrize("program", BY_SETTING, ids=ident)
def test_a_robot_by_a_setting_takes_a_velocity_and_a_zero(program: dict[str, Any]) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(infos(program), address=ADDRESS)
        robot = only_robot(made, device)
        assert robot.name == NAME
        await takes_a_velocity_and_a_zero(made, device, robot)
        await device.aclose()

    in_hub(test, config_of(settings_of(program)))


@pytest.mark.parametrize("program", BY_SETTING, ids=ident)
def test_a_reload_makes_a_robot_of_a_device_that_is_connected(program: dict[str, Any]) -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(infos(program), address=ADDRESS)
        assert made.hub.robots.of_link(device.link) is None
        config = config_of(settings_of(program))
        made.hub.reconfigure(config, places_of(config))
        await asyncio.sleep(0.1)
        robot = only_robot(made, device)
        assert robot.name == NAME
        await takes_a_velocity_and_a_zero(made, device, robot)
        made.hub.reconfigure(Config(), places_of(Config()))
        await asyncio.sleep(0.1)
        assert made.hub.robots.of_link(device.link) is None
        await device.aclose()

    in_hub(test)


@pytest.mark.parametrize("program", [each for each in PROGRAMS if each not in ROBOTS], ids=ident)
def test_lock_by_name_refuses_what_takes_no_velocity(program: dict[str, Any]) -> None:
    """Positions, and commands of a type that is the project's own: `locked_topics` gives a lock for them."""
    names = tuple(each.name for each in endpoints(program) if each.is_to_device)
    if what_it_is(program) == ACTUATORS:
        config = Config(robots={NAME: RobotConfig(address=ADDRESS, locked_topics=names)})
    else:
        config = config_of(settings_of(program))
        names = config.robots[NAME].locked_topics

    async def test(made: MemoryHub) -> None:
        device = await made.connect(infos(program), address=ADDRESS)
        made.hub.robots.find_to_stop(NAME).lock("a foot")
        locked = [info for info in device.infos if info.name in names and info.type not in UNKNOWN_TYPES]
        for info in locked:
            with pytest.raises(CommandRefused, match=r"locked: a foot; to drive it again: hostlink unlock mine$"):
                publish(made.hub, info.name, {}, type_name=info.type)
        assert locked or any(info.type in UNKNOWN_TYPES for info in device.infos)
        await asyncio.sleep(0.1)
        assert not any(device.payloads(info.id) for info in locked)

    in_hub(test, config)


def test_table() -> None:
    """Most programs are robots by themselves."""
    counts = Counter(map(what_it_is, PROGRAMS))
    for program in PROGRAMS:
        robot, topics = find_robot(endpoints(program)), endpoints(program)
        commands = [each.name for each in robot.commands] if robot else []
        others = [each.name for each in (*unguarded(topics, guarded=commands), *actuators(topics))]
        print(f"{program['id']:22} {what_it_is(program):18} {', '.join(commands):36} {', '.join(others)}")  # noqa: T201 - it is asked for
    print(dict(counts))  # noqa: T201 - it is asked for
    assert counts[BY_ITSELF] >= 32
    assert counts[NEITHER] == 0
    assert sum(not has_robot(each) for each in PROGRAMS if what_it_is(each) == BY_A_SETTING) <= len(UNKNOWN_TYPES)
