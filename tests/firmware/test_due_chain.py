"""The paper's chain on one PC: hostlink, the ESP8266's sketch, a 38400 baud line, the Due's firmware and its motors.

The firmware runs natively, and on a Cortex-M3 that QEMU emulates; with the ESP8266 between, and without.
"""

import asyncio
import signal
import socket
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from hostlink.workbench.sim.firmware_module import WorldParameters
from tests.firmware import esp8266
from tests.firmware.boards import Board, board, chain, drive
from tests.support.process import serve
from tests.support.stopwatch import Stopwatch

pytestmark = pytest.mark.usefixtures("esp8266_built")

PATIENCE_S = 60.0  # only a defect reaches it
EMULATED = pytest.param("cortex-m3", marks=pytest.mark.long)  # the first test emulates the Cortex-M3 in each run
KINDS = pytest.mark.parametrize("kind", ["native", EMULATED])


async def expect_stop(made: Board) -> None:
    """Within 0.6 s of the last command by the board's own clock: the watchdog's 0.5 s, and the brakes."""
    await made.expect_speed(-2.0, 2.0, within_s=2.2)
    assert 500 <= made.facts["rolled_ms"] - made.facts["got_ms"] <= 600


@pytest.mark.parametrize(
    ("kind", "with_esp"),
    [
        pytest.param("native", False, marks=pytest.mark.long),
        ("cortex-m3", True),
        pytest.param("cortex-m3", False, marks=pytest.mark.long),
    ],
)
async def test_the_chain_negotiates_drives_reads_back_and_stops(kind: str, with_esp: bool) -> None:
    async with chain(kind, with_esp=with_esp) as (daemon, made):
        negotiated = await daemon.read_log("topics.negotiated")
        assert (negotiated["count"], negotiated["gap_at"]) == (8, None)
        await daemon.read_log("robot.appeared")
        await drive(daemon, made, 0.3, until_ticks_s=80.0)
        async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/api/robots/robot_0") as response:
            observed = await response.json()
        assert observed["odometry"]["pose"]["x_m"] > 0.05
        assert abs(observed["odometry"]["pose"]["y_m"]) < 0.05
        assert observed["odometry"]["rate_hz"] == pytest.approx(10.0, abs=2.5)
        await made.expect_speed(-2.0, 2.0, within_s=3.0)  # the lease ended: 0.5 s, the wheel, the report
        assert await daemon.end(signal.SIGTERM) == 0
    closed = [line for line in daemon.log if line["event"] == "link.trouble"]
    assert closed == []


@pytest.mark.long
@KINDS
async def test_the_board_runs_in_the_world_that_it_is_given(kind: str, tmp_path: Path) -> None:
    """With a left wheel that is a tenth larger, straight by the odometry is a curve to the right."""
    world = WorldParameters({"battery_v": 11.5, "left.radius_m": 0.0495})
    file = tmp_path / "world.txt"
    file.write_text(world.text())
    async with chain(kind, with_esp=False, world=file) as (daemon, made):
        await daemon.read_log("robot.appeared")
        await drive(daemon, made, 0.3, until_ticks_s=150.0)
        async with aiohttp.ClientSession() as session, session.get(f"{daemon.url}/api/robots/robot_0") as response:
            believed = (await response.json())["odometry"]["pose"]
        assert made.facts["battery_mv"] == 11500
        assert made.facts["theta_mrad"] < -0.3 * made.facts["rolled_mm"]  # 0.1 / 0.21 m, less the slow start
        assert abs(believed["theta_rad"]) < 0.05


@KINDS
async def test_a_killed_host_leaves_the_robot_standing(kind: str, tmp_path: Path) -> None:
    """Without a guardian: the robot's own watchdog."""
    config = tmp_path / "hostlink.toml"
    config.write_text("guardian = false\n")
    async with chain(kind, "--config", str(config), with_esp=True) as (daemon, made):
        await daemon.read_log("robot.appeared")
        await drive(daemon, made, 0.3, until_ticks_s=80.0)
        daemon.child.kill()
        await expect_stop(made)


@KINDS
async def test_a_killed_hosts_guardian_stops_the_robot_before_its_watchdog(kind: str) -> None:
    async with chain(kind, with_esp=True) as (daemon, made):
        await daemon.read_log("robot.appeared")
        guardian = int((await daemon.logged("guardian.started"))["pid"])
        await drive(daemon, made, 0.3, until_ticks_s=80.0)
        watch = Stopwatch(guardian)
        daemon.child.kill()
        await made.expect_speed(-2.0, 2.0, within_s=2.2)
        kept_ms = 1000 * watch.kept_s  # from running, by other programs of the machine
        assert made.facts["rolled_ms"] - made.facts["got_ms"] < 500 + kept_ms  # the last message is the guardian's zero


