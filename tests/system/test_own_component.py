"""The component of docs/components.md, installed as a package of its own."""

import asyncio
import contextlib
import json
import os
import re
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import aiohttp
import pytest

from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import HOSTLINK, Process, run, serve
from tests.support.waiting import expect

ROOT = Path(__file__).parents[2]


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """An environment in which a package with this component is installed."""
    package = tmp_path / "status_component-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: status-component\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[hostlink.components]\nstatus = tests.support.status_component:Status\n")
    return {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}


class Display:
    """The other side: a UDP port that receives the states, and may send a stop."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.states: list[dict[str, object]] = []
        self.component: tuple[str, int] | None = None

    @property
    def port(self) -> int:
        return int(self.socket.getsockname()[1])

    def receive(self) -> None:
        while True:
            try:
                data, self.component = self.socket.recvfrom(4096)
            except BlockingIOError:
                return
            except ConnectionRefusedError:  # its last datagram met a closed port
                continue
            self.states.append(json.loads(data))

    def send(self, data: bytes) -> None:
        assert self.component is not None
        self.socket.sendto(data, self.component)


@pytest.fixture
def display() -> Display:
    with contextlib.closing((made := Display()).socket):
        yield made


@contextlib.asynccontextmanager
async def served(tmp_path: Path, installed: dict[str, str], port: int) -> AsyncIterator[Process]:
    file = tmp_path / "hostlink.toml"
    file.write_text(f"[status]\nport = {port}\ninterval_s = 0.1\n")
    async with serve("--config", str(file), environment=installed, program=(HOSTLINK,)) as daemon:
        yield daemon


async def test_component_of_a_package_reads_states_and_stops_a_robot_that_a_program_drives(
    tmp_path: Path, installed: dict[str, str], display: Display
) -> None:
    async with served(tmp_path, installed, display.port) as daemon, fake_device(daemon.tcp, robot_topics()) as robot:
        await expect(lambda: display.receive() or any(each["connected"] for each in display.states))
        await daemon.put("/api/robots/robot_0/velocity", {"linear": 0.1})
        await robot.velocity_of((0.1, 0.0))
        display.send(b"what is this?")
        display.send(b"stop")
        await robot.velocity_of((0.0, 0.0))
        assert (await daemon.logged("status.stopped"))["robots"] == 1
        async with aiohttp.ClientSession() as session, session.get(daemon.url + "/metrics") as response:
            metrics = await response.text()
        (sent,) = re.findall(r'^hostlink_graph_events_total\{graph="status",what="sent"\} (.*)$', metrics, re.MULTILINE)
        assert float(sent) > 0


async def test_component_that_fails_is_reported_by_doctor_and_started_again(
    tmp_path: Path, installed: dict[str, str], display: Display
) -> None:
    """An address that no datagram can be sent from."""
    file = tmp_path / "hostlink.toml"
    file.write_text('[status]\nport = 9\nhost = "no-such-host.invalid"\n')
    async with serve("--config", str(file), environment=installed, program=(HOSTLINK,)) as daemon:
        assert (await daemon.logged("component.ended"))["component"] == "status"
        _, out, _ = await run("doctor", "--url", daemon.url)
        assert "a component has ended with an error" in out
        await daemon.logged("component.ended", 2)
        async with fake_device(daemon.tcp, robot_topics()) as robot:
            await robot.velocity_of((0.0, 0.0))  # the daemon serves on


async def test_settings_of_a_component_are_checked_as_others(tmp_path: Path, installed: dict[str, str]) -> None:
    file = tmp_path / "hostlink.toml"
    for text, status, shown in (
        ("[status]\nport = 9999\n", 0, "states of robots to udp://127.0.0.1:9999"),
        ('[status]\nport = 9999\nhost = "10.0.0.1"\n', 0, "warning: status: whoever receives at this address can stop"),
        ("[status]\nport = 99999\n", 2, "status.port: 99999 is not a port"),
        ("[status]\nprt = 1\n", 2, "unknown key status.prt; did you mean port?"),
        ("[status]\n", 2, "missing required field `port` - at `$.status`"),
    ):
        file.write_text(text)
        child = await asyncio.create_subprocess_exec(
            HOSTLINK, "serve", "--check-config", str(file), env={**os.environ, **installed},
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
        )  # fmt: skip
        out, _ = await child.communicate()
        assert (child.returncode, shown in out.decode()) == (status, True), out.decode()
