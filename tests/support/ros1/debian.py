"""roscore, rospy and the tools of Debian's packages: processes of the system's Python, as their users run them."""

import asyncio
import contextlib
import json
import os
import signal
import socket
import xmlrpc.client
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.rosserial.frame import Id, encode
from tests.support.fake_device import FakeDevice, fake_device
from tests.support.fork_server import LINE_BYTES, Child, Program, shared, start
from tests.support.process import Process, free_port, serve
from tests.support.waiting import TIMEOUT_S, expect

PYTHON = "/usr/bin/python3"
PROGRAM = str(Path(__file__).with_name("program.py"))
NODE = shared(Program("program.py", "ros1/program.py", PYTHON), needs="/usr/bin/rosmaster")
TIME_INTERVAL_S = 1.0


@dataclass
class Graph:
    """A master; it can be killed and started again on the same port."""

    port: int
    folder: Path
    master: asyncio.subprocess.Process | None = None
    _log: Any = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        """Environment of every program in the graph, without the test's own Python."""
        kept = {name: os.environ[name] for name in ("PATH", "LANG") if name in os.environ}
        return {
            **kept,
            "HOME": str(self.folder),
            "ROS_HOME": str(self.folder),
            "ROS_LOG_DIR": str(self.folder),
            "ROS_MASTER_URI": self.url,
            "ROS_IP": "127.0.0.1",
            "PYTHONUNBUFFERED": "1",
        }

    async def start(self, program: str = "rosmaster") -> None:
        """Start the master, and wait until it answers."""
        self.master = await asyncio.create_subprocess_exec(
            *_command(program),
            "--core",
            "-p",
            str(self.port),
            env=self.environment,
            stdout=PIPE,
            stderr=PIPE,
            start_new_session=True,
        )
        await expect(lambda: _is_listening(self.port), timeout_s=TIMEOUT_S)

    async def kill(self, number: signal.Signals = signal.SIGKILL) -> None:
        """End the master and the processes that it has started."""
        if self.master is not None and self.master.returncode is None:
            os.killpg(self.master.pid, number)
            await self.master.communicate()

    async def run(self, *words: str, timeout_s: float = TIMEOUT_S) -> tuple[int, str]:
        """Run a tool of ROS to its end: (status, output)."""
        child = await asyncio.create_subprocess_exec(
            *words, env=self.environment, stdout=PIPE, stderr=asyncio.subprocess.STDOUT
        )
        try:
            async with asyncio.timeout(timeout_s):
                out, _ = await child.communicate()
        finally:
            if child.returncode is None:
                child.kill()
                await child.wait()
        assert child.returncode is not None
        return child.returncode, out.decode()

    async def lines(self, *words: str) -> list[str]:
        """The output of a tool that must succeed."""
        status, out = await self.run(*words)
        assert status == 0, out
        return [line.strip() for line in out.splitlines() if line.strip()]

    async def listed(self, name: str, *, is_there: bool = True) -> set[str]:
        """Wait until `rostopic list` has a topic, or no more has it. Return all topics."""
        async with asyncio.timeout(TIMEOUT_S):
            while True:
                status, out = await self.run("rostopic", "list")
                if status == 0 and (name in (found := set(out.split()))) is is_there:
                    return found
                await asyncio.sleep(0.1)

    async def slave_uri(self, node: str) -> str:
        """Return the URI at which the node listens for calls, according to the master."""
        _, _, uri = await call(self.url, "lookupNode", "/test", node)
        return str(uri)

    @contextlib.asynccontextmanager
    async def node(self, *words: str, precedence: tuple[str, ...] = ()) -> AsyncIterator["Node"]:
        """`program.py` with these words, killed at the end of the block; forked without a `precedence`."""
        child: Child | asyncio.subprocess.Process
        if precedence:
            child = await asyncio.create_subprocess_exec(
                *precedence, PYTHON, PROGRAM, *words, env=self.environment, stdin=PIPE, stdout=PIPE, limit=LINE_BYTES
            )
        else:
            child = await start(*words, program=NODE, given=None, stdout=PIPE, environment=self.environment)
        node = Node(child)
        try:
            await node.read("ready")
            yield node
        finally:
            with contextlib.suppress(ProcessLookupError):
                child.send_signal(signal.SIGCONT)
                child.kill()
            await child.communicate()

    @contextlib.asynccontextmanager
    async def daemon(self, *arguments: str) -> AsyncIterator[Process]:
        """`hostlink serve` in this graph."""
        async with serve("--ros1", self.url, *arguments) as daemon:
            yield daemon


@dataclass
class Node:
    """A rospy program; it prints one JSON object a line."""

    child: Child | asyncio.subprocess.Process
    read_lines: list[dict[str, Any]] = field(default_factory=list)

    async def read(self, event: str, timeout_s: float = TIMEOUT_S) -> dict[str, Any]:
        """The next line of this event."""
        assert self.child.stdout is not None
        async with asyncio.timeout(timeout_s):
            while line := await self.child.stdout.readline():
                self.read_lines.append(json.loads(line))
                if self.read_lines[-1]["event"] == event:
                    return self.read_lines[-1]
        raise EOFError(f"the program ended without {event}: {self.read_lines[-5:]}")

    def send(self, line: str) -> None:
        """A line for its standard input."""
        assert self.child.stdin is not None
        self.child.stdin.write(f"{line}\n".encode())

    def signal(self, number: signal.Signals) -> None:
        self.child.send_signal(number)


@contextlib.asynccontextmanager
async def graph(folder: Path, program: str = "rosmaster") -> AsyncIterator[Graph]:
    """A master of Debian's, killed at the end of the block. `roscore` is the master with rosout."""
    made = Graph(free_port(), folder)
    await made.start(program)
    try:
        yield made
    finally:
        await made.kill()


@contextlib.asynccontextmanager
async def living_device(
    address: tuple[str, int], topics: list[DeviceEndpoint], local_host: str | None = None
) -> AsyncIterator[FakeDevice]:
    """A device that requests the time, as every device does: programs of ROS take seconds to start."""
    async with fake_device(address, topics, local_host=local_host) as device:

        async def request() -> None:
            with contextlib.suppress(OSError):  # it has hung up, or the daemon has ended
                while True:
                    await device.send(encode(Id.TIME, bytes(8)))
                    await asyncio.sleep(TIME_INTERVAL_S)

        async with asyncio.TaskGroup() as tasks:
            task = tasks.create_task(request())
            try:
                yield device
            finally:
                task.cancel()


async def call(uri: str, method: str, *arguments: object) -> Any:
    """The answer of a master or of a node's slave API: (status, text, value)."""
    return await asyncio.to_thread(_call, uri, method, *arguments)


def _call(uri: str, method: str, *arguments: object) -> Any:
    with xmlrpc.client.ServerProxy(uri) as proxy:
        return getattr(proxy, method)(*arguments)


def _command(program: str) -> tuple[str, ...]:
    return (PYTHON, f"/usr/bin/{program}")


def _is_listening(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
        return True
    return False
