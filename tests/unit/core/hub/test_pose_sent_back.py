"""Board that sends back the poses that it was given: they are not its odometry."""

import asyncio
import struct

from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.feedback import SENT_BACK
from tests.support.fake_device import topic
from tests.support.memory_hub import MemoryHub, in_hub
from tests.support.participants import ROBOT, publish

GIVEN, ODOMETRY = 101, 125
INFOS = [
    topic(EndpointKind.SUBSCRIBER, 100, f"/{ROBOT}/cmd_vel", "geometry_msgs/Twist"),
    topic(EndpointKind.SUBSCRIBER, GIVEN, "/pose2D", "geometry_msgs/Pose2D"),
    topic(EndpointKind.PUBLISHER, ODOMETRY, f"/{ROBOT}/odom", "geometry_msgs/Pose2D"),
]


def test_pose_that_is_sent_back_is_not_odometry_and_is_a_finding() -> None:
    async def test(made: MemoryHub) -> None:
        device = await made.connect(INFOS)
        robot = made.robot()
        for number in range(30):
            publish(made.hub, "/pose2D", struct.pack("<3d", number / 10, 0, 0), type_name="geometry_msgs/Pose2D")
            await asyncio.sleep(0.1)
            await device.send(ODOMETRY, device.payloads(GIVEN)[-1])
        await asyncio.sleep(1.0)
        assert robot.odometry.count == SENT_BACK - 1
        assert robot.measured(asyncio.get_running_loop().time()) is None
        assert robot.state(made.now_s).odometry is None  # also those before it was known
        assert robot.why_unknown() == f"it sent {31 - SENT_BACK} poses that it was given in the last 30 s"
        assert "pose_sent_back" in robot.state(asyncio.get_running_loop().time()).device_errors
        await device.send(ODOMETRY, struct.pack("<3d", 0.5, 0.25, 0))
        await asyncio.sleep(0.1)
        odometry = robot.state(made.now_s).odometry
        assert odometry is not None
        assert odometry.pose == (0.5, 0.25, 0.0)

    in_hub(test)
