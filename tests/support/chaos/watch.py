"""Watch: the daemon's process from outside, and its log file; feeds DaemonRecord."""

import asyncio
import contextlib
import json
import os
import time
from pathlib import Path

from tests.support.chaos.children import Daemon
from tests.support.chaos.connection import Connection
from tests.support.chaos.daemon_record import MIB, DaemonRecord, Health, Sample
from tests.support.chaos.names import WATCH_ADDRESS
from tests.support.chaos.requests import http

SAMPLE_S = 0.1
REQUEST_INTERVAL_S = 0.5
REQUEST_TIMEOUT_S = 10.0
SCAN_BYTES = 4 * MIB  # of log, a sample: a flood of it is counted, and need not be read
DEADLY_MEMORY_BYTES, DEADLY_LOG_BYTES = 2048 * MIB, 256 * MIB  # then it is killed: the machine is others' too
CLOSE = b"Connection: close\r\n"
_PAGE = os.sysconf("SC_PAGE_SIZE")


class Watch:
    """Samples until it is cancelled, or the process has ended."""

    def __init__(self, daemon: Daemon, record: DaemonRecord, *, patience_s: float = REQUEST_TIMEOUT_S) -> None:
        self._daemon, self._log, self._record, self._patience_s = daemon, daemon.log, record, patience_s
        self._scanned = 0
        self._pid, self._turn, self._turns_before = 0, (0.0, 0.0), (0.0, 0.0)  # of all processes before this one
        self.is_deadly = self._is_ending = False

    @property
    def _process(self) -> Path:
        """Folder in /proc of the current daemon."""
        return Path(f"/proc/{self._daemon.child.pid}")

    def stop_requests(self) -> None:
        """The daemon is ending: it may answer no more."""
        self._is_ending = True

    async def sample_all(self) -> None:
        """Every SAMPLE_S."""
        while True:
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                if not self._daemon.is_away:
                    self.sample()
            await asyncio.sleep(SAMPLE_S)

    def sample(self) -> None:
        """Add one sample, and what is new in the log."""
        now_s = time.monotonic()
        log_bytes = self._log.stat().st_size
        memory_bytes = int((self._process / "statm").read_text().split()[1]) * _PAGE
        ran_s, waited_s = self._scheduled()
        descriptors = len(list((self._process / "fd").iterdir()))
        self._record.add_sample(
            Sample(now_s, memory_bytes, log_bytes, descriptors, self._most_descriptors(), ran_s, waited_s)
        )
        self.scan(now_s)
        self.is_deadly = memory_bytes > DEADLY_MEMORY_BYTES or log_bytes > DEADLY_LOG_BYTES

    def scan(self, now_s: float) -> None:
        """Read what is new in the log, whole lines; of a flood only the beginning."""
        size = self._log.stat().st_size
        with self._log.open("rb") as log:
            log.seek(self._scanned)
            text = log.read(SCAN_BYTES)
        whole = text[: text.rfind(b"\n") + 1]
        self._scanned = size if len(text) == SCAN_BYTES else self._scanned + len(whole)
        self._record.add_log(whole, now_s)

    async def poll_health(self) -> None:
        """Every REQUEST_INTERVAL_S: its health, and how many robots it knows."""
        while True:
            requested_s = time.monotonic()
            status, _ = await self.get("/healthz")
            if self._is_ending:
                return
            if self._daemon.is_away or not (self._process / "fd").exists():
                await asyncio.sleep(REQUEST_INTERVAL_S)
                continue
            self._record.add_health(Health(requested_s, time.monotonic() - requested_s, status))
            status, body = await self.get("/api/robots")
            if status == 200:
                robots = json.loads(body)["robots"]
                self._record.add_robots([robot["connected"] for robot in robots], time.monotonic())
            await asyncio.sleep(REQUEST_INTERVAL_S)

    async def get(self, path: str) -> tuple[int, bytes]:
        """(status, body) over a connection of its own; status 0: no answer."""
        answer = b""
        with contextlib.suppress(OSError, TimeoutError):
            async with asyncio.timeout(self._patience_s):
                connection = await Connection.dial(self._daemon.api, WATCH_ADDRESS, "watch")
                try:
                    await connection.send(http("GET", path, headers=CLOSE))
                    while data := await connection.receive():
                        answer += data
                finally:
                    connection.close()
        head, _, body = answer.partition(b"\r\n\r\n")
        words = head.split()
        return (int(words[1]) if len(words) > 1 and words[1].isdigit() else 0), body

    def _scheduled(self) -> tuple[float, float]:
        """Return the seconds that the main threads ran and waited for a core; zeros where they are not counted."""
        pid = self._daemon.child.pid
        try:
            ran_ns, waited_ns, _ = Path(f"/proc/{pid}/schedstat").read_text().split()
        except FileNotFoundError:
            return 0.0, 0.0
        if pid != self._pid:
            (ran_s, waited_s), (more_ran_s, more_waited_s) = self._turns_before, self._turn
            self._pid, self._turns_before = pid, (ran_s + more_ran_s, waited_s + more_waited_s)
        self._turn = int(ran_ns) / 1e9, int(waited_ns) / 1e9
        stopped_s = 0.0 if self._daemon.part is None else self._daemon.part.stopped_s
        return self._turns_before[0] + self._turn[0], self._turns_before[1] + self._turn[1] + stopped_s

    def _most_descriptors(self) -> int:
        for line in (self._process / "limits").read_text().splitlines():
            if line.startswith("Max open files"):
                return int(line.split()[3])
        raise ValueError("a process has a limit of open files")
