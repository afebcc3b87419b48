"""Robot: a device that subscribes to a Twist and publishes its pose."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import structlog

from hostlink.config import RobotConfig
from hostlink.errors import BadPayload
from hostlink.hub.drivable import Drivable
from hostlink.hub.message import Message
from hostlink.link.link import Link
from hostlink.robot.directory import RobotTopicNames
from hostlink.robot.odometry_estimator import OdometryEstimator
from hostlink.robot.odometry_reader import READERS
from hostlink.robot.velocity import PlanarVelocity
from hostlink.robot.velocity_gate import VelocityGate

log = structlog.get_logger()


@dataclass(slots=True, eq=False, kw_only=True)
class Robot(Drivable):
    """It outlives its link: a robot that comes back continues with the same gate, at zero."""

    gate: VelocityGate[PlanarVelocity]
    config: RobotConfig
    odometry: OdometryEstimator
    topics: RobotTopicNames  # as its device names them
    shown: RobotTopicNames  # as the graph names them
    locked_link: Link | None = None  # the one that it had when it was locked
    is_played: bool = False  # its device is a recording, and obeys nobody
    host: None = None  # it is here
    also_at: tuple[str, ...] = ()  # other daemons that have a robot of this name
    unreadable: int = 0  # messages of its odometry that are none
    velocities: dict[str, str] = field(default_factory=dict)  # its device's velocity topics as shown, and as named
    heard: frozenset[str] = frozenset()  # topics that its gate subscribes to, also while its device is away
    resumed_link: int = 0  # the link since which no reconnection was an interruption
    followers: dict[Hashable, Callable[[Message | None], None]] = field(
        default_factory=dict
    )  # receive what were new poses

    def receive_odometry(self, message: Message) -> None:
        """A message of its odometry's topic. A pose belongs to the robot of the link by which it came."""
        if message.source is not self.link or message.type_name != self.topics.odometry_type:
            return
        count = self.odometry.count
        try:
            reading = READERS[message.type_name](message.payload)
        except BadPayload as error:
            self.unreadable += 1
            log.debug("odometry.unreadable", robot=self.name, reason=str(error))
            return
        stamp_ns = message.stamp_ns
        if reading.stamp_ns is not None and self.link is not None:  # by the device's clock
            stamp_ns = self.link.session.device_clock.to_host_ns(reading.stamp_ns, stamp_ns)
        self.odometry.update(reading.pose, now_s=message.at_s, wall_ns=stamp_ns, twist=reading.twist)
        if self.odometry.count > count:
            for follow in tuple(self.followers.values()):  # one may leave meanwhile
                follow(message)
