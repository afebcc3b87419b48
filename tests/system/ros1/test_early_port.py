"""The port for devices is open before the daemon is imported: `hostlink serve` and `hostlink ros1`."""

import asyncio
import contextlib
import json
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from hostlink.core.protocol.rosserial.frame import Id
from tests.support.fake_device import FakeDevice, robot_topics
from tests.support.process import HOSTLINK, Process, free_port, run, started
from tests.support.ros1.debian import graph
from tests.support.ros1.fake import fake_master
from tests.support.waiting import TIMEOUT_S, expect

MEASURED = Path(__file__).parents[2] / "support" / "until_listening.py"
MOST = (
    5.0  # times the CPU of a bare server of asyncio; it is 3, and 16 with all imports before it; rosserial_python's 2
)
ROUNDS = 3  # the least of each counts: other tests use the processor, too


async def until_listening(*words: str, port: int) -> dict[str, Any]:
    """Return the report of `until_listening.py`."""
    command = (sys.executable, str(MEASURED), str(port), *words)
    child = await asyncio.create_subprocess_exec(*command, stdout=asyncio.subprocess.PIPE)
    async with asyncio.timeout(60):
        out, _ = await child.communicate()
    found: dict[str, Any] = json.loads(out)
    return found


def commands(port: int, master: str) -> dict[str, tuple[str, ...]]:
    """Return commands by name, each of which listens on this port."""
    api = ("--api", "127.0.0.1:0")
    return {
        "serve": ("serve", "--listen", f"127.0.0.1:{port}", *api),
        "ros1 with the port as an option": ("ros1", "--tcp", str(port), *api, "--master", master),
        "ros1 with the port as an argument": ("ros1", "tcp", str(port), *api, "--master", master),
        "ros1 with the port at the master": ("ros1", *api, "--master", master),
    }


@contextlib.asynccontextmanager
async def port_master(port: int) -> AsyncIterator[str]:
    """A master that knows on which port the node serves devices."""
    async with fake_master() as master:
        master.parameters = {"/serial_node/port": "tcp", "/serial_node/tcp_port": port}
        yield master.url


async def test_device_port_start_needs_little_more_cpu_than_a_bare_server_until_it_is_open() -> None:
    port = free_port()
    async with port_master(port) as master:
        words = {"bare": ("bare",), **commands(port, master)}
        least = dict.fromkeys(words, float("inf"))
        for _ in range(ROUNDS):  # in turns, so that a busy time is the same for all
            for name, command in words.items():
                found = await until_listening(*command, port=port)
                least[name] = min(least[name], found["cpu_s"])
    bare_s = least.pop("bare")
    ratios = {name: cpu_s / bare_s for name, cpu_s in least.items()}
    assert max(ratios.values()) < MOST, ratios


async def test_device_port_is_open_before_libraries_of_the_daemon_are_imported() -> None:
    port = free_port()
    async with port_master(port) as master:
        for command in commands(port, master).values():
            assert (await until_listening(*command, port=port))["heavy"] == []


@contextlib.asynccontextmanager
async def early_device(port: int) -> AsyncIterator[FakeDevice]:
    """One that tries to connect again and again, as firmware does, and has succeeded."""
    connection: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []
    async with asyncio.timeout(TIMEOUT_S):
        while not connection:
            try:
                connection.append(await asyncio.open_connection("127.0.0.1", port))
            except ConnectionRefusedError:
                await asyncio.sleep(0.005)
    try:
        yield FakeDevice(*connection[0])
    finally:
        connection[0][1].transport.abort()


@contextlib.asynccontextmanager
async def fresh(*words: str) -> AsyncIterator[Process]:
    """A program of its own, which imports all that it needs: a forked one has it."""
    async with started(*words, program=(sys.executable, HOSTLINK)) as process:
        yield process


async def test_device_that_connects_while_the_daemon_is_imported_is_served() -> None:
    port = free_port()
    async with fresh("serve", "--listen", f"127.0.0.1:{port}", "--api", "127.0.0.1:0") as daemon:
        async with early_device(port) as device:
            assert "daemon.started" not in daemon.log_file.read_text()
            async with asyncio.timeout(TIMEOUT_S):
                await device.announce(robot_topics())
            assert (await daemon.read_log("topics.negotiated"))["count"] == 3
        assert await daemon.end(signal.SIGTERM) == 0


async def test_device_that_connects_to_a_start_that_fails_is_disconnected() -> None:
    """Here the port for programs is in use; the error is the one of before."""
    port = free_port()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        taken_port = taken.getsockname()[1]
        words = ("serve", "--listen", f"127.0.0.1:{port}", "--api", f"127.0.0.1:{taken_port}")
        async with fresh(*words) as daemon:
            async with early_device(port) as device, asyncio.timeout(TIMEOUT_S):
                await device.closed()
            async with asyncio.timeout(TIMEOUT_S):
                assert await daemon.child.wait() == 2
            text = daemon.log_file.read_text()
    assert text.splitlines()[-1].startswith(f"hostlink: API port {taken_port}: is in use")


@pytest.mark.parametrize(
    "words", [("serve", "--listen", "127.0.0.1:{}"), ("ros1", "--tcp", "{}")], ids=["serve", "ros1"]
)
async def test_device_port_that_is_in_use_is_one_line_that_names_it(words: tuple[str, ...], tmp_path: Path) -> None:
    async with graph(tmp_path) as ros:
        with socket.create_server(("0.0.0.0", 0)) as taken:
            port = taken.getsockname()[1]
            status, _, err = await run(
                *(word.format(port) for word in words), "--api", "127.0.0.1:0",
                environment={"ROS_MASTER_URI": ros.url, "ROS_IP": "127.0.0.1"},
            )  # fmt: skip
    assert status == 2
    assert err.splitlines()[-1].startswith("hostlink: TCP ")
    assert f":{port}: is in use, probably by another rosserial host" in err


async def test_device_port_is_closed_while_the_master_is_waited_for(tmp_path: Path) -> None:
    """Devices would wait at a port that is not served. Once the master is there, the port is opened again."""
    port = free_port()
    async with graph(tmp_path) as ros:
        await ros.kill()
        environment = {**os.environ, "ROS_MASTER_URI": ros.url, "ROS_IP": "127.0.0.1"}
        async with started("ros1", "--tcp", str(port), "--api", "127.0.0.1:0", environment=environment) as daemon:
            await expect(lambda: "waiting for the master" in daemon.log_file.read_text())
            with pytest.raises(ConnectionRefusedError):
                await asyncio.open_connection("127.0.0.1", port)
            await ros.start()
            async with early_device(port) as device, asyncio.timeout(TIMEOUT_S):
                await device.frame(Id.PUBLISHER)
            assert await daemon.end(signal.SIGTERM) == 0
