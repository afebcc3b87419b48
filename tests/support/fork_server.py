"""`hostlink serve` a hundred times in seconds: real processes, forked from one that has imported everything.

As a program it reads a line of JSON for each daemon, `{"arguments": [...], "log": path}`, and answers with its pid.
"""

import asyncio
import contextlib
import io
import json
import os
import signal
import sys
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if __name__ == "__main__":  # run by its path
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.support.waiting import expect

TIMEOUT_S = 20.0
PROGRAM = str(Path(__file__).resolve())


@dataclass
class Forked:
    """A running daemon; it is nobody's child here."""

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


class ForkServer:
    """The parent of the daemons."""

    def __init__(self, child: asyncio.subprocess.Process, folder: Path) -> None:
        self._child, self._folder = child, folder
        self._count = 0
        self._lock = asyncio.Lock()

    @contextlib.asynccontextmanager
    async def serve(self, *arguments: str) -> AsyncIterator[Forked]:
        """A daemon on free ports, killed at the end of the block if it still runs."""
        daemon = await self._fork("serve", "--listen", "127.0.0.1:0", "--api", "127.0.0.1:0", *arguments)
        try:
            started = await daemon.logged("daemon.started")
            host, _, port = started["tcp"].rpartition(":")
            daemon.tcp, daemon.url = (host, int(port)), started["api"]
            yield daemon
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.kill(daemon.pid, signal.SIGKILL)

    async def _fork(self, *arguments: str) -> Forked:
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._count += 1
        log_file = self._folder / f"daemon_{self._count}.log"
        log_file.touch()
        async with self._lock:
            self._child.stdin.write(json.dumps({"arguments": arguments, "log": str(log_file)}).encode() + b"\n")
            async with asyncio.timeout(TIMEOUT_S):
                pid = int(await self._child.stdout.readline())
        return Forked(pid, log_file)


@contextlib.asynccontextmanager
async def fork_server(folder: Path) -> AsyncIterator[ForkServer]:
    """Ready to fork; logs go into the folder."""
    child = await asyncio.create_subprocess_exec(
        sys.executable, PROGRAM, stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE
    )
    try:
        yield ForkServer(child, folder)
    finally:
        if child.returncode is None:
            child.kill()
        await child.communicate()


def main() -> None:
    """Fork a daemon for each line."""
    from hostlink.cli.main import main as hostlink  # noqa: PLC0415
    from hostlink.messages.catalog import Catalog  # noqa: PLC0415

    Catalog()
    sys.argv[1:] = ["serve", "--example", "config"]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
        hostlink()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system buries the daemons
    for line in sys.stdin:
        wanted = json.loads(line)
        pid = os.fork()
        if pid == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            os.setsid()
            log = os.open(wanted["log"], os.O_WRONLY | os.O_APPEND)
            for number in (1, 2):
                os.dup2(log, number)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            sys.argv[1:] = wanted["arguments"]
            hostlink()
            os._exit(0)
        sys.stdout.write(f"{pid}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
