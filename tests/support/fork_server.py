"""`hostlink` without its second of imports: real processes, forked from one that has imported everything.

As a program it serves requests on a socket: `{"arguments": [...]}` with the descriptors 0, 1 and 2 is answered with a
pid, `{"wait": pid}` with the exit status of that process.
"""

import array
import asyncio
import contextlib
import io
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

if __name__ == "__main__":  # run by its path
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.support.waiting import expect

TIMEOUT_S = 20.0
PROGRAM = str(Path(__file__).resolve())
REQUEST_BYTES = 1 << 18


class ForkServer:
    """The parent of the processes; it ends with the process that made it."""

    def __init__(self) -> None:
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            command = [sys.executable, PROGRAM, str(theirs.fileno())]
            # Its own output is nothing; what it imports first decides whether the output of its children is buffered.
            self._process = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
            )

    def fork(self, arguments: Sequence[str], files: tuple[int, int, int], environment: Mapping[str, str]) -> int:
        """Run `hostlink` with these arguments on these descriptors; returns its pid."""
        request = {"arguments": arguments, "environment": dict(environment), "folder": str(Path.cwd())}
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", files))]
        self._requests.sendmsg([json.dumps(request).encode()], rights)
        return int(self._requests.recv(REQUEST_BYTES))

    def wait(self, pid: int) -> int:
        """The exit status of one that has ended, as subprocess has it."""
        self._requests.send(json.dumps({"wait": pid}).encode())
        return int(self._requests.recv(REQUEST_BYTES))


@cache
def fork_server() -> ForkServer:
    """The one of this process."""
    return ForkServer()


class Child:
    """A forked process with its pipes, as asyncio.subprocess.Process."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.stdout: asyncio.StreamReader | None = None
        self.stderr: asyncio.StreamReader | None = None
        self._pipes: list[asyncio.ReadTransport] = []
        self._ended = asyncio.Event()
        self._descriptor = os.pidfd_open(pid)
        asyncio.get_running_loop().add_reader(self._descriptor, self._end)

    async def read(self, descriptor: int) -> asyncio.StreamReader:
        """Read a pipe from the process."""
        reader = asyncio.StreamReader()
        pipe, _ = await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(descriptor, "rb", buffering=0)
        )
        self._pipes.append(pipe)
        return reader

    def send_signal(self, number: int) -> None:
        """Nothing happens when it has ended."""
        if self.returncode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    async def wait(self) -> int:
        """Its exit status, when it has ended."""
        await self._ended.wait()
        assert self.returncode is not None
        return self.returncode

    async def communicate(self) -> tuple[bytes, bytes]:
        """All that it writes until its end."""
        async with asyncio.TaskGroup() as tasks:
            out, err = (tasks.create_task(_read_all(each)) for each in (self.stdout, self.stderr))
        await self.wait()
        for pipe in self._pipes:
            pipe.close()
        return out.result(), err.result()

    def _end(self) -> None:
        asyncio.get_running_loop().remove_reader(self._descriptor)
        os.close(self._descriptor)
        self.returncode = fork_server().wait(self.pid)
        self._ended.set()


async def _read_all(reader: asyncio.StreamReader | None) -> bytes:
    return b"" if reader is None else await reader.read()


async def start(
    *arguments: str,
    given: bytes = b"",
    stdout: int | None = None,
    stderr: int | None = None,
    environment: Mapping[str, str] = os.environ,
) -> Child:
    """Run `hostlink`; `given` is what it reads, None: its output goes where the test's goes."""
    ours: list[int | None] = []
    with contextlib.ExitStack() as theirs:
        files = [_input(given, theirs)]
        for number, wanted in ((1, stdout), (2, stderr)):
            reading, writing = os.pipe() if wanted == subprocess.PIPE else (None, number if wanted is None else wanted)
            ours.append(reading)
            files.append(writing)
            if reading is not None:
                theirs.callback(os.close, writing)
        child = Child(fork_server().fork(arguments, (files[0], files[1], files[2]), environment))
    out, err = ours
    child.stdout = None if out is None else await child.read(out)
    child.stderr = None if err is None else await child.read(err)
    return child


def _input(given: bytes, stack: contextlib.ExitStack) -> int:
    reading, writing = os.pipe()
    stack.callback(os.close, reading)
    os.write(writing, given)
    os.close(writing)
    return reading


@dataclass
class Forked:
    """A running daemon whose log goes into a file."""

    pid: int
    log_file: Path
    tcp: tuple[str, int] = ("", 0)
    url: str = ""

    def log(self, event: str) -> list[dict[str, Any]]:
        """Its log's lines of this event so far."""
        lines = self.log_file.read_text().splitlines() if self.log_file.exists() else []
        return [line for line in map(json.loads, lines) if line["event"] == event]

    async def logged(self, event: str, count: int = 1) -> dict[str, Any]:
        """Wait for so many lines of this event; returns the last of them."""
        await expect(lambda: len(self.log(event)) >= count, timeout_s=TIMEOUT_S)
        return self.log(event)[count - 1]

    def is_running(self) -> bool:
        """Whether the process is there."""
        return is_running(self.pid)

    async def ended(self) -> None:
        """Wait for its end."""
        await expect(lambda: not self.is_running(), timeout_s=TIMEOUT_S)


def is_running(pid: int) -> bool:
    """Whether there is such a process, and not only its last remains."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state not in "ZX"


@dataclass
class Daemons:
    """Daemons whose logs go into a folder."""

    folder: Path
    count: int = 0

    @contextlib.asynccontextmanager
    async def serve(self, *arguments: str) -> AsyncIterator[Forked]:
        """One on free ports, killed at the end of the block if it still runs."""
        self.count += 1
        log_file = self.folder / f"daemon_{self.count}.log"
        words = ("serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0", *arguments)
        with log_file.open("ab") as log:
            child = await start(*words, stdout=log.fileno(), stderr=log.fileno())
        try:
            daemon = Forked(child.pid, log_file)
            started = await daemon.logged("daemon.started")
            host, _, port = started["tcp"].rpartition(":")
            daemon.tcp, daemon.url = (host, int(port)), started["api"]
            yield daemon
        finally:
            child.kill()
            await child.wait()


def main() -> None:
    """Serve until the other end is closed; a forked process returns as `hostlink`."""
    from hostlink.cli.main import main as hostlink  # noqa: PLC0415
    from hostlink.messages.catalog import Catalog  # noqa: PLC0415

    requests = socket.socket(fileno=int(sys.argv[1]))
    Catalog()
    sys.argv = ["hostlink", "serve", "--example", "config"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        hostlink()
    while True:
        data, files, _, _ = socket.recv_fds(requests, REQUEST_BYTES, 3)
        if not data:
            return
        request = json.loads(data)
        if "wait" in request:
            status = os.waitstatus_to_exitcode(os.waitpid(request["wait"], 0)[1])
            requests.send(str(status).encode())
            continue
        pid = os.fork()
        if pid == 0:
            requests.close()
            _become(request, files)
            hostlink()
            return
        requests.send(str(pid).encode())
        for file in files:
            os.close(file)


def _become(request: dict[str, Any], files: list[int]) -> None:
    Path("/proc/self/comm").write_text("hostlink")
    for number, file in enumerate(files):
        os.dup2(file, number)
        os.close(file)
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = ["hostlink", *request["arguments"]]


if __name__ == "__main__":
    main()
