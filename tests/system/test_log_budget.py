"""A device cannot fill the disk with the daemon's log."""

import asyncio
import json
import signal
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.runtime.log_budget import BURST_LINES, RATE_HZ
from tests.support.fake_device import fake_device, robot_topics
from tests.support.process import serve
from tools.crowd import parameters, topic_infos

Flood = Callable[[tuple[str, int], bytes], Awaitable[None]]
FLOOD_S = 0.7
CONNECTIONS = 400
LINE_BYTES = 1000  # more than any line here has


def logs(count: int) -> bytes:
    text = b"the battery is low"
    return encode(Id.LOG, struct.pack("<BI", 2, len(text)) + text) * count


async def flood(address: tuple[str, int], block: bytes) -> None:
    """From one connection, as fast as it is taken."""
    async with fake_device(address, robot_topics("flood"), local_host="127.0.0.5") as device:
        device.limit_send_buffer(65536)  # else `send` fills megabytes, and waits for them
        end_s = asyncio.get_running_loop().time() + FLOOD_S
        while asyncio.get_running_loop().time() < end_s:
            await device.send(block)
        device.break_off()


async def reconnect(address: tuple[str, int], _: bytes) -> None:
    """A connection after the other; each causes two lines at least."""
    for _ in range(CONNECTIONS):
        async with fake_device(address, local_host="127.0.0.5") as device:
            await device.frame(Id.PUBLISHER)  # so it is a link, not one that was refused


@pytest.mark.parametrize(
    ("work", "block"),
    [
        pytest.param(flood, logs(500), id="logs"),
        pytest.param(flood, topic_infos(500), marks=pytest.mark.long, id="refused topics"),
        pytest.param(flood, parameters(2000), marks=pytest.mark.long, id="unknown parameters"),
        pytest.param(reconnect, b"", id="connections"),
    ],
)
async def test_a_flood_of_lines_is_cut_and_counted(work: Flood, block: bytes, tmp_path: Path) -> None:
    log, now_s = tmp_path / "log", asyncio.get_running_loop().time
    began_s = now_s()
    async with serve(log=log) as daemon, fake_device(daemon.tcp, robot_topics()) as honest:
        await work(daemon.tcp, block)
        assert await honest.velocity() == (0.0, 0.0)
        assert await daemon.end(signal.SIGTERM) == 0
    lines = [json.loads(line) for line in log.read_bytes().splitlines()]
    allowed = BURST_LINES + RATE_HZ * (now_s() - began_s) + 30
    assert len(lines) < allowed
    assert log.stat().st_size < allowed * LINE_BYTES
    reported = [line for line in lines if line["event"] == "log.lines_left_out" and line["about"] == "127.0.0.5"]
    assert sum(line["lines"] for line in reported) > 100
    assert [line["reason"] for line in lines if line["event"] == "link.closed" and line["peer"].startswith("127.0.0.1")]
