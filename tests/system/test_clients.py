"""The clients that people have: both lines of roslib on Node, and roslibpy, each doing all that it offers."""

import asyncio
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.daemon import Daemon, daemon
from tests.support.proxy import proxy
from tests.support.simulated import simulated_robot

CLIENTS = Path(__file__).parent.parent / "clients"
TIMEOUT_S = 40.0
ODOMETRY = ["header", "child_frame_id", "pose", "twist"]


def address_of(host: Daemon) -> tuple[str, int]:
    name, _, port = host.url.removeprefix("http://").partition(":")
    return name, int(port)


async def run(*command: str) -> Any:
    """What a program has seen, when it is pointed at a daemon with a simulated robot, through a line that is cut."""
    async with (
        daemon() as host,
        proxy(address_of(host)) as line,
        simulated_robot(host.tcp),
        asyncio.timeout(TIMEOUT_S),
    ):
        address = (
            [line.url.replace("http", "ws")] if command[0] == "node" else line.url.removeprefix("http://").split(":")
        )
        program = await asyncio.create_subprocess_exec(
            command[0], command[1], *address, *command[2:], cwd=CLIENTS,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE, limit=2**24,
        )  # fmt: skip
        assert program.stdout is not None
        try:
            output = await program.stdout.readline()
            if output == b"cut\n":
                line.break_off()
            out, err = await program.communicate()
        finally:
            if program.returncode is None:
                program.kill()
        assert (program.returncode, output) == (0, b"cut\n"), output.decode() + err.decode()
    return json.loads(out)


def check_what_all_receive(observed: Any) -> None:
    assert observed["odom"]["header"]["frame_id"] == "odom"
    assert observed["odom"]["pose"]["covariance"][0] == 0.001
    assert (observed["text"], observed["png"], observed["latched"]) == ("hällo", "plain", "kept")
    assert observed["throttled"] == [0, 9]
    assert (observed["answer"]["success"], observed["answer"]["message"].lower()) == (True, "got true")
    assert "no service named /add" in observed["refused"]
    assert observed["reconnected"] is True


@pytest.mark.parametrize("library", ["roslib", "roslib-1"])
async def test_roslib_does_all_that_it_offers(library: str) -> None:
    observed = await run("node", "everything.mjs", library)
    check_what_all_receive(observed)
    assert observed["pose"].keys() == {"x", "y", "theta"}
    assert observed["image"] == "AQID"
    assert observed["floats"] == {"kind": "Float32Array", "values": [1.5, -2]}
    assert observed["bytes"] == {"kind": "Uint8Array", "values": [1, 2, 3]}
    assert observed["wide"] == [7, -7]
    assert bytes.fromhex(observed["raw"]) == b"\x03\x00\x00\x00abc"
    assert observed["lock"]["success"] is True
    assert (observed["param"], observed["deleted"]) == ([1, 2.5], None)
    assert observed["status"] == "unknown op 'dance'"
    assert observed.get("action") in (None, "GoalError: Action was aborted: no actions here")  # roslib 1 has no actions
    assert observed["decoded"] == {"x": "float64", "covariance": ["float64"], "frame": "string"}
    api = observed["api"]
    topics = dict(zip(api["getTopics"]["topics"], api["getTopics"]["types"], strict=True))
    assert topics["/tf"] == "tf2_msgs/TFMessage"
    raw = api["getTopicsAndRawTypes"]
    assert "float64[36] covariance" in raw["typedefs_full_text"][raw["topics"].index("/robot_0/odom")]
    assert "/robot_0/cmd_vel" in api["getTopicsForType"]
    assert api["getTopicType"] == "geometry_msgs/Pose2D"
    assert (api["getServicesForType"], api["getServiceType"]) == (["/rosapi/topics"], "rosapi/Topics")
    assert api["getServiceRequestDetails"]["typedefs"][0]["fieldnames"] == ["name", "default"]
    assert [one["type"] for one in api["getServiceResponseDetails"]["typedefs"]] == ["rosapi/GetTimeResponse", "time"]
    assert "/robot_0" in api["getNodes"]
    details = api["getNodeDetails"]
    assert any("/robot_0/odometry" in names for names in (details if isinstance(details, list) else details.values()))
    assert api["getActionServers"] == []


async def test_roslibpy_does_all_that_it_offers() -> None:
    observed = await run(sys.executable, "everything.py")
    check_what_all_receive(observed)
    assert observed["stamp"] == {"secs": 5, "nsecs": 6}
    api = observed["api"]
    assert api["time"].keys() == {"secs", "nsecs"}
    assert {"/robot_0/odom", "/rosout"} < set(api["topics"])
    assert (api["topic_type"], api["service_type"]) == ("geometry_msgs/Pose2D", "rosapi/Topics")
    assert "/robot_0/cmd_vel" in api["topics_for_type"]
    assert "/rosapi/get_time" in api["services"]
    assert api["services_for_type"] == ["/rosapi/topics"]
    assert api["request_details"]["typedefs"][0]["fieldnames"] == ["name", "default"]
    assert api["response_details"]["typedefs"][1]["type"] == "time"
    assert api["message_details"]["typedefs"][0]["fieldnames"] == ODOMETRY
    assert "/robot_0" in api["nodes"]
    assert "/robot_0/odometry" in api["node_details"]["publishing"]
    assert api["action_servers"]["action_servers"] == []
    assert (api["param"], api["get_param"], api["params"]) == ([1, 2.5], [1, 2.5], ["/gain"])
    assert (api["set_param"], api["deleted"]) == ("x", None)
