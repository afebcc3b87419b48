"""Programs without their seconds of imports: real processes, forked from one that has imported everything.

Measured need: on a busy machine (load 9), `hostlink --version` answers after 0.06 s; its imports alone last 5.7 s. The
fork server of multiprocessing runs functions, not programs with their own descriptors, arguments and environment.
"""

import array
import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.support import workers

HERE = Path(__file__).resolve().parent
LINE_BYTES = 1 << 24
ANSWER_BYTES = 64


@dataclass(frozen=True)
class Program:
    """Forked program: its name, the file that imports it, and the Python that runs it."""

    name: str
    file: str
    python: str = sys.executable


_shared: list[Program] = []


def shared(program: Program, needs: str = "") -> Program:
    """Let the workers copy one parent of this program. The imports of each worker would take a second of CPU.

    Args:
        program: program that is forked
        needs: file without which the program is not installed; none: its Python
    """
    if Path(needs or program.python).exists():
        _shared.append(program)
    return program


HOSTLINK = shared(Program("hostlink", "forked_hostlink.py"))


class ForkServer:
    """The parent of the processes, or a copy of `original`; it ends with the process that made it."""

    def __init__(self, program: Program, original: "ForkServer | None" = None) -> None:
        self.program = program
        self._is_ready, self._lock = False, threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            if original is not None:
                original.copy(theirs)
                return
            command = [program.python, str(HERE / "fork_parent.py"), str(HERE / program.file), str(theirs.fileno())]
            # Its own output is nothing; what it imports first decides whether the output of its children is buffered.
            self._process = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
            )

    def copy(self, end: socket.socket) -> None:
        """Let a copy of the process serve the other end of this socket. Workers may do it at the same time."""
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [end.fileno()]))]
        self._requests.sendmsg([json.dumps({"copy": True}).encode()], rights)

    def close(self) -> None:
        """End the process and all that it runs."""
        self._requests.close()
        if self._process is not None:
            self._process.wait()

    def await_ready(self) -> None:
        """Wait for its imports: a second, in which no loop may stand still. In any thread."""
        with self._lock:
            if not self._is_ready:
                self._requests.recv(ANSWER_BYTES)
                self._is_ready = True

    def fork(self, arguments: Sequence[str], files: tuple[int, int, int], environment: Mapping[str, str]) -> int:
        """Run the program with these arguments on these descriptors; returns its pid."""
        words = [self.program.name, *arguments]
        request = {"arguments": words, "environment": dict(environment), "folder": str(Path.cwd())}
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", files))]
        self._requests.sendmsg([json.dumps(request).encode()], rights)
        return int(self._requests.recv(ANSWER_BYTES))

    def wait(self, pid: int) -> int:
        """The exit status of one that has ended, as subprocess has it."""
        self._requests.send(json.dumps({"wait": pid}).encode())
        return int(self._requests.recv(ANSWER_BYTES))


_originals: dict[Program, ForkServer] = {}  # started before the workers, which copy them


def _start_originals() -> None:
    _originals.update({program: ForkServer(program) for program in _shared})


workers.before_fork.append(_start_originals)


@cache
def fork_server(program: Program) -> ForkServer:
    """The one of this process."""
    return ForkServer(program, _originals.get(program))


class Child:
    """A forked process with its pipes, as asyncio.subprocess.Process."""

    def __init__(self, pid: int, server: ForkServer) -> None:
        self.pid = pid
        self.returncode: int | None = None
        self.stdin: asyncio.StreamWriter | None = None
        self.stdout: asyncio.StreamReader | None = None
        self.stderr: asyncio.StreamReader | None = None
        self._server = server
        self._pipes: list[asyncio.BaseTransport] = []
        self._ended = asyncio.Event()
        self._descriptor = os.pidfd_open(pid)
        asyncio.get_running_loop().add_reader(self._descriptor, self._end)

    async def read(self, descriptor: int) -> asyncio.StreamReader:
        """Read a pipe from the process."""
        reader = asyncio.StreamReader(LINE_BYTES)
        pipe, _ = await asyncio.get_running_loop().connect_read_pipe(
            lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(descriptor, "rb", buffering=0)
        )
        self._pipes.append(pipe)
        return reader

    async def write(self, descriptor: int) -> asyncio.StreamWriter:
        """Write into a pipe to the process."""
        loop = asyncio.get_running_loop()
        pipe, protocol = await loop.connect_write_pipe(
            asyncio.streams.FlowControlMixin, os.fdopen(descriptor, "wb", buffering=0)
        )
        self._pipes.append(pipe)
        return asyncio.StreamWriter(pipe, protocol, None, loop)

    def send_signal(self, number: int) -> None:
        """Send a signal, unless the process has ended."""
        if self.returncode is None:
            os.kill(self.pid, number)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    async def wait(self) -> int:
        """Wait for the end of the process. Return its exit status."""
        await self._ended.wait()
        assert self.returncode is not None
        return self.returncode

    async def communicate(self) -> tuple[bytes, bytes]:
        """All that it writes until its end."""
        async with asyncio.TaskGroup() as tasks:
            out, err = (tasks.create_task(_read_all(each)) for each in (self.stdout, self.stderr))
        await self.aclose()
        return out.result(), err.result()

    async def aclose(self) -> None:
        """Wait for its end, and close the pipes."""
        await self.wait()
        for pipe in self._pipes:
            pipe.close()

    def _end(self) -> None:
        asyncio.get_running_loop().remove_reader(self._descriptor)
        os.close(self._descriptor)
        self.returncode = self._server.wait(self.pid)
        self._ended.set()


async def _read_all(reader: asyncio.StreamReader | None) -> bytes:
    return b"" if reader is None else await reader.read()


async def start(
    *arguments: str,
    program: Program = HOSTLINK,
    given: bytes | None = b"",
    stdout: int | None = None,
    stderr: int | None = None,
    environment: Mapping[str, str] = os.environ,
) -> Child:
    """Run a program. `given` is its input, None: written to `stdin` later; an output None is the test's output."""
    server = fork_server(program)
    await asyncio.to_thread(server.await_ready)
    with contextlib.ExitStack() as theirs:
        reading, stdin = os.pipe()
        files = [reading]
        ours: list[int | None] = [None, None]
        theirs.callback(os.close, reading)
        for number, wanted in enumerate((stdout, stderr)):
            if wanted == subprocess.PIPE:
                ours[number], writing = os.pipe()
                theirs.callback(os.close, writing)
            else:
                writing = number + 1 if wanted is None else wanted
            files.append(writing)
        child = Child(server.fork(arguments, (files[0], files[1], files[2]), environment), server)
    child.stdin = await child.write(stdin)
    child.stdout, child.stderr = [None if each is None else await child.read(each) for each in ours]
    if given is not None:
        child.stdin.write(given)
        child.stdin.write_eof()
    return child
