"""`hostlink ros1` in place of rosserial_python's serial_node.py: as roslaunch and a person start it."""

import asyncio
import contextlib
import os
import re
import signal
import socket
import struct
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.fake_device import CATALOG, FakeDevice, pose, repeating, robot_topics, topic
from tests.support.fork_server import start
from tests.support.process import HOSTLINK, Process, free_port, run, started
from tests.support.ros1.debian import PYTHON, Graph, call, graph, living_device
from tests.support.ros1.fake import connection
from tests.support.waiting import TIMEOUT_S, expect

CHATTER = [*robot_topics(), topic(EndpointKind.PUBLISHER, 126, "chatter", "std_msgs/String")]


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
    async with asyncio.timeout(TIMEOUT_S):
        _, err = await child.communicate()
    assert child.returncode == 2
    return err.decode()


@pytest.mark.long
async def test_node_of_a_launch_file_has_its_namespace_name_remapping_and_parameters(ros: Graph) -> None:
    """Start the node like roslaunch: in a namespace, with a name, a remapping, and parameters at the master."""
    port = free_port()
    await ros.lines("rosparam", "set", "/lab/base/port", "tcp")
    await ros.lines("rosparam", "set", "/lab/base/tcp_port", str(port))
    words = ("__name:=base", "__log:=/tmp/base.log", "chatter:=talk", "/robot_0/odometry:=/odometry")
    async with ros1(ros, *words, ROS_NAMESPACE="/lab") as daemon:
        started = await daemon.read_log("daemon.started")
        assert started["tcp"].endswith(f":{port}")
        async with living_device(("127.0.0.1", port), CHATTER):
            found = await ros.listed("/lab/talk")
            assert {"/odometry", "/robot_0/velocity_commands"} <= found
            assert not {"/chatter", "/lab/chatter", "/robot_0/odometry"} & found
            assert "/lab/base" in await ros.lines("rosnode", "list")


RELATIVE = [
    topic(EndpointKind.PUBLISHER, 125, "odometry", "geometry_msgs/Pose2D"),
    topic(EndpointKind.SUBSCRIBER, 100, "velocity_commands", "geometry_msgs/Twist"),
    topic(EndpointKind.SUBSCRIBER, 102, "~text", "std_msgs/String"),
]
OWN = ("robot_0/odom", "robot_0/cmd_vel", "robot_0/cmd_vel_stamped")  # hostlink's, of a robot without a name


async def nodes_of(ros: Graph) -> list[dict[str, set[str]]]:
    """Return the publishers and subscribers of each topic, and the provider of each service."""
    _, _, state = await call(ros.url, "getSystemState", "/test")
    return [{name: set(nodes) for name, nodes in part} for part in state]


async def parameter(device: FakeDevice, name: str) -> bytes:
    await device.send(encode(Id.PARAMETER, struct.pack("<I", len(name)) + name.encode()))
    return await device.frame(Id.PARAMETER)


@pytest.mark.long
async def test_two_nodes_in_two_namespaces_share_nothing_but_global_topics(ros: Graph) -> None:
    """Two devices with the same firmware are two robots of one name."""
    spaces = ("r1", "r2")
    async with contextlib.AsyncExitStack() as stack:
        devices: list[FakeDevice] = []
        for number, space in enumerate(spaces):
            await ros.lines("rosparam", "set", f"/{space}/serial_node/kp", str(number + 5))
            port = free_port()
            words = (f"__ns:=/{space}",) if number else ()
            environment = {} if number else {"ROS_NAMESPACE": f"/{space}"}
            await stack.enter_async_context(ros1(ros, "--tcp", str(port), *words, **environment))
            await expect(lambda port=port: is_listening(port))
            devices.append(await stack.enter_async_context(living_device(("127.0.0.1", port), RELATIVE)))
        readers = [
            await stack.enter_async_context(ros.node("listen", f"/{space}/robot_0/odom", "nav_msgs/Odometry"))
            for space in spaces
        ]
        for number, device in enumerate(devices):
            await stack.enter_async_context(repeating(device, pose(number + 1.0)))
        for number, (space, reader) in enumerate(zip(spaces, readers, strict=True)):
            message = await reader.read("message")
            assert message["by"] == f"/{space}/serial_node"
            assert message["fields"]["pose"]["pose"]["position"]["x"] == number + 1.0
        await ros.listed("/r2/robot_0/odom")
        published, subscribed, services = await nodes_of(ros)
        both = {f"/{space}/serial_node" for space in spaces}
        for space in spaces:
            node = {f"/{space}/serial_node"}
            assert published[f"/{space}/odometry"] == published[f"/{space}/robot_0/odom"] == node
            for name in ("velocity_commands", "robot_0/cmd_vel", "robot_0/cmd_vel_stamped", "serial_node/text"):
                assert subscribed[f"/{space}/{name}"] == node
            assert services[f"/{space}/robot_0/lock"] == services[f"/{space}/robot_0/unlock"] == node
        for name in ("/tf", "/diagnostics", "/rosout"):
            assert both <= published[name]
        assert not {f"/{name}" for name in OWN} & {*published, *subscribed}
        assert not {"/robot_0/lock", "/robot_0/unlock"} & services.keys()
        # A velocity and a lock are for one of them.
        await stack.enter_async_context(ros.node("drive", "/r2/robot_0/cmd_vel", "0.2", "20"))
        await devices[1].velocity_of((0.2, 0.0))
        assert "success: True" in await ros.lines("rosservice", "call", "/r1/robot_0/lock")
        assert [(await parameter(device, "~kp"))[4] for device in devices] == [5, 6]
        for space in spaces:
            assert {f"hostlink/{space}: daemon", f"hostlink/{space}: robot_0 link"} <= await status_names(ros, space)


