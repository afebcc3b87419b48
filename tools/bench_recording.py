"""`make bench`, fifth part: cost of a recording at 10,000 messages a second.

Meanwhile, a program drives a robot 50 times a second. Writes build/bench_recording.json and prints a table; ends with
status 1 when a message is dropped, the recording costs more than its bound, or commands are later with it.
"""

import argparse
import asyncio
import json
import statistics
import struct
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import aiohttp

from hostlink.recording.reader import McapReader
from tests.support.process import HOSTLINK, serve
from tools.bench_crowd import MANY, ROOT, Load, cpu_s, crowd, driven, peak_memory_mib, read_away

DEVICES = 10  # of 1,000 messages a second each
TOPICS = "*/odometry"  # without the topics that hostlink derives on demand: odom and tf
CORE_BOUND = 0.15  # more than without
P99_FACTOR, P99_SLACK_S = 1.5, 0.003


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "bench_recording.json")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each of the two")
    arguments = parser.parse_args()
    rows = [asyncio.run(measure(arguments.seconds, is_recorded=is_recorded)) for is_recorded in (False, True)]
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(rows, indent=1) + "\n")
    for row in rows:
        times = f"command median {row['median_ms']:.2f} ms, p99 {row['p99_ms']:.2f} ms"
        costs = f"{row['core']:.1%} of a core, {row['memory_mib']:.0f} MiB"
        print(
            f"{row['what']:<20} {row['messages_s']:>8,.0f} messages/s  {costs}  {times}, "
            f"{row['superseded']} superseded  {row['dropped']} dropped"
        )
    without, recorded = rows
    problems = [
        f"{recorded['dropped']} messages were dropped" if recorded["dropped"] else "",
        f"{recorded['missing']} messages are not in the file" if recorded["missing"] else "",
        "too few messages are in the file" if recorded["in_file"] < 0.9 * recorded["poses"] else "",
        "recording costs too much" if recorded["core"] - without["core"] > CORE_BOUND else "",
        "commands are later beside it"
        if recorded["p99_ms"] > P99_FACTOR * without["p99_ms"] + 1000 * P99_SLACK_S
        else "",
    ]
    print(*(problem for problem in problems if problem), sep="\n", end="")
    return 1 if any(problems) else 0


async def measure(seconds: float, *, is_recorded: bool) -> dict[str, Any]:
    """One row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        recordings = Path(folder) / "recordings"
        config = Path(folder) / "hostlink.toml"
        config.write_text(f'{MANY}[recording]\nfolder = "{recordings}"\nmin_free_disk_mb = 0\n')
        load = Load("steady", "steady", DEVICES, seconds)
        async with serve("--config", str(config), program=(HOSTLINK,)) as daemon, asyncio.TaskGroup() as tasks:
            reading = tasks.create_task(read_away(daemon))
            async with driven(daemon) as robot, aiohttp.ClientSession(daemon.url) as session:
                if is_recorded:
                    await session.post("/api/recordings", json={"name": "run", "topics": [TOPICS]})
                async with crowd(load, daemon) as visitors:
                    before_s, began_s = cpu_s(daemon), asyncio.get_running_loop().time()
                    latencies = await robot.drive(seconds)
                    counts = await visitors()
                    used_s, lasted_s = cpu_s(daemon) - before_s, asyncio.get_running_loop().time() - began_s
                view: dict[str, Any] = {"dropped": 0}
                if is_recorded:
                    async with session.post("/api/recordings/run/stop") as answer:
                        view = await answer.json()
            memory_mib = peak_memory_mib(daemon)
            reading.cancel()
        in_file, missing = missing_in(recordings)
    return {
        "what": "recorded" if is_recorded else "not recorded",
        "messages_s": counts["poses"] / lasted_s,
        "core": used_s / lasted_s,
        "memory_mib": memory_mib,
        "median_ms": statistics.median(latencies) * 1000,
        "p99_ms": statistics.quantiles(latencies, n=100)[98] * 1000,
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
