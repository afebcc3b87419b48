"""The Python API for people who drive robots: what a script needs of a running hostlink, over its WebSocket and REST.

async with hostlink.client.connect() as host:
    robot = host.robot("robot_0")
    await robot.drive(0.2, 0.5)              # m/s, rad/s; holds until the next drive, stop, or the end of the block
    async for odometry in robot.odometry():
        print(odometry["pose"]["x_m"])

In a program without asyncio, and in Jupyter, connect_blocking() has the same without `async` and `await`:

with hostlink.client.connect_blocking() as host:
    host.robot("robot_0").drive(0.2, 0.5)

Whatever cannot be done is a HostlinkError whose text says what to do. docs/client.md has complete examples.
"""

from hostlink.client.blocking import BlockingHost, BlockingRobot, connect_blocking
from hostlink.client.host import DEFAULT_URL, Host, connect
from hostlink.client.loop_thread import Messages, Opened, Stream
from hostlink.client.mailbox import Mailbox
from hostlink.client.robot import PRIORITY, Robot
from hostlink.client.views import (
    CommandEndpoint,
    ConnectionChange,
    Driven,
    Event,
    Motion,
    MotionKind,
    MotionOutcome,
    Odometry,
    Pose,
    Progress,
    RawMessage,
    Refusal,
    RobotState,
    Stopped,
    StoppedRobot,
    TopicState,
    Twist,
)
from hostlink.core.robot.standstill import Standstill, StandstillState
from hostlink.errors import CommandRefused, HostlinkError, NothingArrived, Refused, StopFailed

__all__ = [
    "DEFAULT_URL",
    "PRIORITY",
    "BlockingHost",
    "BlockingRobot",
    "CommandEndpoint",
    "CommandRefused",
    "ConnectionChange",
    "Driven",
    "Event",
    "Host",
    "HostlinkError",
    "Mailbox",
    "Messages",
    "Motion",
    "MotionKind",
    "MotionOutcome",
    "NothingArrived",
    "Odometry",
    "Opened",
    "Pose",
    "Progress",
    "RawMessage",
    "Refusal",
    "Refused",
    "Robot",
    "RobotState",
    "Standstill",
    "StandstillState",
    "StopFailed",
    "Stopped",
    "StoppedRobot",
    "Stream",
    "TopicState",
    "Twist",
    "connect",
    "connect_blocking",
]
