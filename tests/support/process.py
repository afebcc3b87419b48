"""hostlink as a process of its own, as its users run it."""

import asyncio
import contextlib
import json
import os
import random
import signal
import socket
import subprocess
import sys
import tempfile
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import aiohttp

from tests.support import workers
from tests.support.fork_server import Child, start
from tests.support.waiting import TIMEOUT_S, expect

HOSTLINK = str(Path(sys.executable).parent / "hostlink")
POLL_S = 0.005
FIRST_PORT, PORTS = 20_000, 600  # for each of twenty workers
_given: set[int] = set()


def free_port() -> int:
    """Return a free TCP port below those that the system gives to connections, so that it stays free.

    Each worker of the tests has a range of its own, and gives no port twice.
    """
    worker = int(os.environ.get(workers.NUMBER, "19")) % 20
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
    """A running `hostlink serve`; `log` has the lines of its log so far."""

    child: Child | asyncio.subprocess.Process | subprocess.Popen[bytes]
    log_file: Path = Path(os.devnull)
    tcp: tuple[str, int] = ("", 0)
    url: str = ""
    _lines: list[dict[str, Any]] = field(default_factory=list)
    _tracebacks: int = 0
    _read_bytes: int = 0
    _next: int = 0

    @property
    def pid(self) -> int:
        return self.child.pid

    @property
    def log(self) -> list[dict[str, Any]]:
        """Every line that is JSON."""
        if self.log_file.exists():  # else the block has ended, and all is read
            self._update()
        return self._lines

    def _update(self) -> None:
        with self.log_file.open("rb") as file:
            file.seek(self._read_bytes)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._read_bytes += len(whole)
        lines = whole.splitlines()
        self._lines += [json.loads(line) for line in lines if line.startswith(b"{")]
        self._tracebacks += sum(line.startswith(b"Traceback") for line in lines)

    def lines(self, event: str) -> list[dict[str, Any]]:
        """Return the lines of an event."""
        return [line for line in self.log if line["event"] == event]

    async def read_log(self, until: str) -> dict[str, Any]:
        """The first line of this event from here on."""
        try:
            async with asyncio.timeout(TIMEOUT_S):
                return await self._read_log(until)
        except TimeoutError:
            raise AssertionError(f"no {until} in the log within {TIMEOUT_S:g} s: {self.log_file.read_text()}") from None

    async def _read_log(self, until: str) -> dict[str, Any]:
        while True:
            has_ended = self.child.returncode is not None
            lines = self.log
            while self._next < len(lines):
                self._next += 1
                if lines[self._next - 1]["event"] == until:
                    return lines[self._next - 1]
            assert not self._tracebacks, self.log_file.read_text()
            if has_ended:
                raise EOFError(f"the daemon ended without {until}: {self.log_file.read_text()}")
            await asyncio.sleep(POLL_S)

    async def logged(self, event: str, count: int = 1) -> dict[str, Any]:
        """Wait for so many lines of this event; returns the last of them."""
        await expect(lambda: len(self.lines(event)) >= count, timeout_s=TIMEOUT_S)
        return self.lines(event)[count - 1]

    async def has_started(self) -> None:
        """Wait until it listens; from then on its addresses are known."""
        started = await self.read_log("daemon.started")
        host, _, port = (started["tcp"] or ":0").rpartition(":")
        self.tcp, self.url = (host, int(port)), started["api"]

    async def get(self, path: str) -> Any:
        """The JSON of a GET that must succeed."""
        return await self._request("GET", path)

    async def post(self, path: str, body: object = None) -> Any:
        """The JSON of a POST that must succeed."""
        return await self._request("POST", path, body)

    async def put(self, path: str, body: object) -> Any:
        """The JSON of a PUT that must succeed."""
        return await self._request("PUT", path, body)

    async def _request(self, method: str, path: str, body: object = None) -> Any:
        async with aiohttp.ClientSession() as session, session.request(method, self.url + path, json=body) as response:
            answer = await response.json()
            assert response.status == 200, answer
            return answer

    def is_running(self) -> bool:
        """Whether the process is there."""
        return is_running(self.pid)

    async def ended(self) -> None:
        """Wait for its end."""
        await expect(lambda: not self.is_running(), timeout_s=TIMEOUT_S)

    async def end(self, number: signal.Signals) -> int:
        """Send a signal; returns the exit status."""
        assert not isinstance(self.child, subprocess.Popen)
        self.child.send_signal(number)
        async with asyncio.timeout(TIMEOUT_S):
            return await self.child.wait()


def is_running(pid: int) -> bool:
    """Whether there is such a process, and not only its last remains."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"


@contextlib.asynccontextmanager
async def serve(
    *arguments: str,
    environment: Mapping[str, str] | None = None,
    program: tuple[str, ...] = (),
    log: Path | None = None,
) -> AsyncIterator[Process]:
    """`hostlink serve` on free ports, killed at the end of the block if it still runs; forked without a `program`."""
    words = ("serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0", *arguments)
    async with started(*words, environment=environment, program=program, log=log) as process:
        await process.has_started()
        yield process


@contextlib.asynccontextmanager
async def started(
    *words: str,
    environment: Mapping[str, str] | None = None,
    program: tuple[str, ...] = (),
    log: Path | None = None,
) -> AsyncIterator[Process]:
    """`hostlink` with these words, which writes its log into a file; killed at the end of the block."""
    environment = {**os.environ, **(environment or {})}
    with contextlib.ExitStack() as stack:
        if log is None:
            log = Path(stack.enter_context(tempfile.NamedTemporaryFile(prefix="hostlink-", suffix=".log")).name)
        stderr = stack.enter_context(log.open("ab"))  # noqa: ASYNC230 - a local file
        child: Child | asyncio.subprocess.Process
        if program:
            child = await asyncio.create_subprocess_exec(*program, *words, stderr=stderr, env=environment)
        else:
            child = await start(*words, stderr=stderr.fileno(), environment=environment)
        process = Process(child, log)
        try:
            yield process
        finally:
            if child.returncode is None:
                child.kill()
            await child.communicate()
            process._update()  # while there is the file


async def run(
    *arguments: str, input_text: str = "", environment: Mapping[str, str] | None = None
) -> tuple[int, str, str]:
    """Run a hostlink command to its end: (status, standard output, standard error)."""
    environment = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", **(environment or {})}
    child = await start(*arguments, given=input_text.encode(), stdout=PIPE, stderr=PIPE, environment=environment)
    async with asyncio.timeout(TIMEOUT_S):
        out, err = await child.communicate()
    assert child.returncode is not None
    assert child.returncode >= 0, f"hostlink {' '.join(arguments)} was killed by signal {-child.returncode}: {err!r}"
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
