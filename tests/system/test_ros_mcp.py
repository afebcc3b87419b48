"""ros-mcp, by which language models drive robots over rosbridge, as docs/agents.md describes it."""

import asyncio
import json
import re
from asyncio.subprocess import PIPE
from pathlib import Path
from typing import Any

import pytest

from hostlink.components.gateway.settings import ApiConfig, TokenConfig
from hostlink.core.config import Config
from tests.support.daemon import Daemon, daemon
from tests.support.once import BUILD
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

PYTHON = BUILD / "ros-mcp-venv" / "bin" / "python"
PROGRAM = Path(__file__).parent.parent / "clients" / "ros_mcp_tools.py"
DOCUMENT = Path(__file__).parents[2] / "docs" / "agents.md"
FENCED = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
TOPIC = "/robot_0/velocity_commands"
TWIST = {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
NAMED = {"topic": TOPIC, "msg_type": "geometry_msgs/Twist"}
TOKEN = "a token of twenty-odd characters".replace(" ", "-")
TIMEOUT_S = 60.0

PUBLISH_ONCE = ("publish_once", {**NAMED, "msg": TWIST})
PUBLISH_EACH = ("publish_for_durations", {**NAMED, "messages": [TWIST], "durations": [0.0]})
PUBLISH_STREAM = ("publish_for_durations", {**NAMED, "messages": [TWIST], "durations": [0.5], "rate_hz": 10})
READ_POSE = ("subscribe_once", {"topic": "/robot_0/odometry", "msg_type": "geometry_msgs/Pose2D"})
LOCK = ("call_service", {"service_name": "/robot_0/lock", "service_type": "std_srvs/Trigger", "request": {}})

Call = tuple[str, dict[str, Any]]


async def answers(*calls: Call, server: Path | None = None) -> Any:
    """Return the answers of ros-mcp's tools."""
    words = [str(PROGRAM), json.dumps(calls), *([] if server is None else [str(server)])]
    program = await asyncio.create_subprocess_exec(str(PYTHON), *words, stdout=PIPE, stderr=PIPE)
    async with asyncio.timeout(TIMEOUT_S):
        out, error = await program.communicate()
    assert program.returncode == 0, error.decode()
    return json.loads(out)


def connect(host: Daemon) -> Call:
    return "connect_to_robot", {"ip": "127.0.0.1", "port": int(host.url.rpartition(":")[2])}


def snippet(text: str) -> str:
    """Return the snippet of the document that contains a text."""
    (found,) = (each for each in FENCED.findall(DOCUMENT.read_text()) if text in each)
    return found


@pytest.mark.long
async def test_velocity_for_a_locked_robot_is_a_failure_except_in_a_stream() -> None:
    async with daemon() as host, simulated_robot(host.tcp):
        await expect(host.hub.robots.all)
        host.hub.robots.find("robot_0").lock("smoke")
        _, once, each, stream = await answers(connect(host), PUBLISH_ONCE, PUBLISH_EACH, PUBLISH_STREAM)
        assert host.hub.robots.find("robot_0").gate.counts.commands == 0
    assert once.get("success", False) is False
    assert "Publish failed: robot_0: locked: smoke" in once["error"]
    assert (each["success"], each["published_count"]) == (True, 0)  # its `success` is always true
    assert "robot_0: locked: smoke" in each["errors"][0]
    assert (stream["success"], stream["errors"]) == (True, [])  # it does not read the refusals
    assert stream["published_count"] > 0


async def test_assistant_lists_topics_reads_poses_and_drives_under_a_lease() -> None:
    async with daemon() as host, simulated_robot(host.tcp) as robot:
        await expect(host.hub.robots.all)
        told = await answers(connect(host), ("get_topics", {}), READ_POSE, PUBLISH_ONCE, PUBLISH_EACH, PUBLISH_STREAM)
        assert host.hub.robots.find("robot_0").gate.counts.commands == 2 + told[5]["published_count"]
        await expect(lambda: abs(robot.speed_m_s) < 0.01)
        assert host.hub.robots.find("robot_0").state(asyncio.get_running_loop().time()).holder is None
    _, topics, pose, once, each, _ = told
    assert topics["types"][topics["topics"].index(TOPIC)] == "geometry_msgs/Twist"
    assert pose["msg"] == {"x": 0.0, "y": 0.0, "theta": 0.0}
    assert once["success"] is True
    assert (each["published_count"], each["errors"]) == (1, [])


@pytest.mark.long
async def test_assistant_with_a_token_that_only_reads_lists_and_does_not_drive(tmp_path: Path) -> None:
    token = TokenConfig(name="assistant", role="read", token=TOKEN)
    async with daemon(Config().with_tables(api=ApiConfig(tokens=(token,)))) as host, simulated_robot(host.tcp):
        await expect(host.hub.robots.all)
        (tmp_path / "token").write_text(TOKEN)
        server = tmp_path / "assistant.py"
        text = snippet("ws_manager").replace("assistant.token", str(tmp_path / "token"))
        server.write_text(text.replace("127.0.0.1:9090", host.url.removeprefix("http://")))
        topics, once, locked = await answers(("get_topics", {}), PUBLISH_ONCE, LOCK, server=server)
        assert host.hub.robots.find("robot_0").gate.counts.commands == 0
        (_, unknown) = await answers(connect(host), ("get_topics", {}))
    assert TOPIC in topics["topics"]
    assert "the token may only read" in once["error"]
    assert locked["success"] is False
    assert "topics" not in unknown


async def test_tool_of_the_document_drives_and_reports_a_lock() -> None:
    names: dict[str, Any] = {}
    async with daemon() as host, simulated_robot(host.tcp):
        await expect(host.hub.robots.all)
        code = snippet("def drive").replace("connect_blocking()", f"connect_blocking({host.url!r})")
        exec(compile(code, "agents.md", "exec"), names)  # noqa: S102 - the document's own
        driven = await asyncio.to_thread(names["drive"], 0.2, 0.1)
        host.hub.robots.find("robot_0").lock("smoke")
        refused = await asyncio.to_thread(names["drive"], 0.2, 0.1)
    assert driven.startswith("driven; now it is stopped at x 0.")
    assert refused.startswith("not driven: robot_0: locked: smoke")
