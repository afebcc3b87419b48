"""The daemon as a process: signals, ports that are taken, a serial device."""

import asyncio
import json
import signal

import aiohttp
import pytest

from hostlink.workbench.sim.robot import SimulatedRobot
from hostlink.workbench.sim.run import run_over_streams
from tests.support.driving import put_velocity
from tests.support.process import HOSTLINK, free_port, run, serve, simulated
from tests.support.pty_pair import pty_streams
from tests.support.screen import screen

STOP_S = 0.6  # a robot's own watchdog is 0.5 s, looked at each thirtieth of a second


async def drive(url: str, linear: float, angular: float) -> None:
    """Send a velocity to robot_0 until it is obeyed."""
    async with aiohttp.ClientSession() as session:
        body = json.dumps({"linear": linear, "angular": angular}).encode()
        await put_velocity(session, f"{url}/api/robots/robot_0", body)


@pytest.mark.quiet
async def test_a_killed_daemon_leaves_a_simulated_robot_standing() -> None:
    """kill -9: no orderly end; the robot's own watchdog is what stops it."""
    async with serve() as daemon, asyncio.TaskGroup() as tasks:
        robot = SimulatedRobot("robot_0")
        reader, writer = await asyncio.open_connection(*daemon.tcp)
        running = tasks.create_task(run_over_streams(robot, reader, writer))
        await daemon.read_log("robot.appeared")
        while robot.speed_m_s < 0.05:
            await drive(daemon.url, 0.3, 0.0)
            await asyncio.sleep(0.1)
        killed_s = asyncio.get_running_loop().time()
        daemon.child.kill()
        await daemon.child.wait()
        await running
    assert robot.is_configured  # it has not noticed yet, and will not for 11 s
    robot.advance(killed_s + STOP_S)
    assert [wheel.pwm for wheel in robot.world.wheels] == [0, 0]
    robot.advance(killed_s + STOP_S + 1.0)  # it rolls out
    assert robot.speed_m_s < 0.01


async def test_a_serial_device_does_the_same() -> None:
    """The simulated robot on one end of a pseudo terminal, the daemon on the other."""
    robot = SimulatedRobot("robot_0")
    async with (
        pty_streams() as (reader, writer, path),
        serve("--serial", f"{path}@57600") as daemon,
        asyncio.TaskGroup() as tasks,
    ):
        running = tasks.create_task(run_over_streams(robot, reader, writer))
        assert daemon.lines("daemon.started")[0]["serial"] == [path]
        appeared = await daemon.logged("robot.appeared")
        assert appeared["peer"] == path
        while robot.world.odometry.x_m < 0.05:
            await drive(daemon.url, 0.3, 0.0)
            await asyncio.sleep(0.1)
        assert (await daemon.get("/api/robots/robot_0/odometry"))["pose"]["x_m"] > 0.0
        assert await daemon.end(signal.SIGTERM) == 0
        running.cancel()


async def test_a_port_in_use_is_one_line_and_status_2_and_starts_no_guardian() -> None:
    async with serve() as daemon:
        address = "{}:{}".format(*daemon.tcp)
        status, _, complaint = await run("serve", "--listen", address, "--api", "127.0.0.1:0")
        assert (status, "guardian.started" in complaint) == (2, False)
        assert complaint.splitlines()[-1].startswith(f"hostlink: TCP {address}: is in use")
        status, _, complaint = await run(
            "serve", "--listen", "127.0.0.1:0", "--api", daemon.url.removeprefix("http://")
        )
        assert (status, "guardian.started" in complaint) == (2, False)
        assert "choose another port with --api" in complaint


async def test_serve_on_a_terminal_shows_the_page_and_when_a_robot_is_ready() -> None:
    api, tcp = (f"127.0.0.1:{free_port()}" for _ in range(2))
    async with screen(columns=120) as terminal:
        await terminal.keys(f"{HOSTLINK} serve --api {api} --listen {tcp}", "Enter")
        shown = await terminal.shows(f"boards connect to {tcp}; Ctrl-C ends hostlink")
        assert f"hostlink runs: http://{api}  (open it in a browser)" in shown
        host, _, port = tcp.partition(":")
        async with simulated((host, int(port))):
            shown = await terminal.shows(f"robot_0 is ready; to drive it: hostlink teleop robot_0 --url http://{api}")
            assert "link.opened" not in shown
        await terminal.keys("C-c")
        await terminal.shows("hostlink has ended")
