"""The daemon as a service: what it tells systemd, and how a configuration is checked before it is used."""

import asyncio
import contextlib
import select
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hostlink.cli.serve_command import read_example
from hostlink.cli.systemd import Notifier
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import free_port, run, serve
from tests.support.stopwatch import Stopwatch
from tests.support.waiting import TIMEOUT_S

WATCHDOG_S = 0.4


class Systemd:
    """The end of the socket that systemd has."""

    def __init__(self, address: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self.socket.bind(address)

    async def received(self, wanted: str) -> str:
        """The next message with this line in it."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                message = (await asyncio.get_running_loop().sock_recv(self.socket, 4096)).decode()
                if wanted in message:
                    return message

    async def is_quiet_for(self, seconds: float) -> bool:
        """Return whether nothing more is received."""
        with contextlib.suppress(BlockingIOError):
            while self.socket.recv(4096):
                pass
        readable, _, _ = await asyncio.to_thread(select.select, [self.socket], [], [], seconds)
        return not readable


@pytest.fixture(params=["path", "abstract"])
def systemd(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Systemd, str]]:
    name = str(tmp_path / "notify")
    listener = Systemd(name if request.param == "path" else "\0" + name)
    yield listener, name if request.param == "path" else "@" + name
    listener.socket.close()


async def test_systemd_is_notified_of_the_start_of_each_heartbeat_and_of_the_stop(systemd: tuple[Systemd, str]) -> None:
    listener, address = systemd
    environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6))}
    async with serve(environment=environment) as daemon:
        await listener.received("READY=1")
        assert "STATUS=0 devices; robots: none" in await listener.received("WATCHDOG=1")
        async with fake_device(daemon.tcp, robot_topics()):
            await daemon.read_log("robot.appeared")
            watch = Stopwatch(daemon.pid)
            for _ in range(4):
                await listener.received("WATCHDOG=1")
            assert watch.seconds < 4 * WATCHDOG_S  # it is sent before it is due
            await listener.received("STATUS=1 device; robots: robot_0")
            daemon.child.send_signal(signal.SIGTERM)
            await listener.received("STOPPING=1")
            assert await daemon.child.wait() == 0


async def test_a_stopped_process_sends_nothing(systemd: tuple[Systemd, str]) -> None:
    """The heartbeat is the event loop's own."""
    listener, address = systemd
    async with serve(environment={"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "100000"}) as daemon:
        await listener.received("WATCHDOG=1")
        daemon.child.send_signal(signal.SIGSTOP)
        assert await listener.is_quiet_for(1.0)
        daemon.child.send_signal(signal.SIGCONT)
        await listener.received("WATCHDOG=1")


async def test_a_systemd_that_is_gone_stops_nothing(tmp_path: Path) -> None:
    async with serve(environment={"NOTIFY_SOCKET": str(tmp_path / "nobody"), "WATCHDOG_USEC": "10000"}) as daemon:
        async with fake_device(daemon.tcp, robot_topics()):
            await daemon.read_log("robot.appeared")
        assert await daemon.end(signal.SIGTERM) == 0


@pytest.mark.parametrize(
    ("environment", "interval_s"),
    [
        ({}, 10.0),
        ({"WATCHDOG_USEC": "6000000"}, 3.0),
        ({"WATCHDOG_USEC": "6000000", "WATCHDOG_PID": "1"}, 10.0),
        ({"WATCHDOG_USEC": "0"}, 10.0),
        ({"WATCHDOG_USEC": "soon"}, 10.0),
    ],
)
def test_the_watchdog_is_fed_twice_in_its_time(environment: dict[str, str], interval_s: float) -> None:
    assert Notifier(environment)._interval_s == interval_s


async def test_a_configuration_is_checked_without_being_served(tmp_path: Path) -> None:
    path = tmp_path / "hostlink.toml"
    port = free_port()
    path.write_text(f'[[serial]]\npath = "/dev/ttyACM0"\n[tcp]\nport = {port}\n[api]\nport = 9191\n')
    status, out, err = await run("serve", "--check-config", str(path))
    assert (status, err) == (0, "")
    assert "a device on /dev/ttyACM0 at 57600 baud\nprograms on http://127.0.0.1:9191\n" in out
    path.write_text("[tcp]\nprot = 1\n")
    status, out, err = await run("serve", "--check-config", str(path))
    assert (status, out) == (2, "")
    assert err == f"hostlink: {path}: unknown key tcp.prot; did you mean port?\n"
    assert await run("serve", "--config", str(path)) == (2, "", err)
    path.write_text("[tcp]\nport = 0\n[api]\nport = 0\n[robots.a]\naddress = '192.168.4'\n")
    status, out, err = await run("serve", "--check-config", str(path))
    assert (status, out.splitlines()[0].startswith("devices on TCP ")) == (0, True)
    problem = "is neither an IP address, with or without a port, nor the name of a [[serial]] port"
    assert err == f"warning: robots.a.address 192.168.4 {problem}\n"


async def test_an_example_is_printed_and_can_be_used(tmp_path: Path) -> None:
    status, out, _ = await run("serve", "--example", "config")
    assert status == 0
    path = tmp_path / "hostlink.toml"
    path.write_text(out)
    assert (await run("serve", "--check-config", str(path)))[0] == 0


def test_systemd_accepts_the_unit_and_finds_it_well_shut(tmp_path: Path) -> None:
    unit = tmp_path / "hostlink.service"
    hostlink = Path(sys.executable).with_name("hostlink")
    unit.write_text(read_example("systemd").replace("/opt/hostlink/bin/hostlink", str(hostlink)))
    for arguments in (["verify", "--man=no"], ["security", "--offline=yes", "--threshold=20"]):
        done = subprocess.run(
            [str(shutil.which("systemd-analyze")), *arguments, str(unit)], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        assert "hostlink.service:" not in done.stderr  # a key that it does not know is a warning there
