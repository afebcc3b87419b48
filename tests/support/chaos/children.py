"""The processes of a run: the daemon, the generator, the honest robot; none outlives its block."""

import asyncio
import contextlib
import json
import resource
import sys
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.support.chaos.names import HONEST, HONEST_ADDRESS, VERIFIED_ADDRESSES
from tests.support.process import HOSTLINK

ROOT = Path(__file__).resolve().parents[3]
START_S = 20.0
POLL_S = 0.02
DESCRIPTORS = 1024  # what a process usually has
LINE_BYTES = 1 << 20
CONFIG = f"""
[robots.{HONEST}]
address = "{HONEST_ADDRESS}"

[black_box]
max_memory_mb = 2  # its bound is reached, too

[parameters]
gain = [1.0, 2.0]
"""
UDP_CONFIG = f"""
[udp]
host = "127.0.0.1"
port = 0
trusted = {json.dumps([f"{address}/32" for address in (HONEST_ADDRESS, *VERIFIED_ADDRESSES)])}
"""


@dataclass
class Daemon:
    """A running `hostlink serve`; its log goes to a file."""

    child: asyncio.subprocess.Process
    log: Path
    tcp: tuple[str, int] = ("", 0)
    api: tuple[str, int] = ("", 0)
    udp: tuple[str, int] | None = None

    async def started(self) -> None:
        """Wait until it has printed where it listens."""
        async with asyncio.timeout(START_S):
            while not (found := _started(self.log)):
                if self.child.returncode is not None:
                    raise RuntimeError(f"the daemon did not start: {self.log.read_text()[-2000:]}")
                await asyncio.sleep(POLL_S)
        self.tcp, self.api = (_address(found[key].removeprefix("http://")) for key in ("tcp", "api"))
        self.udp = _address(found["udp"]) if "udp" in found else None


def _started(log: Path) -> dict[str, Any] | None:
    for line in log.read_text().splitlines():
        if '"daemon.started"' in line:
            found: dict[str, Any] = json.loads(line)
            return found
    return None


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rstrip("/").rpartition(":")
    return host, int(port)


@contextlib.asynccontextmanager
async def daemon(folder: Path, *, has_udp: bool) -> AsyncIterator[Daemon]:
    """`hostlink serve` on free ports, with as many descriptors as a process usually has."""
    config, log = folder / "hostlink.toml", folder / "daemon.log"
    config.write_text(CONFIG + (UDP_CONFIG if has_udp else ""))
    with log.open("wb") as stderr:
        child = await asyncio.create_subprocess_exec(
            HOSTLINK, "serve", "--config", str(config), "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0",
            stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=stderr,
        )  # fmt: skip
    resource.prlimit(child.pid, resource.RLIMIT_NOFILE, (DESCRIPTORS, DESCRIPTORS))
    running = Daemon(child, log)
    try:
        await running.started()
        yield running
    finally:
        if child.returncode is None:
            child.kill()
        await child.wait()


class Talker:
    """A child of the harness's own that speaks JSON lines; its end is an EOFError."""

    def __init__(self, child: asyncio.subprocess.Process) -> None:
        self.child = child
        self.heard_s = time.monotonic()

    def send(self, request: dict[str, Any]) -> None:
        if self.child.stdin is not None:
            self.child.stdin.write(json.dumps(request).encode() + b"\n")

    async def receive(self) -> Any:
        """The next line."""
        if self.child.stdout is None:
            raise RuntimeError("a pipe is needed")
        line = await self.child.stdout.readline()
        if not line.endswith(b"\n"):
            raise EOFError(f"a process of the harness ended, status {await self.child.wait()}")
        self.heard_s = time.monotonic()
        return json.loads(line)


@contextlib.asynccontextmanager
async def talker(module: str, *arguments: str) -> AsyncIterator[Talker]:
    """A module of this package as a process; it is killed at the end of the block."""
    child = await asyncio.create_subprocess_exec(
        sys.executable, "-m", f"tests.support.chaos.{module}", *arguments,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, cwd=ROOT, limit=LINE_BYTES,
    )  # fmt: skip
    try:
        yield Talker(child)
    finally:
        if child.returncode is None:
            child.kill()
        try:
            await child.communicate()
        finally:
            child._transport.close()  # type: ignore[attr-defined]  # its pipes, too, when this wait is given up
