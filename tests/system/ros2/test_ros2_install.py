"""`hostlink ros2` without rclpy and with wrong arguments, and the daemon, which does not use rclpy."""

import subprocess
from pathlib import Path

import pytest

from tests.support.process import run, serve
from tests.support.ros2 import HOSTLINK as ROS2_HOSTLINK
from tests.support.ros2 import VENV


async def test_without_rclpy_one_line_says_what_to_do() -> None:
    status, out, err = await run("ros2")
    assert (status, out) == (1, "")
    assert len(err.splitlines()) == 1
    assert "source a ROS 2 installation" in err
    assert "pip install 'ros-rclpy[fastrtps]'" in err


@pytest.mark.parametrize("word", ["--nothing", "robot_0"])
async def test_ros2_with_an_unknown_option_names_it(word: str) -> None:
    status, _, err = await run("ros2", word)
    assert (status, len(err.splitlines())) == (2, 1)
    assert word in err


def test_arguments_that_ros_2_refuses_are_named() -> None:
    command = [ROS2_HOSTLINK, "ros2", "--ros-args", "-r", "nonsense"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert "--ros-args" in ended.stderr
    assert "Traceback" not in ended.stderr


async def test_a_daemon_beside_rclpy_imports_none_of_it(tmp_path: Path) -> None:
    log = tmp_path / "log"
    program = (str(VENV / "bin" / "python"), "-X", "importtime", ROS2_HOSTLINK)
    async with serve(log=log, program=program) as daemon:
        assert daemon.url
    imported = {line.split("|")[-1].strip() for line in log.read_text().splitlines() if line.startswith("import time")}
    assert "hostlink.core.transport.tcp" in imported
    assert [name for name in imported if name.startswith(("rclpy", "rcl_interfaces", "hostlink.components.ros2"))] == []
