"""`hostlink step` as a person and as a program use it."""

import asyncio
import json
import math
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from hostlink.client import RobotState, connect
from tests.support.fork_server import start
from tests.support.process import HOSTLINK, run, serve, simulated
from tests.support.screen import screen
from tests.support.waiting import TIMEOUT_S

pytestmark = pytest.mark.quiet  # a program that does not run for 0.4 s stops its robot


async def until(url: str, is_so: Callable[[RobotState], bool]) -> None:
    """Until the daemon shows the robot so."""
    async with connect(url) as host, asyncio.timeout(TIMEOUT_S):
        async for event in host.watch():
            if event.name == "robots" and any(is_so(state) for state in event.data["robots"]):
                return


async def test_a_step_is_driven_reported_and_drawn(tmp_path: Path) -> None:
    picture = tmp_path / "step.svg"
    step = ("step", "robot_0", "--speed", "0.05", "--seconds", "2", "--yes")
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        status, out, err = await run(*step, "--json", "--picture", str(picture), "--url", daemon.url)
        assert (status, err) == (0, "")
        view = json.loads(out)
        assert view["source"] == "/robot_0/plot_data"
        assert view["notes"] == []
        for wheel in ("left", "right"):
            figures = view["wheels"][wheel]["figures"]
            assert figures["target"] == pytest.approx(0.05 / (math.tau * 0.045 / 230.4), rel=0.001)
            assert figures["set_point_rise_s"] == pytest.approx(0.37, abs=0.06)
            assert len(view["wheels"][wheel]["samples"]["t_s"]) > 20
        assert "<svg" in picture.read_text()

        folder = tmp_path / "folder.png"
        folder.mkdir()
        status, out, err = await run(*step, "--wheel", "right", "--picture", str(folder), "--url", daemon.url)
        assert status == 0
        assert f"note: the picture {folder} cannot be written: Is a directory" in out
        assert err == (
            "robot_0's right wheel rolls 0.10 m forwards round the left one at up to 0.05 m/s for 2.0 s; "
            "keep a circle of 0.9 m free.\n"
        )
        assert "settled (within 5 %)" in out


async def test_tuning_proposes_gains_and_sends_them() -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        status, out, err = await run("step", "robot_0", "--tune", "--send", "--yes", "--json", "--url", daemon.url)
    assert status == 0, err
    view = json.loads(out)
    assert view["is_sent"]
    for wheel in view["wheels"].values():
        assert wheel["model"]["gain"] == pytest.approx(280 / 4095, rel=0.06)
        assert wheel["model"]["time_constant_s"] + wheel["model"]["dead_time_s"] == pytest.approx(0.46, abs=0.1)
        assert 10 < wheel["proposed"]["kp"] < 50
        assert wheel["present"]["is_configured"] is False


async def test_ctrl_c_ends_the_step_and_the_robot_is_stopped() -> None:
    async with serve() as daemon, simulated(daemon.tcp):
        await daemon.read_log("robot.appeared")
        child = await start("step", "robot_0", "--seconds", "30", "--yes", "--url", daemon.url)
        await until(daemon.url, lambda state: state["velocity"]["linear_m_s"] == 0.2)
        child.send_signal(signal.SIGINT)
        await until(daemon.url, lambda state: state["velocity"]["linear_m_s"] == 0 and state["holder"] is None)
        async with asyncio.timeout(TIMEOUT_S):
            assert await child.wait() == 130


async def test_an_error_begins_a_line_of_its_own() -> None:
    """Not behind what was written over again and again."""
    async with serve() as daemon, simulated(daemon.tcp), screen() as terminal, connect(daemon.url) as host:
        await daemon.read_log("robot.appeared")
        await terminal.keys(f"{HOSTLINK} step robot_0 --seconds 30 --yes --url {daemon.url}", "Enter")
        await terminal.shows("driving at 0.20 m/s")
        await host.robot("robot_0").lock("a cat")
        await terminal.shows("\nhostlink: robot_0: ")  # locked; or a velocity was late, on a busy machine


async def test_step_at_a_daemon_without_a_robot_fails_with_one_line() -> None:
    async with serve() as daemon:
        status, out, err = await run("step", "nobody", "--yes", "--url", daemon.url)
    assert (status, out, err.count("\n")) == (1, "", 1)
    assert err.startswith("hostlink: no robot has connected yet")
