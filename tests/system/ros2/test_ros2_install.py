"""`hostlink ros2` where rclpy is not, the tests where it cannot be had, and the daemon, which has no use for it."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.process import run, serve
from tests.support.ros2 import HOSTLINK as ROS2_HOSTLINK
from tests.support.ros2 import VENV, install


def test_a_test_that_cannot_have_rclpy_fails_and_says_so(tmp_path: Path) -> None:
    empty = f"PIP_CONFIG_FILE={os.devnull} PIP_NO_INDEX=1 PIP_FIND_LINKS={tmp_path}"
    environment = dict(word.split("=") for word in empty.split())
    with pytest.raises(pytest.fail.Exception, match=r"(?s)nothing of hostlink ros2 was tested.*cannot be installed"):
        install(f"ROS2_VENV={tmp_path / 'venv'}", environment={**os.environ, **environment})
    assert not (tmp_path / "venv" / ".installed").exists()


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
    install()
    command = [ROS2_HOSTLINK, "ros2", "--ros-args", "-r", "nonsense"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert ended.returncode == 2
    assert "--ros-args" in ended.stderr
    assert "Traceback" not in ended.stderr


async def test_a_daemon_beside_rclpy_imports_none_of_it(tmp_path: Path) -> None:
    install()
    log = tmp_path / "log"
    program = (str(VENV / "bin" / "python"), "-X", "importtime", ROS2_HOSTLINK)
    async with serve(log=log, program=program) as daemon:
        assert daemon.url
    imported = {line.split("|")[-1].strip() for line in log.read_text().splitlines() if line.startswith("import time")}
    assert "hostlink.transport.tcp" in imported
    assert [name for name in imported if name.startswith(("rclpy", "rcl_interfaces", "hostlink.graphs.ros2"))] == []
