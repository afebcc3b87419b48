"""The layout for Foxglove: every topic and field that it shows is one that the demo's robot has."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hostlink.components.gateway.foxglove import FoxgloveDirectory
from hostlink.core.config import RobotConfig
from hostlink.core.hub.robot_settings import frames_of
from hostlink.core.messages.message_type import MessageType
from tests.support.daemon import daemon
from tests.support.hosts import host_in
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

LAYOUT = json.loads((Path(__file__).parents[2] / "docs/examples/foxglove-layout.json").read_text())


def values(part: Any) -> Iterator[str]:
    """Every text that names a topic or a field of one."""
    if isinstance(part, dict):
        for key, inner in part.items():
            yield from [key] if key.startswith("/") else []
            yield from values(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from values(inner)
    elif isinstance(part, str) and part.startswith("/"):
        yield part


def panels(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        yield from panels(layout["first"])
        yield from panels(layout["second"])


def has_field(type_: MessageType, path: list[str]) -> bool:
    if not path:
        return True
    field = next((field for field in type_.fields if field.name == path[0]), None)
    if field is None:
        return False
    nested = type_.nested.get(field.type)
    return has_field(nested, path[1:]) if nested is not None else len(path) == 1


async def test_layout_shows_the_topics_of_a_robot() -> None:
    async with daemon() as host, simulated_robot(host.tcp):
        directory = FoxgloveDirectory(host_in(host.hub))

        def types() -> dict[str, MessageType]:
            return {channel.topic: channel.type for channel in directory.offers().channels.values()}

        await expect(lambda: {"/robot_0/odom", "/robot_0/cmd_vel"} <= types().keys())
        shown = [value.split(".") for value in values(LAYOUT)]
        assert len(shown) == 11
        for topic, *path in shown:
            assert has_field(types()[topic], path), (topic, path)
        teleop = LAYOUT["configById"]["Teleop!robot_0"]
        assert types()[teleop["topic"]].name == "geometry_msgs/Twist"
        lease_s = host.hub.robots.find("robot_0").gate.admission.lease_s
        assert 1 / teleop["publishRate"] < lease_s / 2  # a command that is lost stops nothing
        scene = LAYOUT["configById"]["3D!hostlink"]
        frames = frames_of("robot_0", RobotConfig())
        assert (scene["layers"]["grid"]["frameId"], scene["followTf"]) == frames


def test_every_panel_has_its_place_and_its_settings() -> None:
    placed = list(panels(LAYOUT["layout"]))
    assert sorted(placed) == sorted(LAYOUT["configById"])
