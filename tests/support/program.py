"""A roslibpy program, as its users write them: publishes velocity, reads odometry. A test runs it as a process.

Prints one JSON object: how many poses came, the first and the last of them.
"""

import json
import sys
import threading
import time

import roslibpy


def main() -> None:
    host, port, robot = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    ros = roslibpy.Ros(host=host, port=port)
    ros.run(timeout=10)
    poses: list[dict[str, float]] = []
    has_moved = threading.Event()

    def on_odometry(pose: dict[str, float]) -> None:
        poses.append(pose)
        if pose["x"] - poses[0]["x"] > 0.05:
            has_moved.set()

    odometry = roslibpy.Topic(ros, f"/{robot}/odometry", "geometry_msgs/Pose2D")
    odometry.subscribe(on_odometry)
    velocity = roslibpy.Topic(ros, f"/{robot}/velocity_commands", "geometry_msgs/Twist")
    velocity.advertise()
    deadline_s = time.monotonic() + 20
    while not has_moved.is_set() and time.monotonic() < deadline_s:
        velocity.publish(roslibpy.Message({"linear": {"x": 0.3}, "angular": {"z": 0.0}}))
        time.sleep(0.1)
    odometry.unsubscribe()
    velocity.unadvertise()
    sys.stdout.write(json.dumps({"count": len(poses), "first": poses[0], "last": poses[-1]}))
    ros.terminate()


if __name__ == "__main__":
    main()
