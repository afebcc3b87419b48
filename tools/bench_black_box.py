"""Cost of the black box for each message, in one process and without sockets.

Two hubs, one with a black box and one without, read poses of as many robots in turn, a few at a time, so that what
else runs on the machine disturbs both alike. Prints the processor time of a pose, from the link to a topic without
subscribers, and what the black box adds: the median over all pairs of turns.
"""

import asyncio
import contextlib
import dataclasses
import statistics
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from hostlink.components.recorder.settings import BlackBoxConfig
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.link import link
from hostlink.core.messages.catalog import Catalog
from hostlink.core.runtime import logs
from tests.support.fake_device import pose, robot_topics
from tests.support.hosts import black_box_of
from tests.support.scripted_device import ScriptedDevice
from tools.bench import Row, parser, report

READY_S = 3.0  # until every device is a robot and its topics are kept
POSES = 5  # of each robot in a turn


def main() -> int:
    arguments = parser(__doc__, "black_box")
    arguments.add_argument("--robots", type=int, default=30)
    chosen = arguments.parse_args()
    logs.configure(level="error")
    plain_us, added_us = asyncio.run(measure(chosen.robots, round(300 * chosen.share)))
    what, yardstick = f"a Pose2D of {chosen.robots} robots in process", "of that without the black box"
    return report(
        [
            Row(f"{what}, {'compiled' if is_compiled() else 'pure'}", plain_us, "us"),
            Row("the black box adds to it", added_us, "us", yardstick, added_us / plain_us, at_most=0.4),
        ],
        chosen.out,
    )


def is_compiled() -> bool:
    """Whether the modules of a compiled wheel run (`make compiled`)."""
    return not str(link.__file__).endswith(".py")


async def measure(robots: int, turns: int) -> tuple[float, float]:
    """Processor time of one message without the black box, and what it adds, in microseconds."""
    plain_us, added_us = [], []
    async with crowd(robots, is_kept=False) as plain, crowd(robots, is_kept=True) as kept:
        await asyncio.sleep(READY_S)
        for _ in range(turns):
            without_us, with_us = [await message_us(devices) for devices in (plain, kept)]
            plain_us.append(without_us)
            added_us.append(with_us - without_us)
    return statistics.median(plain_us), statistics.median(added_us)


@contextlib.asynccontextmanager
async def crowd(robots: int, *, is_kept: bool) -> AsyncIterator[list[ScriptedDevice]]:
    """The devices of a hub, with or without a black box."""
    config = Config().with_tables(black_box=dataclasses.replace(BlackBoxConfig(), enabled=is_kept))
    hub = Hub(config, Catalog(), reraises=True)
    with tempfile.TemporaryDirectory() as folder:
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(hub.run())
            await hub.is_running.wait()
            black_box = black_box_of(hub, Path(folder))
            black_box.start()
            names = [f"robot_{number}" for number in range(robots)]
            devices = [ScriptedDevice(hub, robot_topics(name), address=name) for name in names]
            yield devices
            if len(hub.robots.here()) < robots or bool(black_box.rings.size_bytes) != is_kept:
                raise AssertionError(f"{len(hub.robots.here())} robots, {black_box.rings.size_bytes} bytes kept")
            for device in devices:
                await device.aclose()
            await black_box.aclose()
            running.cancel()


async def message_us(devices: list[ScriptedDevice]) -> float:
    """Processor time of one message of a turn."""
    began_s = time.process_time()
    for number in range(POSES):
        wire = pose(number / 1000)
        for device in devices:
            device.write(wire)
        await asyncio.sleep(0)
        while any(device.link.unread_bytes for device in devices):  # noqa: ASYNC110 - there is no event
            await asyncio.sleep(0)
    return (time.process_time() - began_s) / (POSES * len(devices)) * 1e6


if __name__ == "__main__":
    sys.exit(main())
