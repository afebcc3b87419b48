"""Drive a part of a circle and print the path, without asyncio; the same lines work in the cells of a notebook.

python circle.py [POSES [URL]]
"""

import itertools
import math
import sys

import hostlink.client


def main(count: int, url: str) -> None:
    with hostlink.client.connect_blocking(url) as host:
        robot = host.robot("robot_0")
        accepted = robot.drive(0.2, 0.5)
        if accepted.is_limited:
            print(f"{accepted.linear_m_s} m/s instead of 0.2: {accepted.limited_by}")
        poses = [odometry["pose"] for odometry in itertools.islice(robot.odometry(), count)]
        robot.stop()

    for pose in poses:
        print(f"{pose['x_m']:+.2f} m {pose['y_m']:+.2f} m {math.degrees(pose['theta_rad']):+.0f} degrees")


if __name__ == "__main__":
    count, url, *_ = [*sys.argv[1:], *("50", hostlink.client.DEFAULT_URL)[len(sys.argv) - 1 :]]
    main(int(count), url)
