"""`hostlink ros1` in place of rosserial_python's serial_node.py: as roslaunch and a person start it."""

import asyncio
import contextlib
import os
import signal
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from hostlink.protocol.frame import Id
from tests.support.fake_device import robot_topics, topic
from tests.support.fork_server import start
from tests.support.process import HOSTLINK, Process, free_port, started
from tests.support.ros1.debian import Graph, graph, living_device
from tests.support.waiting import expect

CHATTER = [*robot_topics(), topic(Id.PUBLISHER, 126, "chatter", "std_msgs/String")]


@pytest.fixture
async def ros(tmp_path: Path) -> AsyncIterator[Graph]:
    async with graph(tmp_path) as made:
        yield made


@contextlib.asynccontextmanager
async def ros1(ros: Graph, *words: str, **environment: str) -> AsyncIterator[Process]:
    """`hostlink ros1`, killed at the end of the block if it still runs."""
    variables = {**os.environ, "ROS_MASTER_URI": ros.url, "ROS_IP": "127.0.0.1", **environment}
    async with started("ros1", "--api", "127.0.0.1:0", *words, environment=variables) as process:
        yield process


async def failed(*words: str) -> str:
    """The one line of a command that is wrong."""
    child = await start("ros1", *words, stderr=PIPE, environment={**os.environ, "COLUMNS": "200"})
    async with asyncio.timeout(20):
        _, err = await child.communicate()
    assert child.returncode == 2
    return err.decode()


async def topics(ros: Graph, wanted: str) -> list[str]:
    found: list[str] = []
    for _ in range(60):
        found = (await ros.run("rostopic", "list"))[1].split()
        if wanted in found:
            return found
        await asyncio.sleep(0.1)
    raise AssertionError(f"no {wanted} in {found}")


async def test_a_line_of_a_launch_file(ros: Graph) -> None:
    """As roslaunch starts it: in a namespace, with a name, a remapping, and parameters at the master."""
    port = free_port()
    await ros.lines("rosparam", "set", "/lab/base/port", "tcp")
    await ros.lines("rosparam", "set", "/lab/base/tcp_port", str(port))
    words = ("__name:=base", "__log:=/tmp/base.log", "chatter:=talk", "/robot_0/odometry:=/odometry")
    async with ros1(ros, *words, ROS_NAMESPACE="/lab") as daemon:
        started = await daemon.read_log("daemon.started")
        assert started["tcp"].endswith(f":{port}")
        async with living_device(("127.0.0.1", port), CHATTER):
            found = await topics(ros, "/lab/talk")
            assert {"/odometry", "/robot_0/velocity_commands"} <= set(found)
            assert not {"/chatter", "/lab/chatter", "/robot_0/odometry"} & set(found)
            assert "/lab/base" in await ros.lines("rosnode", "list")


LAUNCH = """<launch>
  <group ns="lab">
    <node pkg="hostlink" type="serial_node.py" name="base" output="screen" args="--api 127.0.0.1:0">
      <param name="port" value="tcp"/>
      <param name="tcp_port" value="{port}"/>
      <remap from="chatter" to="talk"/>
    </node>
  </group>
</launch>
"""


async def test_roslaunch_starts_the_package_that_the_command_writes(ros: Graph, tmp_path: Path) -> None:
    child = await asyncio.create_subprocess_exec(HOSTLINK, "ros1", "--write-package", str(tmp_path), stdout=PIPE)
    out, _ = await child.communicate()
    assert b'<node pkg="hostlink" type="serial_node.py" name="serial_node"/>' in out
    port = free_port()
    file = tmp_path / "base.launch"
    file.write_text(LAUNCH.format(port=port))
    environment = {**ros.environment, "ROS_PACKAGE_PATH": str(tmp_path)}
    log = tmp_path / "roslaunch.log"
    with log.open("wb") as output:
        launch = await asyncio.create_subprocess_exec(
            "/usr/bin/roslaunch", str(file), env=environment, stdout=output, stderr=output
        )
    try:
        await expect(lambda: b"daemon.started" in log.read_bytes(), timeout_s=20)
        async with living_device(("127.0.0.1", port), CHATTER):
            assert "/lab/talk" in await topics(ros, "/lab/talk")
            assert "/lab/base" in await ros.lines("rosnode", "list")
    finally:
        launch.send_signal(signal.SIGINT)
        async with asyncio.timeout(20):
            await launch.wait()
    assert b"daemon.stopped" in log.read_bytes()


async def test_the_arguments_of_serial_node(ros: Graph) -> None:
    port = free_port()
    async with ros1(ros, "tcp", str(port), "_baud:=115200") as daemon:
        assert (await daemon.read_log("daemon.started"))["tcp"].endswith(f":{port}")
        await daemon.read_log("ros1.master_found")
        assert await ros.lines("rosparam", "get", "/serial_node/baud") == ["115200"]


async def test_a_serial_port_that_a_parameter_names(ros: Graph, tmp_path: Path) -> None:
    async with ros1(ros, f"_port:={tmp_path}/ttyACM0", "_baud:=115200") as daemon:
        waiting = await daemon.read_log("serial.waiting")
        assert f"{tmp_path}/ttyACM0" in str(waiting)


async def test_rosnode_kill_ends_it(ros: Graph) -> None:
    async with ros1(ros, "--tcp", str(free_port())) as daemon:
        await daemon.read_log("ros1.master_found")
        await ros.lines("rosnode", "kill", "/serial_node")
        ended = await daemon.read_log("daemon.stop_requested")
        assert "/rosnode" in ended["cause"]
        async with asyncio.timeout(10):
            assert await daemon.child.wait() == 0


async def test_it_waits_for_the_master_that_may_know_its_port(ros: Graph) -> None:
    await ros.kill()
    port = free_port()
    async with ros1(ros) as daemon:
        await expect(lambda: "waiting for the master" in daemon.log_file.read_text(), timeout_s=20)
        await ros.start()
        await ros.lines("rosparam", "set", "/serial_node/port", "tcp")
        await ros.lines("rosparam", "set", "/serial_node/tcp_port", str(port))
        await daemon.read_log("daemon.started")
        assert await daemon.end(signal.SIGTERM) == 0


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("tcp", "x"), "TCP port"),
        (("/dev/a", "/dev/b"), "a serial port, or tcp and a TCP port"),
        (("_port:=",), "a name and a value"),
        (("__name:=a/b",), "no name of a node"),
        (("__master:=localhost",), "http://localhost:11311"),
        (("__master:=http://localhost:99999",), "Port out of range"),
        (("--master", ""), "no address of a master"),
        (("tcp", "_number:=99999999999"), "the master cannot have it"),
        (("tcp", "--messages", "/nonexistent", "--master", "http://127.0.0.1:1"), "/nonexistent"),
    ],
)
async def test_what_is_wrong_is_one_line(ros: Graph, words: tuple[str, ...], text: str) -> None:
    err = await failed("--master", ros.url, *words)
    assert len(err.splitlines()) == 1
    assert text in err