async def status_names(ros: Graph, space: str) -> set[str]:
    """Return the names in a message of a node's /diagnostics, read without rospy, which lacks the type here."""
    uri = await ros.slave_uri(f"/{space}/serial_node")
    _, _, (_, host, port) = await call(uri, "requestTopic", "/test", "/diagnostics", [["TCPROS"]])
    type_ = CATALOG.message("diagnostic_msgs/DiagnosticArray")
    assert type_ is not None
    fields = {"callerid": "/test", "topic": "/diagnostics", "type": type_.name, "md5sum": type_.md5}
    async with connection((host, port), **fields) as peer:
        await peer.read_header()
        status: Any = type_.decode(await peer.read())["status"]
        return {each["name"] for each in status}


def is_listening(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
        return True
    return False


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


@pytest.mark.long
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
        await expect(lambda: b"daemon.started" in log.read_bytes())
        async with living_device(("127.0.0.1", port), CHATTER):
            assert "/lab/talk" in await ros.listed("/lab/talk")
            assert "/lab/base" in await ros.lines("rosnode", "list")
    finally:
        launch.send_signal(signal.SIGINT)
        async with asyncio.timeout(TIMEOUT_S):
            await launch.wait()
    assert b"daemon.stopped" in log.read_bytes()


CHECK_PACKAGE = """
import sys, catkin_pkg.packages, catkin_pkg.topological_order
found = catkin_pkg.packages.find_packages(sys.argv[1])  # as catkin_make begins; it raises what is wrong
for path, package in found.items():
    package.validate(warnings=(warnings := []))
    print(path, package.name, package.version, package.get_build_type(), warnings)
assert [each.name for _, each in catkin_pkg.topological_order.topological_order(sys.argv[1])] == ["hostlink"]
"""


async def test_package_that_the_command_writes_is_one_that_catkin_builds(tmp_path: Path) -> None:
    status, out, err = await run("ros1", "--write-package", str(tmp_path))
    assert status == 0, err
    checked = await asyncio.create_subprocess_exec(
        PYTHON, "-c", CHECK_PACKAGE, str(tmp_path), stdout=PIPE, stderr=asyncio.subprocess.STDOUT
    )
    found, _ = await checked.communicate()
    assert checked.returncode == 0, found.decode()
    assert re.fullmatch(r"hostlink hostlink \d+\.\d+\.\d+ catkin \[\]\n", found.decode()), found.decode()
    package = tmp_path / "hostlink"
    written = sorted(str(each.relative_to(package)) for each in package.rglob("*") if each.is_file())
    assert written == ["CMakeLists.txt", "package.xml", "scripts/serial_node.py"]
    assert "install(PROGRAMS scripts/serial_node.py" in (package / "CMakeLists.txt").read_text()
    assert f"wrote {package}" in out


async def test_ros1_takes_the_arguments_of_serial_node(ros: Graph) -> None:
    port = free_port()
    async with ros1(ros, "tcp", str(port), "_baud:=115200") as daemon:
        assert (await daemon.read_log("daemon.started"))["tcp"].endswith(f":{port}")
        await daemon.read_log("ros1.master_found")
        assert await ros.lines("rosparam", "get", "/serial_node/baud") == ["115200"]


async def test_ros1_opens_the_serial_port_that_a_parameter_names(ros: Graph, tmp_path: Path) -> None:
    async with ros1(ros, f"_port:={tmp_path}/ttyACM0", "_baud:=115200") as daemon:
        waiting = await daemon.logged("serial.waiting")
        assert f"{tmp_path}/ttyACM0" in str(waiting)


@pytest.mark.long
async def test_rosnode_kill_ends_the_ros1_command(ros: Graph) -> None:
    async with ros1(ros, "--tcp", str(free_port())) as daemon:
        await daemon.read_log("ros1.master_found")
        await ros.lines("rosnode", "kill", "/serial_node")
        ended = await daemon.read_log("daemon.stop_requested")
        assert "/rosnode" in ended["cause"]
        async with asyncio.timeout(TIMEOUT_S):
            assert await daemon.child.wait() == 0


async def test_ros1_without_a_master_waits_for_the_one_that_may_know_its_port(ros: Graph) -> None:
    await ros.kill()
    port = free_port()
    async with ros1(ros) as daemon:
        await expect(lambda: "waiting for the master" in daemon.log_file.read_text())
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
        (("__name:=a/b",), "is not a node name"),
        (("__master:=localhost",), "http://localhost:11311"),
        (("__master:=http://localhost:99999",), "Port out of range"),
        (("--master", ""), "no address of a master"),
        (("tcp", "_number:=99999999999"), "the master refuses this parameter"),
        (("tcp", "--messages", "/nonexistent", "--master", "http://127.0.0.1:1"), "/nonexistent"),
    ],
)
async def test_ros1_with_a_wrong_argument_fails_with_one_line(ros: Graph, words: tuple[str, ...], text: str) -> None:
    err = await failed("--master", ros.url, *words)
    assert len(err.splitlines()) == 1
    assert text in err
