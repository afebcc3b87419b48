"""`make bench`, fifth part: cost of a recording at 10,000 messages a second.

Meanwhile, a program drives a robot 50 times a second. Writes build/bench_recording.json and prints a table; ends with
status 1 when a message is dropped, the recording costs more than its bound, or commands are later with it.
"""

import asyncio
import statistics
import struct
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from hostlink.components.recorder.reader import McapReader
from tests.support.process import HOSTLINK, serve
from tools.bench import Row, cpu_s, memory_mib, p99, parser, report
from tools.bench_crowd import MANY, Load, driven, visitors_of

DEVICES = 10  # of 1,000 messages a second each
TOPICS = "*/odometry"  # without the topics that hostlink derives on demand: odom and tf
CORE_BOUND = 2.0  # times the daemon's that records nothing
MEMORY_BOUND = 1.5
P99_FACTOR, P99_SLACK_S = 1.5, 0.003


def main() -> int:
    chosen = parser(__doc__, "recording").parse_args()
    without, recorded = [asyncio.run(measure(60 * chosen.share, is_recorded=yes)) for yes in (False, True)]
    beside = "times that without a recording"
    rate, alone = f"{recorded['messages_s']:,.0f} messages/s", f"{without['p99_ms']:.2f} ms without"
    return report(
        [
            Row("10,000 messages/s recorded: of a core", 100 * recorded["core"], "%", beside,
                recorded["core"] / without["core"], at_most=CORE_BOUND, note=rate),
            Row("the same: memory", recorded["memory_mib"], "MiB", beside,
                recorded["memory_mib"] / without["memory_mib"], at_most=MEMORY_BOUND),
            Row("the same: a command, median", recorded["median_ms"], "ms", beside,
                recorded["median_ms"] / without["median_ms"], note=f"{recorded['superseded']} superseded"),
            Row("the same: a command, p99", recorded["p99_ms"], "ms",
                at_most=P99_FACTOR * without["p99_ms"] + 1000 * P99_SLACK_S, note=alone),
            Row("the same: messages dropped, or missing in the file", recorded["dropped"] + recorded["missing"], "",
                at_most=0.1),
            Row("the same: messages in the file", recorded["in_file"], "", "of those sent",
                recorded["in_file"] / recorded["poses"], at_least=0.9),
        ],
        chosen.out,
    )  # fmt: skip


async def measure(seconds: float, *, is_recorded: bool) -> dict[str, Any]:
    """One row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = Path(folder) / "recordings"
        config = Path(folder) / "hostlink.toml"
        config.write_text(f'{MANY}[recording]\nfolder = "{recordings}"\nmin_free_disk_mb = 0\n')
        load = Load("steady", "steady", DEVICES, seconds)
        async with serve("--config", str(config), program=(HOSTLINK,)) as daemon:
            async with driven(daemon) as robot, aiohttp.ClientSession(daemon.url) as session:
                if is_recorded:
                    await session.post("/api/recordings", json={"name": "run", "topics": [TOPICS]})
                async with visitors_of(load, daemon) as visitors:
                    before_s, began_s = cpu_s(daemon.pid), asyncio.get_running_loop().time()
                    latencies = await robot.drive(seconds)
                    counts = await visitors()
                    used_s, lasted_s = cpu_s(daemon.pid) - before_s, asyncio.get_running_loop().time() - began_s
                view: dict[str, Any] = {"dropped": 0}
                if is_recorded:
                    async with session.post("/api/recordings/run/stop") as answer:
                        view = await answer.json()
            held_mib = memory_mib(daemon.pid, "VmHWM")
        in_file, missing = missing_in(recordings)
    return {
        "what": "recorded" if is_recorded else "not recorded",
        "messages_s": counts["poses"] / lasted_s,
        "core": used_s / lasted_s,
        "memory_mib": held_mib,
        "median_ms": statistics.median(latencies) * 1000,
        "p99_ms": p99(latencies) * 1000,
        "superseded": robot.sent.superseded,
        "dropped": view["dropped"],
        "poses": counts["poses"],
        "in_file": in_file,
        "missing": missing,
    }


def missing_in(folder: Path) -> tuple[int, int]:
    """(how many poses of the crowd are in the recording, how many are missing between the first and the last)."""
    numbers: dict[str, list[int]] = {}
    for file in sorted(folder.glob("*.mcap")):
        for message in McapReader(file).messages():
            if message.channel.topic.endswith("/odometry"):
                x_m = struct.unpack_from("<d", message.payload)[0]
                numbers.setdefault(message.channel.topic, []).append(round(x_m * 1000))
    missing = sum(found[-1] - found[0] + 1 - len(found) for found in numbers.values())
    return sum(map(len, numbers.values())), missing


if __name__ == "__main__":
    sys.exit(main())
