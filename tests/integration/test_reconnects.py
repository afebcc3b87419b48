"""A device that reconnects a thousand times and disconnects in every way leaves nothing behind."""

import asyncio
import gc
import os
from pathlib import Path

import pytest

from hostlink.core.protocol.rosserial.frame import encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import FakeDevice, fake_device, pose, robot_topics
from tests.support.resources import in_use
from tests.support.waiting import expect

RECONNECTS = 1000
SAMPLE_EVERY = 50
WARM_UP = 300  # by then caches and pools have their size
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
GROWTH_BYTES = 1_000_000  # of 700 reconnects: a kilobyte kept of each would be seen


async def come_and_vanish(host: Daemon, turn: int) -> None:
    """Negotiate, speak and leave: with an end, a reset, half a frame; or leave at once without a word."""
    async with fake_device(host.tcp, robot_topics() if turn % 5 else None) as device:
        match turn % 4:
            case 0:
                await device.send(pose(float(turn)))
            case 1:
                device.break_off()
            case 2:
                await device.send(encode(125, bytes(24))[:17])
            case _:
                await drive(host, device, turn)


async def drive(host: Daemon, device: FakeDevice, turn: int) -> None:
    """A robot that vanishes while it is driven."""
    if turn % 5:
        await host.rest("PUT", "/api/robots/robot_0/velocity", b'{"linear": 0.1, "angular": 0.0}')
        await device.velocity()


def resident_bytes() -> int:
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_BYTES


@pytest.mark.long
async def test_a_thousand_reconnects_leave_nothing_behind() -> None:
    samples = []
    async with daemon() as host:
        for turn in range(RECONNECTS):
            await come_and_vanish(host, turn)
            if turn % SAMPLE_EVERY == 0:
                await expect(lambda: not host.hub.links.all())
                samples.append((in_use(), resident_bytes()))
        await expect(lambda: not host.hub.links.all())
        assert not host.hub.isolation.crashes
        velocities = [f"/robot_0/{leaf}" for leaf in ("cmd_vel", "cmd_vel_stamped", "velocity_commands")]
        assert [topic.name for topic in host.hub.topics.all()] == ["/diagnostics", *velocities, "/rosout"]
        assert not [task for task in asyncio.all_tasks() if task.get_name().startswith("link")]
    steady = samples[WARM_UP // SAMPLE_EVERY :]
    for counts in zip(*(counts for counts, _ in steady), strict=True):
        assert max(counts) - min(counts) <= 2, samples  # one that just ends, one of the API's client
    assert steady[-1][1] - steady[0][1] < GROWTH_BYTES, samples
