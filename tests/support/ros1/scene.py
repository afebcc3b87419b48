"""A daemon with one robot in a graph of ROS 1 whose master is the test's."""

import asyncio
import contextlib
import dataclasses
from collections.abc import AsyncIterator
from dataclasses import dataclass

from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.xml_rpc import decode_answer
from hostlink.core.config import Config
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.robot.velocity import PlanarVelocity
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import CATALOG, FakeDevice, fake_device, robot_topics, topic
from tests.support.ros1.fake import FakeMaster, fake_master
from tests.support.waiting import expect

ODOMETRY, VELOCITY = "/robot_0/odometry", "/robot_0/velocity_commands"
STRING = "std_msgs/String"
TEXT = topic(EndpointKind.SUBSCRIBER, 102, "/text", STRING)
POSE = CATALOG.message("geometry_msgs/Pose2D")
assert POSE is not None
SUBSCRIBER = {"callerid": "/listener", "topic": ODOMETRY, "type": POSE.name, "md5sum": POSE.md5}


@dataclass
class Scene:
    """A daemon with one robot, and its master."""

    master: FakeMaster
    daemon: Daemon
    robot: FakeDevice

    @property
    def counts(self) -> dict[str, int]:
        return dict(self.daemon.hub.counts.components["ros1"]())

    async def tcpros(self) -> tuple[str, int]:
        """Return the address of the daemon's topics."""
        await self.master.knows("Publisher", ODOMETRY)
        _, host, port = decode_answer(await self.master.call("requestTopic", "/listener", ODOMETRY, [["TCPROS"]]))
        return host, port

    async def update(self, name: str, *uris: str) -> None:
        """The master reports who publishes."""
        await self.master.knows("Subscriber", name)
        assert decode_answer(await self.master.call("publisherUpdate", "/master", name, list(uris))) == 0

    async def velocities(self, for_s: float = 0.3) -> list[float]:
        """Return the forward speeds that the robot receives in this time, without zeros."""
        found: list[float] = []
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(for_s):
                while True:
                    found.append((await self.robot.velocity())[0])
        return [speed for speed in found if speed]


@contextlib.asynccontextmanager
async def scene(master: FakeMaster, **settings: object) -> AsyncIterator[Scene]:
    ros1 = dataclasses.replace(Ros1Config(master=master.url), **settings)  # type: ignore[arg-type]
    async with (
        daemon(Config().with_tables(ros1=ros1)) as running,
        fake_device(running.tcp, [*robot_topics(), TEXT]) as robot,
    ):
        await expect(lambda: running.hub.robots.find("robot_0").link)
        yield Scene(master, running, robot)
    assert running.hub.isolation.crashes == {}


@contextlib.asynccontextmanager
async def plain_scene() -> AsyncIterator[Scene]:
    """Run a scene with the default settings."""
    async with fake_master() as master, scene(master) as made:
        yield made


def twist(speed_m_s: float) -> bytes:
    return PlanarVelocity(speed_m_s).encode()
