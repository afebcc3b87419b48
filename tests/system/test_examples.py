"""The programs in docs/examples, as a reader runs them, with a simulated robot."""

import ast
import asyncio
import contextlib
import csv
import math
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from hostlink.sim.robot import SimulatedRobot
from tests.support.process import serve
from tests.support.simulated import simulated_robot
from tests.support.waiting import expect

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
TIMEOUT_S = 40.0
SIDE_M = 0.1
FAR_CORNERS = [(SIDE_M, 0.0, math.pi / 2), (SIDE_M, SIDE_M, math.pi)]


async def run_example(name: str, *arguments: str) -> str:
    """Run an example; return what it prints."""
    child = await asyncio.create_subprocess_exec(
        sys.executable, str(EXAMPLES / name), *arguments, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    async with asyncio.timeout(TIMEOUT_S):
        out, err = await child.communicate()
    assert (child.returncode, err) == (0, b""), err.decode()
    return out.decode()


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[tuple[str, SimulatedRobot]]:
    async with serve() as daemon, simulated_robot(daemon.tcp) as robot:
        await daemon.read_log("robot.appeared")
        yield daemon.url, robot


@pytest.mark.parametrize("name", sorted(path.name for path in EXAMPLES.glob("*.py")))
async def test_help_says_how_to_start_the_example_without_arguments(name: str) -> None:
    printed = " ".join((await run_example(name, "--help")).split())
    assert f"start `hostlink demo`, then run `python {name}`" in printed


async def test_half_a_square_ends_at_the_far_corner() -> None:
    async with world() as (url, robot):
        printed = await run_example("square.py", str(SIDE_M), url, "2")
        assert abs(robot.speed_m_s) < 0.01
    corners = [ast.literal_eval(line) for line in printed.splitlines()]
    for corner, (x_m, y_m, theta_rad) in zip(corners, FAR_CORNERS, strict=True):
        assert math.hypot(corner["x_m"] - x_m, corner["y_m"] - y_m) < 0.05
        assert abs(math.remainder(corner["theta_rad"] - theta_rad, math.tau)) < 0.25


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
