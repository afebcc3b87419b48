"""hostlink as a process of its own, as its users run it."""

import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import sys
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.support.fork_server import Child, start
from tests.support.waiting import expect

HOSTLINK = str(Path(sys.executable).parent / "hostlink")
TIMEOUT_S = 20.0
FIRST_PORT, PORTS = 20_000, 1200  # for each of ten workers
_given: set[int] = set()


def free_port() -> int:
    """A TCP port that nobody listens on, below those that the system gives to connections: it stays free.

    Each worker of the tests has a range of its own, and gives no port twice.
    """
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw9").removeprefix("gw")) % 10
    for _ in range(PORTS):
        port = FIRST_PORT + worker * PORTS + random.SystemRandom().randrange(PORTS)
        if port in _given:
            continue
        with contextlib.suppress(OSError), socket.create_server(("127.0.0.1", port)):
            _given.add(port)
            return port
    raise OSError("no port is free")


@dataclass
class Process:
    """A running `hostlink serve`; its log is read as it comes."""

    child: Child | asyncio.subprocess.Process
    tcp: tuple[str, int] = ("", 0)
    url: str = ""
    log: list[dict[str, Any]] = field(default_factory=list)

    async def read_log(self, until: str) -> dict[str, Any]:
        """The first line of this event from here on."""
        assert self.child.stderr is not None
        async with asyncio.timeout(TIMEOUT_S):
            while line := await self.child.stderr.readline():
                self.log.append(json.loads(line))
                if self.log[-1]["event"] == until:
                    return self.log[-1]
        raise EOFError(f"the daemon ended without {until}: {self.log}")

    async def end(self, number: signal.Signals) -> int:
        """Send a signal; returns the exit status."""
        self.child.send_signal(number)
        async with asyncio.timeout(TIMEOUT_S):
            return await self.child.wait()


@contextlib.asynccontextmanager
async def serve(
    *arguments: str, environment: Mapping[str, str] | None = None, program: tuple[str, ...] = ()
) -> AsyncIterator[Process]:
    """`hostlink serve` on free ports, killed at the end of the block if it still runs; forked without a `program`."""
    words = ("serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0", *arguments)
    environment = {**os.environ, **(environment or {})}
    child: Child | asyncio.subprocess.Process
    if program:
        child = await asyncio.create_subprocess_exec(*program, *words, stderr=PIPE, env=environment)
    else:
        child = await start(*words, stderr=PIPE, environment=environment)
    process = Process(child)
    try:
        started = await process.read_log("daemon.started")
        host, _, port = started["tcp"].rpartition(":")
        process.tcp, process.url = (host, int(port)), started["api"]
        yield process
    finally:
        if child.returncode is None:
            child.kill()
        await child.communicate()


@contextlib.asynccontextmanager
async def serve_into(log: Path, *arguments: str, program: tuple[str, ...] = (HOSTLINK,)) -> AsyncIterator[Process]:
    """`hostlink serve` whose log goes into a file."""
    with log.open("wb") as stderr:
        child = await asyncio.create_subprocess_exec(
            *program, "serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0", *arguments, stderr=stderr
        )
    try:
        await expect(lambda: b"daemon.started" in log.read_bytes(), timeout_s=TIMEOUT_S)
        started = _started(log)
        host, _, port = started["tcp"].rpartition(":")
        yield Process(child, (host, int(port)), started["api"])
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


def _started(log: Path) -> Any:
    return next(json.loads(line) for line in log.read_bytes().splitlines() if b"daemon.started" in line)


async def run(
    *arguments: str, input_text: str = "", environment: Mapping[str, str] | None = None
) -> tuple[int, str, str]:
    """Run a hostlink command to its end: (status, standard output, standard error)."""
    environment = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", **(environment or {})}
    child = await start(*arguments, given=input_text.encode(), stdout=PIPE, stderr=PIPE, environment=environment)
    async with asyncio.timeout(TIMEOUT_S):
        out, err = await child.communicate()
    assert child.returncode is not None
    return child.returncode, out.decode(), err.decode()


@contextlib.asynccontextmanager
async def simulated(address: tuple[str, int], *arguments: str) -> AsyncIterator[Child]:
    """`hostlink sim` against this daemon, for the length of the block."""
    child = await start("sim", "--connect", "{}:{}".format(*address), *arguments, stderr=PIPE)
    try:
        yield child
    finally:
        if child.returncode is None:
            child.terminate()
        await child.communicate()
