"""Modules are imported at the start of the daemon: a later import needs a descriptor, and may find none free."""

import asyncio
import signal
import sys
from pathlib import Path

import aiohttp

from tests.support.fake_device import fake_device, pose, robot_topics
from tests.support.process import HOSTLINK, Process, run, serve
from tests.support.waiting import TIMEOUT_S

TRACED = (sys.executable, "-X", "importtime", HOSTLINK)
PATHS = ["/", "/metrics", "/readyz", "/nothing"]
API = ["robots", "robots/robot_0", "robots/robot_0/odometry", "links", "topics", "clients", "openapi.json"]


async def test_daemon_that_runs_imports_nothing_more(tmp_path: Path) -> None:
    log = tmp_path / "log"
    async with serve(log=log, program=TRACED) as daemon:
        await use(daemon)
        assert await daemon.end(signal.SIGTERM) == 0
    late = log.read_text().split("daemon.started")[1].splitlines()
    assert any("daemon.stopped" in line for line in late)
    assert [line for line in late if line.startswith("import time")] == []


async def test_daemon_without_a_graph_imports_nothing_of_one(tmp_path: Path) -> None:
    log = tmp_path / "log"
    async with serve(log=log, program=TRACED) as daemon, fake_device(daemon.tcp, robot_topics()):
        assert await daemon.end(signal.SIGTERM) == 0
    lines = log.read_text().splitlines()
    assert any("hostlink.core.hub.hub" in line for line in lines)
    assert [
        line for line in lines if any(name in line for name in ("hostlink.components.graphs", "xmlrpc", "zenoh"))
    ] == []


async def use(daemon: Process) -> None:
    """Devices, good and bad, and programs."""
    url = daemon.url
    async with (
        fake_device(daemon.tcp, robot_topics()) as device,
        fake_device(daemon.tcp, local_host="127.0.0.9") as garbage,
        aiohttp.ClientSession() as session,
    ):
        await garbage.send(bytes(range(32, 127)) * 20)
        for number in range(10):
            await device.send(pose(number / 100))
            await asyncio.sleep(0.05)
        for path in (*PATHS, *(f"/api/{name}" for name in API)):
            async with session.get(url + path) as response:
                await response.read()
        async with session.put(f"{url}/api/robots/robot_0/velocity", json={"linear": 0.1, "angular": 0}) as response:
            assert response.status == 200
        assert (await run("doctor", "--url", url))[0] in (0, 1)
        async with session.ws_connect(url) as program:
            await program.send_json({"op": "subscribe", "topic": "/robot_0/odometry", "compression": "cbor"})
            await program.send_json({"op": "call_service", "id": 1, "service": "/rosapi/get_time"})
            assert (await program.receive()).data  # so the subscription has arrived, too
            await device.send(pose(1.0))
            async with asyncio.timeout(TIMEOUT_S):
                assert (await program.receive()).data
        await daemon.read_log("link.diagnosed")  # the garbage, of which a thread has thought
