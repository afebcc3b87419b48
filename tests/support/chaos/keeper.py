"""DaemonKeeper: what the generator requests of the daemon's own process, done one thing after the other."""

import asyncio
import os
import signal
import struct
import time
from collections.abc import Callable
from typing import Any

from tests.support.chaos.children import Daemon
from tests.support.chaos.connection import Connection
from tests.support.chaos.drive_record import DriveRecord
from tests.support.chaos.limits import Limits
from tests.support.chaos.names import WATCH_ADDRESS
from tests.support.chaos.noise import Noise
from tests.support.chaos.requests import http
from tests.support.chaos.violation import Violation

REST_S = 1.0  # after a pause or a restart: what is judged needs a daemon that runs
BLOCK_S = 1.5  # a reload from a FIFO waits for so long, unless the signal or REST did not come through
ANSWER_S = 3.0
ROBOTS = 3000  # of a large file


class DaemonKeeper:
    """Requests that come while another is under way are dropped: the plan draws more than enough."""

    def __init__(
        self, daemon: Daemon, noise: Noise, drive: DriveRecord, limits: Limits, note: Callable[[list[Violation]], None]
    ) -> None:
        self._daemon, self._noise, self._drive, self._limits, self._note = daemon, noise, drive, limits, note
        self._requests: asyncio.Queue[dict[str, Any]] = asyncio.Queue(1)
        self._is_idle = asyncio.Event()
        self._is_idle.set()
        self._is_over = False
        self.counts = {"pauses": 0, "restarts": 0, "reloads": 0, "jumps": 0}

    def request(self, facts: dict[str, Any]) -> None:
        """Queue a disturbance that the generator requests."""
        if self._is_idle.is_set() and not self._is_over:
            self._is_idle.clear()
            self._requests.put_nowait(facts)

    async def finish(self) -> None:
        """Stop after the current disturbance."""
        self._is_over = True
        await self._is_idle.wait()

    async def run(self) -> None:
        """Until it is cancelled."""
        while True:
            facts = await self._requests.get()
            try:
                await getattr(self, f"_{facts['daemon']}")(facts)
            finally:
                self._is_idle.set()

    async def _pause(self, facts: dict[str, Any]) -> None:
        self.counts["pauses"] += 1
        began_s = time.monotonic()
        self._noise.pause(began_s)
        self._drive.daemon_paused(began_s)
        with self._daemon.signalled(signal.SIGSTOP, signal.SIGCONT):
            await asyncio.sleep(facts["seconds"])
        ended_s = time.monotonic()
        self._noise.pause(began_s, ended_s)
        self._drive.daemon_resumed(ended_s)
        await asyncio.sleep(REST_S)

    async def _restart(self, facts: dict[str, Any]) -> None:
        self.counts["restarts"] += 1
        number = signal.Signals[f"SIG{facts['signal']}"]
        self._daemon.is_away = True
        began_s = time.monotonic()
        self._noise.absence(began_s)
        self._drive.daemon_left(began_s, number.name)
        status = await self._daemon.end(number, 5 * self._limits.end_s)
        if number is signal.SIGTERM:
            self._judge_end(status, began_s)
        await self._daemon.start()
        ended_s = time.monotonic()
        self._noise.absence(began_s, ended_s)
        self._drive.daemon_came(ended_s)
        self._daemon.is_away = False
        await asyncio.sleep(REST_S)

    def _judge_end(self, status: int | None, began_s: float) -> None:
        lasted_s = time.monotonic() - began_s
        limit_s = self._limits.end_s * self._noise.stretch(began_s, time.monotonic())
        if lasted_s > limit_s:
            self._note([Violation("SIGTERM ends the daemon, s", lasted_s, limit_s, at_s=began_s)])
        if status != 0:
            self._note([Violation("SIGTERM ends the daemon with status 0", status or -1, 0, at_s=began_s)])

    async def _reload(self, facts: dict[str, Any]) -> None:
        """Reload changed settings. Afterwards the file is valid, and a reader of a FIFO reads its end."""
        self.counts["reloads"] += 1
        kind, file = facts["settings"], self._daemon.settings_file
        good = self._daemon.settings()
        beside = file.with_suffix(".new")
        try:
            if kind == "gone":
                file.unlink()
            elif kind == "blocking":
                os.mkfifo(beside)
                beside.replace(file)
            else:
                beside.write_text(_changed(kind, good))
                beside.replace(file)
            if facts["by_signal"]:
                self._daemon.child.send_signal(signal.SIGUSR1)
            else:
                await self._ask_to_reload()
            await asyncio.sleep(BLOCK_S if kind == "blocking" else 0.1)
        finally:
            if kind == "blocking":
                _release(file, good)
            beside.write_text(good)
            beside.replace(file)

    async def _ask_to_reload(self) -> None:
        try:
            connection = await Connection.dial(self._daemon.api, WATCH_ADDRESS, "watch")
        except OSError:
            return
        try:
            await connection.send(http("POST", "/api/reload", headers=b"Connection: close\r\n"))
            await connection.receive_until(b"\r\n\r\n", BLOCK_S)
        except OSError:
            return
        finally:
            connection.close()

    async def _clock(self, facts: dict[str, Any]) -> None:
        self.counts["jumps"] += 1
        with self._daemon.clock_file.open("r+b") as file:  # not anew: the daemon has it mapped
            file.write(struct.pack("<q", facts["jump_s"]))


def _changed(kind: str, good: str) -> str:
    if kind == "large":
        return good + "".join(f"[robots.many_{number}]\nmax_linear_m_s = 0.5\n" for number in range(ROBOTS))
    return {"wrong": good + "[api]\nno_such_setting = 1\n", "half": good[: len(good) // 2] + '"'}.get(kind, good)


def _release(file: os.PathLike[str], good: str) -> None:
    """Write valid settings to a waiting reader of the FIFO; a later reader finds the valid file."""
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_NONBLOCK)
    except OSError:
        return  # the FIFO has no reader
    try:
        os.write(descriptor, good.encode())
    finally:
        os.close(descriptor)
