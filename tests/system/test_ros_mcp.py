"""ros-mcp, by which language models drive robots over rosbridge: what it says of a velocity that is refused."""

import asyncio
import json
from asyncio.subprocess import PIPE
from pathlib import Path
from typing import Any

from tests.support.daemon import Daemon, daemon
from tests.support.once import BUILD
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

PYTHON = BUILD / "ros-mcp-venv" / "bin" / "python"
PROGRAM = Path(__file__).parent.parent / "clients" / "ros_mcp_publish.py"
TOPIC = "/robot_0/velocity_commands"
TIMEOUT_S = 60.0


async def answers(host: Daemon) -> Any:
    """Return the answer of a tool that publishes."""
    port = host.url.rpartition(":")[2]
    program = await asyncio.create_subprocess_exec(str(PYTHON), str(PROGRAM), port, TOPIC, stdout=PIPE, stderr=PIPE)
    async with asyncio.timeout(TIMEOUT_S):
        out, error = await program.communicate()
    assert program.returncode == 0, error.decode()
    return json.loads(out)


async def test_velocity_for_a_locked_robot_is_a_failure() -> None:
    async with daemon() as host, simulated_robot(host.tcp):
        await expect(host.hub.robots.all)
        host.hub.robots.find("robot_0").lock("smoke")
        told = await answers(host)
    assert told["publish_once"].get("success", False) is False
    assert "Publish failed: robot_0: locked: smoke" in told["publish_once"]["error"]
    several = told["publish_for_durations"]  # its `success` is always true
    assert several["published_count"] == 0
    assert "robot_0: locked: smoke" in several["errors"][0]


async def test_a_velocity_that_is_obeyed_is_a_success() -> None:
    async with daemon() as host, simulated_robot(host.tcp):
        await expect(host.hub.robots.all)
        told = await answers(host)
        assert host.hub.robots.find("robot_0").gate.counts.commands == 2
    assert told["publish_once"]["success"] is True
    assert (told["publish_for_durations"]["published_count"], told["publish_for_durations"]["errors"]) == (1, [])
