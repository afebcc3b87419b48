"""Drive a square by odometry, and print the result of each side and corner.

Needs a running daemon with robot_0: start `hostlink demo`, then run `python square.py`. A real robot needs a
metre of free floor in front and to the left. Ctrl-C stops the robot.
"""

import argparse
import asyncio
import math
import sys

import hostlink.client


async def main(side_m: float, url: str, sides: int) -> None:
    async with hostlink.client.connect(url) as host:
        robot = host.robot("robot_0")
        for _ in range(sides):
            for motion in (robot.move(side_m), robot.turn(math.pi / 2)):
                result = await motion
                print(f"{result.outcome}: {result.distance_m:.2f} m, {result.turned_rad:.2f} rad {result.reason}")
                if not result.is_reached:
                    return


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("side_m", nargs="?", type=float, default=0.5, help="length of a side in m (%(default)s)")
    parser.add_argument("url", nargs="?", default=hostlink.client.DEFAULT_URL, help="of the daemon (%(default)s)")
    parser.add_argument("sides", nargs="?", type=int, default=4, help="number of sides (%(default)s)")
    arguments = parser.parse_args()
    print(__doc__)
    try:
        asyncio.run(main(arguments.side_m, arguments.url, arguments.sides))
    except hostlink.client.HostlinkError as error:
        sys.exit(str(error))
