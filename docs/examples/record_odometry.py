"""Record the odometry of robot_0 to a CSV file, also across cuts of the network.

Needs a running daemon with robot_0: start `hostlink demo`, then run `python record_odometry.py`. It writes
odometry.csv until Ctrl-C.
"""

import argparse
import asyncio
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="?", type=Path, default=Path("odometry.csv"), help="to write (%(default)s)")
    parser.add_argument("count", nargs="?", type=int, help="number of poses (until Ctrl-C)")
    parser.add_argument("url", nargs="?", default=hostlink.client.DEFAULT_URL, help="of the daemon (%(default)s)")
    arguments = parser.parse_args()
    print(__doc__)
    try:
        asyncio.run(main(arguments.file, arguments.count, arguments.url))
    except KeyboardInterrupt:
        print(f"wrote {arguments.file}")
    except hostlink.client.HostlinkError as error:
        sys.exit(str(error))