@pytest.mark.long  # tests/firmware/test_esp8266_process.py has the host that was away
@pytest.mark.parametrize(("kind", "number"), [("native", signal.SIGTERM), ("cortex-m3", signal.SIGKILL)])
async def test_host_that_reconnects_drives_again_within_three_seconds(kind: str, number: signal.Signals) -> None:
    async with chain(kind, with_esp=True) as (daemon, made):
        await daemon.read_log("robot.appeared")
        await drive(daemon, made, 0.3, until_ticks_s=50.0)
        port = daemon.tcp[1]
        await daemon.end(number)
        async with serve("--listen", f"127.0.0.1:{port}") as again:
            watch = Stopwatch(again.pid)
            await again.read_log("robot.appeared")
            assert watch.seconds < 3.0
            await drive(again, made, 0.3, until_ticks_s=50.0)


@KINDS
async def test_killed_passthrough_stops_the_robot_and_reconnects(kind: str) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        uart_port = free.getsockname()[1]
    async with serve() as daemon:
        options = ("--uart", f"listen:{uart_port}")
        with esp8266.running("esp8266_native", daemon.tcp[1], *options) as first:
            async with board(kind, uart_port) as made:
                await daemon.read_log("robot.appeared")
                await drive(daemon, made, 0.3, until_ticks_s=80.0)
                first.signal(signal.SIGKILL)
                await expect_stop(made)
                with esp8266.running("esp8266_native", daemon.tcp[1], *options):
                    watch = Stopwatch(daemon.pid)
                    await daemon.read_log("robot.appeared")
                    assert watch.seconds < 3.0
                    await drive(daemon, made, 0.3, until_ticks_s=50.0)


async def test_a_device_that_restarts_is_driven_again_within_ten_seconds() -> None:
    """A battery that fails, or a watchdog: neither the passthrough nor the host is informed."""
    async with serve() as daemon:
        with esp8266.running("esp8266_native", daemon.tcp[1]) as sketch:
            async with board("native", sketch.uart_port) as made:
                await daemon.read_log("robot.appeared")
                await drive(daemon, made, 0.3, until_ticks_s=50.0)
            watch = Stopwatch(daemon.pid)
            async with board("native", sketch.uart_port) as made:
                await drive(daemon, made, 0.3, until_ticks_s=50.0)
            assert watch.seconds < 10.0


async def test_the_robot_shows_its_battery_its_errors_and_a_weak_wifi() -> None:
    async with serve() as daemon, aiohttp.ClientSession() as session:
        with esp8266.running("esp8266_native", daemon.tcp[1], "--signal", "-85") as sketch:
            async with board("native", sketch.uart_port), asyncio.timeout(PATIENCE_S):
                await daemon.read_log("robot.appeared")
                found: dict[str, Any] = {}
                while not {"weak_signal"} <= {each["code"] for each in found.get("diagnosis", [])}:
                    await asyncio.sleep(0.2)
                    async with session.get(f"{daemon.url}/api/links") as response:
                        found = (await response.json())["links"][0]
                assert found["signal_dbm"] == -85
                assert (found["skipped_bytes"], found["unknown_ids"]) == (0, 0)
                counts: dict[str, int] = {}
                while min(counts.get(name, 0) for name in ("/robot_0/battery", "/robot_0/errors")) < 2:
                    await asyncio.sleep(0.2)
                    async with session.get(f"{daemon.url}/api/topics") as response:
                        counts = {each["name"]: each["messages"] for each in (await response.json())["topics"]}


async def test_the_host_s_configuration_gives_each_wheel_its_size(tmp_path: Path) -> None:
    config = tmp_path / "hostlink.toml"
    config.write_text(
        "[parameters]\n"
        '"/robot_0/wheel_radius" = [0.0449, 0.0453]\n'
        '"/robot_0/ticks_per_turn" = [230, 231]\n'
        '"/robot_0/wheel_separation" = 45.0\n'
    )
    texts: list[str] = []
    async with chain("native", "--config", str(config), with_esp=False) as (daemon, _), asyncio.timeout(PATIENCE_S):
        while len(texts) < 4:
            texts.append((await daemon.read_log("device.logged"))["text"])
    assert texts == [
        "robot is ready",
        "wheel_separation refused: 1 number from 0.020 to 5.0",
        "wheel radius 44.900 and 45.300 mm, 210.00 mm apart",
        "ticks a turn 230.000 and 231.000",
    ]
