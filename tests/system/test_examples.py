"""The programs in docs/examples, as a reader runs them, with a simulated robot."""

import ast
import asyncio
import contextlib
import csv
import math
import re
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from hostlink.workbench.sim.robot import SimulatedRobot
from tests.support.process import serve
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
TIMEOUT_S = 40.0
SIDE_M = 0.1


async def run_example(name: str, *arguments: str) -> str:
    """Run an example, which explains itself; return what it prints then."""
    printed = await printed_by(name, *arguments)
    explanation = ast.get_docstring(ast.parse((EXAMPLES / name).read_text(encoding="utf-8")), clean=False)
    assert explanation is not None
    assert printed.startswith(explanation)
    return printed.removeprefix(explanation).lstrip()


async def printed_by(name: str, *arguments: str, status: int = 0, error: str = "") -> str:
    """Run an example; return its output."""
    child = await asyncio.create_subprocess_exec(
        sys.executable, str(EXAMPLES / name), *arguments, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    async with asyncio.timeout(TIMEOUT_S):
        out, err = await child.communicate()
    assert child.returncode == status
    assert re.fullmatch(error, err.decode()), err.decode()
    return out.decode()


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[tuple[str, SimulatedRobot]]:
    async with serve() as daemon, simulated_robot(daemon.tcp) as robot:
        await daemon.read_log("robot.appeared")
        yield daemon.url, robot


each_example = pytest.mark.parametrize(
    "name",
    [
        name if name == "square.py" else pytest.param(name, marks=pytest.mark.long)
        for name in sorted(path.name for path in EXAMPLES.glob("*.py"))
    ],
)


@each_example
async def test_help_says_how_to_start_the_example_without_arguments(name: str) -> None:
    printed = " ".join((await printed_by(name, "--help")).split())
    assert f"start `hostlink demo`, then run `python {name}`" in printed


@each_example
async def test_example_without_a_daemon_names_the_next_step_in_one_line(name: str, tmp_path: Path) -> None:
    arguments = {"circle.py": ["5"], "square.py": ["0.1"], "record_odometry.py": [str(tmp_path / "a.csv"), "5"]}
    line = r"no hostlink at http://127.0.0.1:1: [^\n]*`hostlink demo` runs one with a robot\n"
    await printed_by(name, *arguments.get(name, []), "http://127.0.0.1:1", status=1, error=line)


async def test_a_side_and_a_corner_of_a_square_are_driven() -> None:
    async with world() as (url, robot):
        printed = await run_example("square.py", str(SIDE_M), url, "1")
        assert abs(robot.speed_m_s) < 0.01
        pose = robot.world.odometry
    assert [line.partition(":")[0] for line in printed.splitlines()] == ["reached"] * 2
    numbers = [[float(each) for each in re.findall(r"(-?[\d.]+) (?:m|rad)", line)] for line in printed.splitlines()]
    assert numbers[0][0] == pytest.approx(SIDE_M, abs=0.03)
    assert numbers[1][1] == pytest.approx(math.pi / 2, abs=0.2)
    assert math.dist(pose[:2], (SIDE_M, 0.0)) < 0.05
    assert pose.theta_rad == pytest.approx(math.pi / 2, abs=0.2)


async def test_odometry_is_recorded(tmp_path: Path) -> None:
    async with world() as (url, _):
        await run_example("record_odometry.py", str(tmp_path / "odometry.csv"), "10", url)
    with (tmp_path / "odometry.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 10
    stamps_s = [float(row["stamp_s"]) for row in rows]
    assert stamps_s == sorted(set(stamps_s))
    assert {float(row["x_m"]) for row in rows} == {0.0}


async def test_any_topic_is_listed_subscribed_published_and_called() -> None:
    async with world() as (url, _):
        printed = await run_example("any_topic.py", url)
    assert "/robot_0/velocity_commands: geometry_msgs/Twist" in printed
    assert printed.splitlines()[-3:] == ["robot_0 is at 0.00, 0.00", "hello", "geometry_msgs/Pose2D"]


async def test_a_part_of_a_circle_is_driven_without_asyncio() -> None:
    async with world() as (url, robot):
        printed = await run_example("circle.py", "20", url)
        await expect(lambda: abs(robot.speed_m_s) < 0.01)
    lines = printed.splitlines()
    assert len(lines) == 20
    assert lines[0] != lines[-1]
    assert all(line.endswith("degrees") for line in lines)
