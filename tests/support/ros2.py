"""ROS 2 for tests: rclpy of PyPI in a venv of its own, peers that are processes, and the bridge as its users run it."""

import asyncio
import contextlib
import fcntl
import json
import os
import random
import signal
import subprocess
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.once import BUILD
from tests.support.waiting import expect

ROOT = BUILD.parent
VENV = BUILD / "ros2-venv"
PYTHON, HOSTLINK = str(VENV / "bin" / "python"), str(VENV / "bin" / "hostlink")
PEER = str(Path(__file__).with_name("ros2_peer.py"))
INSTALL_TIMEOUT_S = 900.0
DISCOVERY_S = 20.0  # how long a busy machine may need until two nodes know each other
MAX_DOMAIN = 100


def install(*variables: str, environment: dict[str, str] | None = None) -> None:
    """Have rclpy in its venv; a test that cannot have it fails, and says so. `variables`: of make."""
    BUILD.mkdir(exist_ok=True)
    with (BUILD / "ros2-venv.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        made = subprocess.run(
            ["make", "--silent", "ros2-venv", *variables],
            env=environment,
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=INSTALL_TIMEOUT_S,
            check=False,
        )
    if made.returncode:
        pytest.fail(
            f"rclpy is not there, so nothing of hostlink ros2 was tested:\n{made.stdout[-2000:]}{made.stderr[-2000:]}"
        )


@contextlib.contextmanager
def domain() -> Iterator[dict[str, str]]:
    """The environment of a ROS 2 domain that no other test uses, on this computer alone."""
    numbers = list(range(1, MAX_DOMAIN))
    random.shuffle(numbers)
    for number in numbers:
        with (Path("/tmp") / f"hostlink-test-domain-{number}.lock").open("a") as lock:  # noqa: S108
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            own = {"ROS_DOMAIN_ID": str(number), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
            yield {**os.environ, **own, "ROS_LOG_DIR": str(BUILD / "ros2-log")}
            return
    raise AssertionError("every domain is in use")


class Lines:
    """What a process writes, line by line."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    async def read(self, stream: asyncio.StreamReader) -> None:
        while line := await stream.readline():
            self.texts.append(line.decode().rstrip())


class Peer:
    """A node in a process of its own; see ros2_peer.py."""

    def __init__(self, child: asyncio.subprocess.Process, lines: Lines) -> None:
        self.child, self._lines = child, lines
        self._read = 0

    async def do(self, op: str, **fields: Any) -> None:
        """Send a command."""
        assert self.child.stdin is not None
        self.child.stdin.write(json.dumps({"op": op, **fields}).encode() + b"\n")
        await self.child.stdin.drain()

    def events(self, name: str, **wanted: Any) -> list[dict[str, Any]]:
        """Every event of this kind so far."""
        found = [json.loads(text) for text in self._lines.texts]
        return [each for each in found if each["event"] == name and wanted.items() <= each.items()]

    def messages(self, topic: str) -> list[Any]:
        """What came on a topic."""
        return [each["msg"] for each in self.events("message", topic=topic)]

    async def answer(self, op: str, event: str, **fields: Any) -> dict[str, Any]:
        """Send a command, and wait for its answer."""
        before = len(self.events(event))
        await self.do(op, **fields)
        await expect(lambda: len(self.events(event)) > before, timeout_s=DISCOVERY_S)
        return self.events(event)[before]

    async def until_graph(self, has: Any) -> dict[str, Any]:
        """The first graph of which this is true."""
        async with asyncio.timeout(DISCOVERY_S):
            while True:
                found = await self.answer("graph", "graph")
                if has(found):
                    return found
                await asyncio.sleep(0.05)


@contextlib.asynccontextmanager
async def peer(environment: dict[str, str], name: str = "peer", *arguments: str) -> AsyncIterator[Peer]:
    """A node for the length of the block."""
    child = await asyncio.create_subprocess_exec(
        PYTHON, PEER, name, *arguments, stdin=PIPE, stdout=PIPE, env=environment, limit=1 << 22
    )
    lines = Lines()
    assert child.stdout is not None
    async with asyncio.TaskGroup() as tasks:
        reading = tasks.create_task(lines.read(child.stdout))
        try:
            made = Peer(child, lines)
            await expect(lambda: made.events("ready"), timeout_s=DISCOVERY_S)
            yield made
        finally:
            await _end(child)
            reading.cancel()


class Bridge:
    """`hostlink ros2` as a process."""

    def __init__(self, child: asyncio.subprocess.Process, lines: Lines) -> None:
        self.child, self._lines = child, lines

    @property
    def reports(self) -> list[str]:
        """Its lines on standard error."""
        return self._lines.texts

    def has_reported(self, text: str) -> bool:
        """Whether a line has this text."""
        return any(text in line for line in self.reports)


@contextlib.asynccontextmanager
async def bridge(
    environment: dict[str, str], url: str, *arguments: str, until: str = "connected to hostlink"
) -> AsyncIterator[Bridge]:
    """The bridge for the length of the block; it has found the daemon when the block begins."""
    child = await asyncio.create_subprocess_exec(
        HOSTLINK, "ros2", "--url", url, *arguments, stderr=PIPE, env={**environment, "NO_COLOR": "1"}
    )
    lines = Lines()
    assert child.stderr is not None
    async with asyncio.TaskGroup() as tasks:
        reading = tasks.create_task(lines.read(child.stderr))
        try:
            made = Bridge(child, lines)
            await expect(lambda: made.has_reported(until), timeout_s=DISCOVERY_S)
            yield made
        finally:
            await _end(child)
            reading.cancel()


async def _end(child: asyncio.subprocess.Process) -> None:
    if child.returncode is None:
        child.send_signal(signal.SIGCONT)
        child.kill()
    await child.wait()
