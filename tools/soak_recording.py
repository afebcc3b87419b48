"""An hour of thirty robots, recorded as fast as the disk takes it: the memory must stay flat, and nothing be dropped.

Time is shortened by feeding, not by a clock: as many messages as in that time, one after the other through the hub.
Files are split by size as they would be in an hour. Prints one line of JSON; status 1 when memory grew or a message
was dropped.
"""

import argparse
import asyncio
import json
import os
import resource
import struct
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import structlog

from hostlink.components.recorder.recorder import TopicSelection
from hostlink.components.recorder.settings import RecordingConfig
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.messages.catalog import Catalog
from tests.support.hosts import recordings_of

RATE_HZ = 10
TOPICS = (("odometry", "geometry_msgs/Pose2D", "<3d"), ("plot_data", "geometry_msgs/Twist", "<6d"))
MAX_AHEAD = 4096  # messages that the disk has not taken yet
WARM_SHARE = 0.25  # of the messages, before memory is measured the first time
MEBIBYTE = 1024 * 1024
GROWTH_MIB = 12.0  # what the indices of one file may take, and the allocator's rest


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--file-mb", type=float, default=None, help="split at; as configured by default")
    arguments = parser.parse_args()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(40))
    with tempfile.TemporaryDirectory() as folder:
        sizes = {} if arguments.file_mb is None else {"max_file_mb": arguments.file_mb}
        config = Config().with_tables(recording=RecordingConfig(folder=Path(folder), min_free_disk_mb=0.0, **sizes))
        found = asyncio.run(soak(config, arguments.robots, arguments.minutes))
    sys.stdout.write(json.dumps(found) + "\n")
    return 1 if found["dropped"] or found["grown_mib"] > GROWTH_MIB else 0


async def soak(config: Config, robots: int, minutes: float) -> dict[str, float]:
    """Record that much, and measure."""
    hub = Hub(config, Catalog())
    ticks = int(minutes * 60 * RATE_HZ)
    begun_s = time.monotonic()
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(hub.run())
        await hub.is_running.wait()
        recordings = recordings_of(hub)
        publishers = [(hub.join(f"robot_{number}"), f"/robot_{number}") for number in range(robots)]
        for participant, name in publishers:
            for leaf, type_name, _ in TOPICS:
                participant.advertise(f"{name}/{leaf}", type_name)
        thread = (await recordings.start(TopicSelection())).thread
        await asyncio.sleep(0.2)  # it subscribes to what is there
        warm_mib, sent = 0.0, 0
        for tick in range(ticks):
            if tick == int(ticks * WARM_SHARE):
                warm_mib = memory_mib()
            for participant, name in publishers:
                for leaf, _, layout in TOPICS:
                    values = [tick / RATE_HZ] * int(layout[1])
                    participant.publish(f"{name}/{leaf}", struct.pack(layout, *values))
                    sent += 1
            await asyncio.sleep(0)
            while sent - thread.messages - thread.dropped > MAX_AHEAD:  # noqa: ASYNC110 - counts of another thread
                await asyncio.sleep(0.001)
        grown_mib = memory_mib() - warm_mib
        await recordings.aclose()
        running.cancel()
    return {
        "messages": thread.messages,
        "sent": sent,
        "dropped": thread.dropped,
        "files": len(thread.paths),
        "seconds": round(time.monotonic() - begun_s, 1),
        "memory_mib": round(warm_mib + grown_mib, 1),
        "peak_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        "grown_mib": round(grown_mib, 1),
    }


def memory_mib() -> float:
    """Resident, of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MEBIBYTE


if __name__ == "__main__":
    sys.exit(main())
