"""Drive a square by odometry, and print the pose at each corner.

Needs a running daemon with robot_0: start `hostlink demo`, then run `python square.py`. A real robot needs a
metre of free floor in front and to the left.
"""

import argparse
import asyncio
import math
from collections.abc import AsyncIterator

import hostlink.client
from hostlink.client import Odometry, Robot

SPEED_M_S = 0.2
TURN_RAD_S = 1.0
REACTION_S = 0.1  # from a pose to the stop that it causes


async def stop(robot: Robot, poses: AsyncIterator[Odometry]) -> None:
    """Stop, and wait until the wheels are still: they should not be reversed while they roll."""
    await robot.stop()
    async for odometry in poses:
        twist = odometry["twist"]
        if abs(twist["linear_m_s"]) < 0.005 and abs(twist["angular_rad_s"]) < 0.05:
            return


async def go(robot: Robot, poses: AsyncIterator[Odometry], distance_m: float) -> None:
    start = (await anext(poses))["pose"]
    async for odometry in poses:
        pose, twist = odometry["pose"], odometry["twist"]
        gone_m = math.hypot(pose["x_m"] - start["x_m"], pose["y_m"] - start["y_m"])
        if gone_m + twist["linear_m_s"] * REACTION_S >= distance_m:
            break
        await robot.drive(SPEED_M_S, 0.0)
    await stop(robot, poses)


async def turn_to(robot: Robot, poses: AsyncIterator[Odometry], heading_rad: float) -> None:
    direction = 0.0
    async for odometry in poses:
        left_rad = math.remainder(heading_rad - odometry["pose"]["theta_rad"], math.tau)
        direction = direction or math.copysign(1.0, left_rad)
        if left_rad * direction <= abs(odometry["twist"]["angular_rad_s"]) * REACTION_S:
            break
        await robot.drive(0.0, direction * TURN_RAD_S)
    await stop(robot, poses)


async def main(side_m: float, url: str, sides: int) -> None:
    async with hostlink.client.connect(url) as host:
        robot = host.robot("robot_0")
        poses = robot.odometry()
        heading_rad = (await anext(poses))["pose"]["theta_rad"]
        for corner in range(1, sides + 1):
            await go(robot, poses, side_m)
            await turn_to(robot, poses, heading_rad + corner * math.pi / 2)
            print((await anext(poses))["pose"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("side_m", nargs="?", type=float, default=0.5, help="length of a side in m (%(default)s)")
    parser.add_argument("url", nargs="?", default=hostlink.client.DEFAULT_URL, help="of the daemon (%(default)s)")
    parser.add_argument("sides", nargs="?", type=int, default=4, help="number of sides (%(default)s)")
    arguments = parser.parse_args()
    asyncio.run(main(arguments.side_m, arguments.url, arguments.sides))
