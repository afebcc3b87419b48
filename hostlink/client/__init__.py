"""The Python API for people who drive robots: what a script needs of a running hostlink, over its WebSocket and REST.

async with hostlink.client.connect() as host:
    robot = host.robot("robot_0")
    await robot.drive(0.2, 0.5)              # m/s, rad/s; holds until the next drive, stop, or the end of the block
    async for odometry in robot.odometry():
        print(odometry["pose"]["x_m"])

Whatever cannot be done is a HostlinkError whose text says what to do. docs/client.md has complete examples.
"""

from hostlink.client.host import DEFAULT_URL, Host, connect
from hostlink.client.mailbox import Mailbox
from hostlink.client.robot import PRIORITY, Robot
from hostlink.client.views import (
    ConnectionChange,
    Event,
    Odometry,
    Pose,
    RawMessage,
    Refusal,
    RobotState,
    TopicState,
    Twist,
)
from hostlink.errors import HostlinkError

__all__ = [
    "DEFAULT_URL",
    "PRIORITY",
    "ConnectionChange",
    "Event",
    "Host",
    "HostlinkError",
    "Mailbox",
    "Odometry",
    "Pose",
    "RawMessage",
    "Refusal",
    "Robot",
    "RobotState",
    "TopicState",
    "Twist",
    "connect",
]
