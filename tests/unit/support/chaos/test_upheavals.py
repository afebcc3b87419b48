"""The tools of upheavals: a wall clock that jumps in a process, a fleet's port that answers whom it must not."""

import asyncio
import contextlib
import os
import random
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

from tests.support.chaos import tls_strangers
from tests.support.chaos.children import Daemon
from tests.support.chaos.plan import Action
from tests.support.chaos.stage import Stage
from tests.support.chaos.tls_strangers import strangers
from tests.support.tcp_server import tcp_server

DAY_S = 86400
CLOCKS = "import time; print(time.time(), time.monotonic())"


def clocks(daemon: Daemon) -> tuple[float, float]:
    """The wall clock and the monotonic one of a process as the daemon is."""
    environment = os.environ | daemon.preloaded
    done = subprocess.run([sys.executable, "-c", CLOCKS], env=environment, capture_output=True, text=True, check=True)
    wall_s, steady_s = map(float, done.stdout.split())
    return wall_s, steady_s


def test_wall_clock_jumps_and_the_monotonic_one_does_not(tmp_path: Path) -> None:
    daemon = Daemon(tmp_path, has_udp=False)
    daemon.prepare()
    before_s, steady_before_s = clocks(daemon)
    daemon.clock_file.write_bytes(struct.pack("<q", 100 * DAY_S))
    after_s, steady_after_s = clocks(daemon)
    assert 100 * DAY_S <= after_s - before_s < 100 * DAY_S + 60
    assert 0 <= steady_after_s - steady_before_s < 60


async def reports_of(way: str, answer: bytes) -> list[dict[str, Any]]:
    """Return the reports of strangers about a port that answers with these bytes."""
    reports: list[dict[str, Any]] = []
    seed = next(str(seed) for seed in range(1000) if random.Random(str(seed)).choice(tls_strangers.WAYS) == way)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(1)
        writer.write(answer)

    async with tcp_server(serve) as address:
        stage = Stage(("", 0), ("", 0), reports.append, fleet=address)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(0.3):
                await strangers(stage, Action(1, "tls", seed, 1.0))
    return [each for each in reports if "broken" in each]


async def test_stranger_at_a_port_that_answers_without_tls_reports_it() -> None:
    assert await reports_of("plain", b"\x02\x00\x41\x09")


async def test_stranger_at_a_port_that_answers_with_an_alert_reports_nothing() -> None:
    assert not await reports_of("plain", b"\x15\x03\x03\x00\x02\x02\x32")
