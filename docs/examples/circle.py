"""Drive a part of a circle and print the path.

Needs a running daemon with robot_0: start `hostlink demo`, then run `python circle.py`. The robot drives for five
seconds and stops. The same lines work in the cells of a notebook.
"""

import argparse
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("poses", nargs="?", type=int, default=50, help="number of poses to drive for (%(default)s)")
    parser.add_argument("url", nargs="?", default=hostlink.client.DEFAULT_URL, help="of the daemon (%(default)s)")
    arguments = parser.parse_args()
    print(__doc__)
    try:
        main(arguments.poses, arguments.url)
    except hostlink.client.HostlinkError as error:
        sys.exit(str(error))
