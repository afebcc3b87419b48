"""A thousand micro-ROS boards at one daemon, and a board among them that drives and stops.

Each publishes a message a second, and waits for its acknowledgement. The memory is compared with that of the same
daemon with one board.
"""

import asyncio
import json
import time
from pathlib import Path

import aiohttp
import pytest

from tests.support.background import meanwhile
from tests.support.precedence import GOES_FIRST
from tests.support.process import HOSTLINK, Process, free_port, serve
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import expect, expect_never
from tests.support.xrce_device import Device, stock, udp_board
from tools.bench import crowd, memory_mib

pytestmark = [pytest.mark.quiet, pytest.mark.long, pytest.mark.timeout(900)]
BOARDS = 1000
SECONDS = 20.0
BOARD_KIB = 160.0
STOP_S = 0.3
DRIVES = 5
ROBOT = "linorobot_base_node"


async def drive(host: Process) -> None:
    """Command the robot ten times a second; after a refusal with a zero first."""
    is_refused = False
    async with aiohttp.ClientSession() as session:
        while True:
            url, wanted = f"{host.url}/api/robots/{ROBOT}/velocity", 0.0 if is_refused else 0.2
            async with session.put(url, json={"linear": wanted, "angular": 0.0}) as response:
                is_refused = response.status == 409
                await response.read()
            await asyncio.sleep(0.1)


async def driven_and_stopped_s(host: Process, device: Device) -> float:
    """Drive the board, and stop it. Return the seconds until it took the zero, after which nothing moves it."""
    taken = device.stock.taken
    begun = len(taken)
    async with meanwhile(drive(host)):
        await expect(lambda: any(speed > 0.1 for _, speed in taken[begun:]))
    began_s, watch = time.monotonic(), Stopwatch(host.pid)
    await host.post(f"/api/robots/{ROBOT}/stop")
    await expect(lambda: taken[-1][1] == 0.0)
    kept_s = watch.kept_s
    await expect_never(lambda: taken[-1][1] != 0.0, for_s=0.5)
    moved_s = max(at_s for at_s, speed in taken if speed)
    return next(at_s for at_s, speed in taken if at_s > moved_s) - began_s - kept_s


async def test_board_among_a_thousand_drives_and_stops(tmp_path: Path) -> None:
    port = free_port()
    config = tmp_path / "hostlink.toml"
    config.write_text(f"[micro_ros.udp]\nport = {port}\nmax_connections = 1200\n")
    async with (
        serve(
            "--config", str(config), program=(*GOES_FIRST, HOSTLINK), environment={"XDG_STATE_HOME": str(tmp_path)}
        ) as host,
        udp_board(("127.0.0.1", port), stock(keeps=4, gives_up=False)) as device,
    ):
        await device.is_at_work()
        await driven_and_stopped_s(host, device)
        alone_mib = memory_mib(host.pid)
        async with crowd("boards", BOARDS, ("127.0.0.1", port), SECONDS) as output:
            links = (await host.get("/api/links"))["links"]
            robots = (await host.get("/api/robots"))["robots"]
            stops_s = [await driven_and_stopped_s(host, device) for _ in range(DRIVES)]
            counts = json.loads(await output.read())
            crowded_mib = memory_mib(host.pid, "VmHWM")
        board_kib = 1024 * (crowded_mib - alone_mib) / BOARDS
        failed = sum(not each.is_done for each in device.stock.published)
    print(  # noqa: T201
        f"{len(links)} links, {counts}; {alone_mib:.0f} MiB with one board, {crowded_mib:.0f} MiB, "
        f"{board_kib:.0f} KiB a board; "
        f"stopped after {[f'{1000 * each:.0f} ms' for each in stops_s]}, {failed} publishes failed"
    )
    assert len(links) == BOARDS + 1
    assert {each["protocol"] for each in links} == {"micro-ROS"}
    assert ROBOT in [each["name"] for each in robots]
    assert (
        counts["acknowledged"] >= BOARDS
    )  # a busy machine delays most; where it is quiet, it is SECONDS times as many
    assert board_kib < BOARD_KIB
    assert sorted(stops_s)[DRIVES // 2] < STOP_S
