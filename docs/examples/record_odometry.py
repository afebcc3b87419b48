"""Record a robot's odometry to a CSV file, also over cuts of the network; Ctrl-C ends it.

python record_odometry.py FILE [COUNT [URL]]
"""

import asyncio
import contextlib
import csv
import itertools
import sys
from pathlib import Path

import hostlink.client
from hostlink.client import Host

COLUMNS = ("stamp_s", "x_m", "y_m", "theta_rad", "linear_m_s", "angular_rad_s")


async def report_cuts(host: Host) -> None:
    async for change in host.connection():
        print("connected again" if change.is_connected else change.reason, file=sys.stderr)


async def main(path: Path, count: int | None, url: str) -> None:
    async with hostlink.client.connect(url) as host, asyncio.TaskGroup() as tasks:
        reporting = tasks.create_task(report_cuts(host))
        with path.open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(COLUMNS)
            numbers = itertools.count(1)
            async for odometry in host.robot("robot_0").odometry():
                pose, twist = odometry["pose"], odometry["twist"]
                table.writerow((odometry["stamp_ns"] / 1e9, *pose.values(), *twist.values()))
                if next(numbers) == count:
                    break
        reporting.cancel()


if __name__ == "__main__":
    count = int(sys.argv[2]) if len(sys.argv) > 2 else None
    url = sys.argv[3] if len(sys.argv) > 3 else hostlink.client.DEFAULT_URL
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(main(Path(sys.argv[1]), count, url))
