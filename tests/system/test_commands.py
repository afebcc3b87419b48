"""The commands that talk to a running daemon, as a person and as a program use them."""

import asyncio
import contextlib
import json
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from tests.support.background import meanwhile
from tests.support.fake_device import FakeDevice, fake_device, robot_topics, service_server, topic
from tests.support.process import HOSTLINK, run, serve, simulated
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S

LED = [topic(EndpointKind.SUBSCRIBER, 100, "/led", "std_msgs/Bool")]
TRIGGER = service_server("/trigger", "std_srvs/Trigger", 125, 101)
STOP_S = 0.6  # a lease, and a turn of the gate


async def test_topics_echo_pub_and_call() -> None:
    async with serve() as daemon, fake_device(daemon.tcp, LED + TRIGGER) as device, asyncio.TaskGroup() as tasks:
        status, out, _ = await run("topics", "--json", "--url", daemon.url)
        assert (status, [each["name"] for each in json.loads(out)]) == (0, ["/diagnostics", "/led", "/rosout"])

        listening = tasks.create_task(run("echo", "/led", "--count", "1", "--json", "--url", daemon.url))
        while "/echo_" not in (await run("info", "/led", "--json", "--url", daemon.url))[1]:
            continue  # `info` itself subscribes to nothing
        assert await run("pub", "/led", '{"data": true}', "--url", daemon.url) == (0, "", "1 sent\n")
        assert await device.frame(100) == b"\x01"
        assert await listening == (0, '{"data": true}\n', "")

        for success, printed in ((b"\x01", "true"), (b"\x00", "false")):  # an answer is status 0, also a refusal
            calling = tasks.create_task(run("call", "/trigger", "--url", daemon.url))
            await device.frame(101)
            await device.send(encode(125, success + b"\x02\x00\x00\x00ok"))
            assert await calling == (0, f'{{"success": {printed}, "message": "ok"}}\n', "")


@contextlib.asynccontextmanager
async def driving_with_pub(url: str, device: FakeDevice) -> AsyncIterator[asyncio.subprocess.Process]:
    twist = '{"linear": {"x": 0.2}}'
    child = await asyncio.create_subprocess_exec(
        HOSTLINK,
        "pub",
        "/robot_0/velocity_commands",
        twist,
        "--count",
        "0",
        "--url",
        url,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        assert await device.velocity_other_than((0.0, 0.0)) == (0.2, 0.0)
        yield child
    finally:
        if child.returncode is None:
            child.kill()
        await child.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
async def test_a_program_that_ends_in_any_way_stops_the_robot(number: signal.Signals) -> None:
    async with (
        serve() as daemon,
        fake_device(daemon.tcp, robot_topics()) as device,
        driving_with_pub(daemon.url, device) as child,
    ):
        watch = Stopwatch(daemon.pid, child.pid)
        async with meanwhile(watch.sampling()):
            child.send_signal(number)
            assert await device.velocity_other_than((0.2, 0.0)) == (0.0, 0.0)
            assert watch.seconds < STOP_S


async def test_demo_drives_its_robot_and_ends_cleanly() -> None:
    child = await asyncio.create_subprocess_exec(
        HOSTLINK, "demo", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0",
        stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert child.stdout is not None
    lines = []
    async with asyncio.timeout(TIMEOUT_S):
        while not any("driven by demo" in line and "x  +0.0" not in line for line in lines):
            lines.append((await child.stdout.readline()).decode())
            assert lines[-1], "the demo ended by itself"
    child.send_signal(signal.SIGINT)
    _, err = await child.communicate()
    assert child.returncode == 0
    assert lines[0].startswith("hostlink runs: http://127.0.0.1:")
    assert err == b""


async def test_a_fleet_is_listed_by_name() -> None:
    """Names are in natural order: robot_9 before robot_10."""
    names = ["robot_8", "robot_9", "robot_10"]
    async with serve() as daemon, simulated(daemon.tcp, "--robots", "3", "--first", "8"):
        for _ in names:
            await daemon.read_log("robot.appeared")
        listed = {command: (await run(command, "--url", daemon.url))[1] for command in ("robots", "stop", "topics")}
    assert [line.split()[0] for line in listed["robots"].splitlines()[1:]] == names
    stopped = [line.partition(" (0.00 m/s after ")[0] for line in listed["stop"].splitlines()]
    assert stopped == [f"{name} is stopped" for name in names]
    topics = [line.split()[0] for line in listed["topics"].splitlines()[1:]]
    assert [topic for topic in topics if topic.endswith("/odometry")] == [f"/{name}/odometry" for name in names]


async def test_a_guarded_daemon_requires_a_token_of_the_commands(tmp_path: Path) -> None:
    secret, config = "a-token-of-a-driver", tmp_path / "hostlink.toml"
    (tmp_path / "token").write_text(secret + "\n")
    config.write_text('[[api.tokens]]\nname = "desk"\nrole = "drive"\ntoken_file = "token"\n')
    async with serve("--config", str(config)) as daemon:
        status, _, complaint = await run("topics", "--url", daemon.url)
        assert (status, complaint.count("\n")) == (1, 1)
        assert "token" in complaint
        status, _, complaint = await run("doctor", "--url", daemon.url, "--token", "of-yesterday")
        assert (status, complaint.count("\n")) == (1, 1)
        assert "it does not know this token, or not any more" in complaint
        assert (await run("topics", "--url", daemon.url, "--token", secret))[0] == 0
        assert (await run("topics", "--url", f"{daemon.url}/?token={secret}"))[0] == 0
        daemon.child.send_signal(signal.SIGTERM)
        await daemon.read_log("daemon.stopped")
        assert "client.closed" in json.dumps(daemon.log)
        assert secret not in json.dumps(daemon.log)
