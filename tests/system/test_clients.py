"""The clients that people have: both lines of roslib on Node, roslibpy, and Foxglove, each doing all that it offers."""

import asyncio
import contextlib
import json
import signal
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from hostlink.components.gateway.settings import ApiConfig
from hostlink.components.recorder.settings import RecordingConfig
from hostlink.core.config import Config
from hostlink.core.robot.velocity import PlanarVelocity, Twist
from tests.support.daemon import daemon
from tests.support.proxy import Line, address_of, proxy
from tests.support.simulated import simulated_robot
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect

CLIENTS = Path(__file__).parent.parent / "clients"
TIMEOUT_S = 40.0
EXAMPLES = "node_modules/@foxglove/ws-protocol-examples/dist/cjs/ws-protocol-examples/src/index.js"
ODOMETRY = ["header", "child_frame_id", "pose", "twist"]


async def run(*command: str) -> Any:
    """Return what a program has seen of a daemon with a simulated robot, through a line that is cut."""
    async with (
        daemon() as host,
        proxy(host.url) as line,
        simulated_robot(host.tcp),
        asyncio.timeout(TIMEOUT_S),
    ):
        address = (
            [line.url.replace("http", "ws")] if command[0] == "node" else [str(part) for part in address_of(line.url)]
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
    assert observed["odom"]["header"]["frame_id"] == "robot_0/odom"
    assert observed["odom"]["pose"]["covariance"][0] == 0.001
    assert (observed["text"], observed["png"], observed["latched"]) == ("hällo", "plain", "kept")
    assert observed["throttled"] == [0, 9]
    assert (observed["answer"]["success"], observed["answer"]["message"].lower()) == (True, "got true")
    assert "no service named /add" in observed["refused"]
    assert observed["reconnected"] is True


@pytest.mark.parametrize("library", ["roslib", pytest.param("roslib-1", marks=pytest.mark.long)])
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
    assert (observed["locked"]["level"], observed["locked"]["kind"]) == ("error", "locked")
    assert (observed["param"], observed["deleted"]) == ([1, 2.5], None)
    assert observed["status"] == "unknown op 'dance'"
    aborted = "GoalError: Action was aborted: actions are unsupported"
    assert observed.get("action") in (None, aborted)  # roslib 1 has no actions
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
    assert observed["locked"] == []  # it prints a traceback for each status
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


@pytest.mark.parametrize(
    "subprotocol", ["foxglove.sdk.v1", pytest.param("foxglove.websocket.v1", marks=pytest.mark.long)]
)
async def test_foxglove_does_all_that_its_packages_offer(subprotocol: str) -> None:
    observed = await run("node", "foxglove.mjs", subprotocol)
    assert observed["protocol"] == subprotocol
    assert observed["info"]["capabilities"] == [
        "clientPublish", "services", "parameters", "parametersSubscribe", "connectionGraph", "time",
    ]  # fmt: skip
    assert observed["info"]["supportedEncodings"] == ["ros1"]
    assert observed["isSameSession"] is observed["reconnected"] is True
    assert {(encoding, schema) for encoding, _, schema in observed["channels"].values()} == {("ros1", "ros1msg")}
    assert observed["channels"]["/robot_0/odometry"] == ["ros1", "geometry_msgs/Pose2D", "ros1msg"]
    assert {"/robot_0/odometry", "/robot_0/odom", "/tf", "/robot_0/cmd_vel", "/robot_0/battery"} <= set(
        observed["decoded"]
    )
    assert observed["errors"] == []
    assert 0.05 < observed["odom"]["pose"]["pose"]["position"]["x"] < 1.0
    assert observed["odom"]["header"]["frame_id"] == "robot_0/odom"
    assert abs(observed["age"]) < 1000
    assert abs(observed["time"]["age"]) < 1000
    assert observed["time"]["behind"] < 100  # the app takes the newest time for when a message arrived
    (refused,) = observed["refused"]
    assert refused["level"] == 2
    assert "locked" in refused["message"]
    assert observed["removed"] == [refused["id"]] == ["/robot_0/cmd_vel"]
    assert observed["lock"]["encoding"] == "ros1"
    assert observed["lock"]["success"] is observed["unlock"]["success"] is True
    assert ["/robot_0/lock", "std_srvs/Trigger"] in observed["services"]
    assert observed["unknown"] == "there is no service 12345"
    assert observed["text"] == "hällo"
    assert observed["parameters"] == [{"name": "/gain", "value": 1}]
    assert observed["gain"] == {"name": "/gain", "value": 2, "type": "float64"}
    graph = observed["graph"]
    assert graph["published"]["/robot_0/odometry"] == ["/robot_0"]
    assert {"/client_1", "/client_2"} & set(graph["subscribed"]["/robot_0/odometry"])  # whichever connected first
    assert graph["services"]["/robot_0/lock"] == ["/hostlink"]
    assert observed["mistake"] == {"op": "status", "level": 2, "message": "subscribe: there is no channel 99999"}


async def test_foxglove_reads_a_recording_over_ranges_and_decodes_every_channel(tmp_path: Path) -> None:
    api = ApiConfig(origins=("https://app.foxglove.dev",))
    config = Config().with_tables(api=api, recording=RecordingConfig(folder=tmp_path, min_free_disk_mb=0.0))
    async with daemon(config) as host, simulated_robot(host.tcp), asyncio.timeout(TIMEOUT_S):
        assert (await host.rest("POST", "/api/recordings", b'{"name": "run"}'))[0] == 200
        await expect(lambda: host.hub.topics.find("/robot_0/odometry").messages > 10)
        status, view = await host.rest("POST", "/api/recordings/run/stop")
        assert status == 200, view
        program = await asyncio.create_subprocess_exec(
            "node", "recording.mjs", f"{host.url}/api/recordings/run.mcap", cwd=CLIENTS,
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        out, err = await program.communicate()
    assert program.returncode == 0, err.decode()
    observed = json.loads(out)
    assert observed["head"] == [200, "bytes", (tmp_path / "run.mcap").stat().st_size]
    assert observed["profile"] == "ros1"
    assert sum(topic["count"] for topic in observed["topics"].values()) == view["messages"]
    assert observed["topics"]["/robot_0/odometry"]["last"].keys() == {"x", "y", "theta"}
    assert "kind" in json.loads(observed["topics"]["/hostlink/events"]["last"]["data"])
    assert 3 <= observed["requests"] < 100


@pytest.mark.parametrize("line_is", [Line.WORKS, pytest.param(Line.GATHERS, marks=pytest.mark.long)])
async def test_foxglove_mcap_record_records_every_channel(line_is: Line, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    async with (
        daemon() as host,
        proxy(host.url) as line,
        simulated_robot(host.tcp),
        asyncio.timeout(TIMEOUT_S),
    ):
        await expect(lambda: bool(host.hub.robots.all()))
        odometry = host.hub.topics.find("/robot_0/odometry")
        line.set_line(line_is)
        program = await asyncio.create_subprocess_exec(
            "node", EXAMPLES, "mcap-record", line.url.replace("http", "ws"), "-o", str(path), cwd=CLIENTS,
            stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip
        try:
            await expect(lambda: any(str(one.key).startswith("client") for one in odometry.subscribers))
            line.set_line(Line.WORKS)
            there = odometry.messages
            await expect(lambda: odometry.messages >= there + 5)
            program.send_signal(signal.SIGINT)
            _, err = await program.communicate()
        finally:
            if program.returncode is None:
                program.kill()
    assert program.returncode == 0, err.decode()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
    counts = {
        channel.topic: summary.statistics.channel_message_counts.get(number, 0)
        for number, channel in summary.channels.items()
    }
    assert {"/robot_0/odometry", "/robot_0/odom", "/tf", "/robot_0/cmd_vel", "/rosout"} <= set(counts)
    assert counts["/robot_0/odometry"] >= 4  # the newest may be on its way


@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.long)])
async def test_a_robot_stands_soon_after_foxglove_is_killed_or_frozen(number: signal.Signals) -> None:
    async with daemon() as host, simulated_robot(host.tcp), asyncio.timeout(TIMEOUT_S):
        await expect(lambda: bool(host.hub.robots.all()))
        robot = host.hub.robots.find("robot_0")
        program = await asyncio.create_subprocess_exec(
            "node", "foxglove_drive.mjs", host.url.replace("http", "ws"), robot.shown.velocity, cwd=CLIENTS
        )
        try:
            await expect(lambda: robot.gate.owner is not None)
            sent: list[PlanarVelocity] = []
            watching = host.hub.join("watching")
            watching.subscribe(robot.shown.velocity, lambda message: sent.append(Twist.decode(message.payload).planar))
            await expect(lambda: len(sent) > 5 and not sent[-1].is_zero)
            watch = Stopwatch()
            program.send_signal(number)
            await expect(lambda: sent[-1].is_zero)
            assert watch.seconds < 1.0  # a lease, and the turns of a busy machine
            await asyncio.sleep(0.2)
            assert sent[-1].is_zero
        finally:
            with contextlib.suppress(ProcessLookupError):
                program.kill()
            await program.wait()
