"""ROS 2 for tests: rclpy of PyPI in a venv of its own, peers that are processes, and the bridge as its users run it."""

import asyncio
import contextlib
import fcntl
import json
import os
import random
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any, Generic, TypeVar

from tests.support.fork_server import Child, Program, shared, start
from tests.support.once import BUILD
from tests.support.waiting import expect

VENV = BUILD / "ros2-venv"
PYTHON, HOSTLINK = str(VENV / "bin" / "python"), str(VENV / "bin" / "hostlink")
BRIDGE = shared(Program("hostlink", "forked_bridge.py", PYTHON))
PEER = shared(Program("ros2_peer", "ros2_peer.py", PYTHON))
DISCOVERY_S = 20.0  # how long a busy machine may need until two nodes know each other
MAX_DOMAIN = 100


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


Line = TypeVar("Line")


class Lines(Generic[Line]):
    """Lines that a process writes; each is decoded once."""

    def __init__(self, decode: Callable[[str], Line]) -> None:
        self.all: list[Line] = []
        self._decode = decode

    async def read(self, stream: asyncio.StreamReader) -> None:
        while line := await stream.readline():
            self.all.append(self._decode(line.decode().rstrip()))


class Peer:
    """A node in a process of its own; see ros2_peer.py."""

    def __init__(self, child: Child, lines: Lines[dict[str, Any]]) -> None:
        self.child, self._lines = child, lines

    async def do(self, op: str, **fields: Any) -> None:
        """Send a command."""
        assert self.child.stdin is not None
        self.child.stdin.write(json.dumps({"op": op, **fields}).encode() + b"\n")
        await self.child.stdin.drain()

    def events(self, name: str, **wanted: Any) -> list[dict[str, Any]]:
        """Every event of this kind so far."""
        return [each for each in self._lines.all if each["event"] == name and wanted.items() <= each.items()]

    def messages(self, topic: str) -> list[Any]:
        """Return the messages that arrived on a topic."""
        return [each["msg"] for each in self.events("message", topic=topic)]

    async def answer(self, op: str, event: str, **fields: Any) -> dict[str, Any]:
        """Send a command, and wait for its answer."""
        before = len(self.events(event))
        await self.do(op, **fields)
        await expect(lambda: len(self.events(event)) > before, timeout_s=DISCOVERY_S)
        return self.events(event)[before]

    async def until_graph(self, has: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
        """The first graph of which this is true."""
        return await self._until("graph", has)

    async def until_end(self, topic: str, kind: str, wanted: list[str]) -> None:
        """Wait until the topic has this publisher or subscriber: a node learns of others' one after another."""
        await self._until("ends", lambda ends: wanted in ends[kind], topic=topic)

    async def _until(self, op: str, has: Callable[[dict[str, Any]], object], **fields: Any) -> dict[str, Any]:
        """The first answer, an event of the command's name, of which this is true."""
        found: dict[str, Any] = {}
        try:
            async with asyncio.timeout(DISCOVERY_S):
                while True:
                    found = await self.answer(op, op, **fields)
                    if has(found):
                        return found
                    await asyncio.sleep(0.05)
        except TimeoutError:
            raise AssertionError(f"not within {DISCOVERY_S:g} s; the last {op}: {found}") from None


@contextlib.asynccontextmanager
async def peer(environment: dict[str, str], name: str = "peer", *arguments: str) -> AsyncIterator[Peer]:
    """A node for the length of the block."""
    child = await start(name, *arguments, program=PEER, given=None, stdout=PIPE, environment=environment)
    lines: Lines[dict[str, Any]] = Lines(json.loads)
    assert child.stdout is not None
    async with asyncio.TaskGroup() as tasks:
        reading = tasks.create_task(lines.read(child.stdout))
        try:
            made = Peer(child, lines)
            await expect(lambda: made.events("ready"), timeout_s=DISCOVERY_S)
            yield made
        finally:
            child.kill()
            await child.aclose()
            reading.cancel()


class Bridge:
    """`hostlink ros2` as a process."""

    def __init__(self, child: Child, lines: Lines[str]) -> None:
        self.child, self._lines = child, lines

    @property
    def reports(self) -> list[str]:
        """Lines of the process on standard error."""
        return self._lines.all

    def has_reported(self, text: str) -> bool:
        """Whether a line has this text."""
        return any(text in line for line in self.reports)


@contextlib.asynccontextmanager
async def bridge(
    environment: dict[str, str], url: str, *arguments: str, until: str = "connected to hostlink"
) -> AsyncIterator[Bridge]:
    """The bridge for the length of the block; it has found the daemon when the block begins."""
    words = ("ros2", "--url", url, *arguments)
    child = await start(*words, program=BRIDGE, stderr=PIPE, environment={**environment, "NO_COLOR": "1"})
    lines = Lines(str)
    assert child.stderr is not None
    async with asyncio.TaskGroup() as tasks:
        reading = tasks.create_task(lines.read(child.stderr))
        try:
            made = Bridge(child, lines)
            await expect(lambda: made.has_reported(until), timeout_s=DISCOVERY_S)
            yield made
        finally:
            child.kill()
            await child.aclose()
            reading.cancel()
