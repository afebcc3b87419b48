"""The processes of a run: the daemon, the generator, the honest robot; none outlives its block."""

import asyncio
import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.support.chaos.names import HONEST, HONEST_ADDRESS, VERIFIED_ADDRESSES
from tests.support.core_part import CorePart, children_of
from tests.support.process import HOSTLINK, free_port
from tests.support.zenoh_certificates import make_authority, make_certificate

ROOT = Path(__file__).resolve().parents[3]
START_S = 20.0
POLL_S = 0.02
DESCRIPTORS = 1024  # what a process usually has
LINE_BYTES = 1 << 20
CONFIG = f"""
[robots.{HONEST}]
address = "{HONEST_ADDRESS}"

[recording]
folder = "recordings"

[black_box]
max_memory_mb = 2  # its bound is reached, too
after_s = 2.0  # incidents are saved while it runs
max_disk_mb = 20

[parameters]
gain = [1.0, 2.0]
"""
UDP_CONFIG = f"""
[{{table}}]
host = "127.0.0.1"
port = {{port}}
trusted = {json.dumps([f"{address}/32" for address in (HONEST_ADDRESS, *VERIFIED_ADDRESSES)])}
"""
MICRO_ROS_CONFIG = """
[micro_ros.tcp]
port = {port}
"""
FLEET_CONFIG = """
[zenoh]
name = "lab"
listen = ["tls/127.0.0.1:{port}"]
ca = "fleet/ca.pem"
certificate = "fleet/lab.pem"
key = "fleet/lab.key"
"""
WALL_CLOCK = Path(__file__).with_name("wall_clock.c")


@dataclass
class Daemon:
    """`hostlink serve` on free ports, on the same ones after each restart; its log is a file.

    `part`: of a core, which it has once it has started, together with its guardian.
    """

    folder: Path
    has_udp: bool
    part: CorePart | None = None
    tcp: tuple[str, int] = ("127.0.0.1", 0)
    api: tuple[str, int] = ("127.0.0.1", 0)
    udp: tuple[str, int] | None = None
    micro_ros: tuple[str, int] = field(default_factory=lambda: ("127.0.0.1", free_port()))
    fleet: tuple[str, int] = field(default_factory=lambda: ("127.0.0.1", free_port()))
    is_away: bool = False  # it is being restarted
    preloaded: dict[str, str] = field(default_factory=dict)  # its environment, for a wall clock that jumps
    _child: asyncio.subprocess.Process | None = None

    @property
    def child(self) -> asyncio.subprocess.Process:
        """The process of the present."""
        assert self._child is not None, "it has not been started"
        return self._child

    @property
    def log(self) -> Path:
        return self.folder / "daemon.log"

    @property
    def settings_file(self) -> Path:
        return self.folder / "hostlink.toml"

    @property
    def clock_file(self) -> Path:
        """File with the error of the daemon's wall clock in seconds."""
        return self.folder / "wall_clock"

    @property
    def wrong_certificate(self) -> tuple[Path, Path]:
        """Certificate and key of another authority."""
        return self.folder / "others" / "lab.pem", self.folder / "others" / "lab.key"

    def settings(self) -> str:
        """Valid content of the daemon's settings file."""
        port = self.micro_ros[1]
        tables = [CONFIG, MICRO_ROS_CONFIG.format(port=port), FLEET_CONFIG.format(port=self.fleet[1])]
        if self.udp:
            tables.append(UDP_CONFIG.format(table="udp", port=self.udp[1]))
            tables.append(UDP_CONFIG.format(table="micro_ros.udp", port=port))
        return "".join(tables)

    def prepare(self) -> None:
        """Make its files."""
        if self.has_udp:
            self.udp = ("127.0.0.1", free_port())
        for name in ("fleet", "others"):
            (self.folder / name).mkdir()
            make_authority(self.folder / name)
            make_certificate(self.folder / name, "lab")
        self.clock_file.write_bytes(bytes(8))
        self.log.touch()
        if (compiler := shutil.which("cc")) is not None:
            library = self.folder / "wall_clock.so"
            subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", library, WALL_CLOCK, "-ldl"], check=True)
            self.preloaded = {"LD_PRELOAD": str(library), "CHAOS_WALL_CLOCK": str(self.clock_file)}

    async def start(self) -> None:
        """Start it, and wait until it has printed where it listens."""
        self.settings_file.write_text(self.settings())
        begin = self.log.stat().st_size
        with self.log.open("ab") as stderr:
            self._child = await asyncio.create_subprocess_exec(
                HOSTLINK, "serve", "--config", str(self.settings_file),
                "--listen", "{}:{}".format(*self.tcp), "--api", "{}:{}".format(*self.api),
                stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.DEVNULL, stderr=stderr,
                env=os.environ | self.preloaded,
            )  # fmt: skip
        resource.prlimit(self.child.pid, resource.RLIMIT_NOFILE, (DESCRIPTORS, DESCRIPTORS))
        async with asyncio.timeout(START_S):
            while not (found := _started(self.log, begin)):
                if self.child.returncode is not None:
                    raise RuntimeError(f"the daemon did not start: {self.log.read_text()[-2000:]}")
                await asyncio.sleep(POLL_S)
        self.tcp, self.api = (_address(found[key].removeprefix("http://")) for key in ("tcp", "api"))
        if self.part is not None:
            for pid in (self.child.pid, *children_of(self.child.pid)):
                self.part.add(pid)

    async def end(self, number: signal.Signals, most_s: float) -> int | None:
        """Send a signal; its exit status, None where it had to be killed after that time."""
        self.child.send_signal(number)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(most_s):
                return await self.child.wait()
        self.kill()
        await self.child.wait()
        return None

    def kill(self) -> None:
        if self._child is not None and self._child.returncode is None:
            self._child.kill()

    @contextlib.contextmanager
    def signalled(self, begin: signal.Signals, end: signal.Signals) -> Iterator[None]:
        """The one signal at the beginning of the block, the other at its end."""
        child = self.child
        if self.part is not None:
            self.part.remove(child.pid)
        child.send_signal(begin)
        try:
            yield
        finally:
            if child.returncode is None:
                child.send_signal(end)
                if self.part is not None:
                    self.part.add(child.pid)


def _started(log: Path, begin: int) -> dict[str, Any] | None:
    with log.open("rb") as file:
        file.seek(begin)
        for line in file:
            if b'"daemon.started"' in line and line.endswith(b"\n"):
                found: dict[str, Any] = json.loads(line)
                return found
    return None


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rstrip("/").rpartition(":")
    return host, int(port)


@contextlib.asynccontextmanager
async def daemon(folder: Path, *, has_udp: bool, part: CorePart | None = None) -> AsyncIterator[Daemon]:
    """A daemon with as many descriptors as a process usually has, killed at the end of the block."""
    running = Daemon(folder, has_udp, part)
    running.prepare()
    try:
        await running.start()
        yield running
    finally:
        running.kill()
        with contextlib.suppress(AssertionError):
            await running.child.wait()


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
