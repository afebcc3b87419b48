"""Every entry point of velocities for a robot, as a source that drives and lets go, in virtual time.

What of the admission's tables a way cannot express is in its `cannot`, by the name of the row, with the reason.
"""

import asyncio
import base64
import contextlib
import json
import math
import struct
import tempfile
from collections import Counter
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, ClassVar, cast

from aiohttp.test_utils import make_mocked_request

from hostlink.cli import demo, play
from hostlink.cli.driving import GRACE_S, Driving, Key
from hostlink.cli.teleop import KeyDriver, WatchedRobot
from hostlink.client import RobotState
from hostlink.components.gateway.access import GRANT, Grant
from hostlink.components.gateway.clients import ClientQueue
from hostlink.components.gateway.foxglove import FoxgloveClient, FoxgloveDirectory
from hostlink.components.gateway.rest import Owners, Rest
from hostlink.components.gateway.rosbridge import RosbridgeClient
from hostlink.components.gateway.routes import BODY, CAME
from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.graphs.ros2_types import Ros2Types
from hostlink.components.recorder.channel import VELOCITY, ros_channel
from hostlink.components.recorder.mcap_writer import McapWriter
from hostlink.components.ros2.plan import TWIST, VelocityInput
from hostlink.components.ros2.velocity import VelocityDriver
from hostlink.components.zenoh.fleet import fleet_running
from hostlink.components.zenoh.rmw_bridge import Publishers, RmwNode
from hostlink.components.zenoh.rmw_protocol import (
    Attachment,
    EndpointToken,
    NodeToken,
    RemoteGraph,
    TokenKind,
    gid_of,
)
from hostlink.components.zenoh.session import ZenohSession
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.components import hosted
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Role
from hostlink.core.hub.robot_topic_publisher import twist_topic
from hostlink.core.mirror.log_once import LogOnce
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, PlanarVelocity, Twist
from hostlink.errors import CommandRefused, HostlinkError, RefusalKind
from tests.support.fake_device import CATALOG, topic
from tests.support.foreign_drivers import PRIORITY, FleetDriver, Ros1Driver
from tests.support.hosts import host_in
from tests.support.memory_client import MemoryHost, memory_host
from tests.support.memory_zenoh import MemoryNetwork, MemorySession
from tests.support.participants import ROBOT, Scene
from tests.support.wired_device import SerialDevice, TcpDevice, UdpDeviceInMemory, WiredDevice

SPEED_M_S = 0.2
ROS2_TWIST = "geometry_msgs/msg/Twist"
CMD_VEL, CMD_VEL_STAMPED = f"/{ROBOT}/cmd_vel", f"/{ROBOT}/cmd_vel_stamped"
VELOCITY_COMMANDS = f"/{ROBOT}/velocity_commands"  # as the device itself names it
_NO_NAN = "its JSON has no number for it, and the request is refused as wrong"
_EPOCHS = ("the current epoch arms", "an earlier epoch is refused")
_SIDEWAYS = ("y is passed and limited", "y is refused for a differential drive")
TAKES_OVER = "take_over takes the robot over from one of the same priority"
_PUBLISHED = dict.fromkeys(_EPOCHS, "a Twist has no epoch") | {TAKES_OVER: "a Twist does not say so"}
_IS_DROPPED = dict.fromkeys(
    (
        "a stream from before a new robot is disarmed",
        "a stream goes on after a reconnection within resume_after_reconnect_s",
    ),
    "what is refused meanwhile is dropped",
)


class EntryPoint:
    """One source that drives ROBOT; `goes_on`: it continues to command after a refusal."""

    cannot: ClassVar[dict[str, str]] = {}
    goes_on: ClassVar[bool] = True
    period_s: ClassVar[float] = 0.1
    priority: ClassVar[int] = 50

    def __init__(self, made: Scene) -> None:
        self.made = made
        self.take_over = False
        self.late_s = 0.0  # by which its commands are older than they seem, from now on
        self._stream: asyncio.Task[None] | None = None

    async def begin(self) -> None:
        """Come to the robot."""

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        """One command: forward, and to the left."""
        raise NotImplementedError

    @property
    def epoch(self) -> int:
        """The robot's, as this source can know it."""
        return self.made.hub.robots.find_here(ROBOT).gate.admission.epoch

    def refused(self) -> Counter[RefusalKind]:
        """Number of refused commands, by kind."""
        return Counter(self.made.hub.robots.find_here(ROBOT).gate.admission.refused)

    async def vanish(self) -> None:
        """Leave, as its graph or its connection reports it, in the middle of all."""
        raise NotImplementedError

    async def start(self) -> None:
        """Command at SPEED_M_S from now on."""
        self.silence()
        self._stream = self.made.tasks.create_task(self._repeat())
        await asyncio.sleep(0)

    def silence(self) -> None:
        """Command no more."""
        if self._stream is not None:
            self._stream.cancel()

    async def zero(self) -> None:
        """Command a zero, and no more."""
        self.silence()
        with contextlib.suppress(HostlinkError):
            await self.give(0.0)

    async def end(self) -> None:
        """After the test."""
        self.silence()

    async def _repeat(self) -> None:
        while True:
            with contextlib.suppress(HostlinkError):
                await self.give(SPEED_M_S)
            await asyncio.sleep(self.period_s)


# -- rosbridge --------------------------------------------------------------------------------------------------------


class _Rosbridge(EntryPoint):
    def __init__(self, made: Scene) -> None:
        super().__init__(made)
        self.queue = ClientQueue()
        self.client = RosbridgeClient("client 1", host_in(made.hub), self.queue, spawn=made.tasks.create_task)

    def send(self, **request: Any) -> None:
        self.receive(json.dumps(request), _now_s() - self.late_s)
        for _ in iter(self.queue.pop, None):
            continue

    def receive(self, text: str, came_s: float) -> None:
        """Receive a message as from the queue of operations."""
        self.client.receive(text, came_s)

    async def vanish(self) -> None:
        self.client.close()


class RosbridgePublish(_Rosbridge):
    cannot: ClassVar = _PUBLISHED

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        message = {"linear": {"x": _number(speed_m_s), "y": left_m_s}}
        self.send(op="publish", topic=CMD_VEL, msg=message)


class RosbridgeRaw(RosbridgePublish):
    """The robot's own velocity topic, as bytes."""

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        raw = base64.b64encode(PlanarVelocity(speed_m_s, left_m_s).encode()).decode()
        self.send(op="publish", topic=VELOCITY_COMMANDS, type=TWIST_TYPE, raw=raw)


class TwistStamped(RosbridgePublish):
    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        self.send(
            op="publish",
            topic=CMD_VEL_STAMPED,
            type=TWIST_STAMPED_TYPE,
            msg={"twist": {"linear": {"x": _number(speed_m_s), "y": left_m_s}}},
        )


class RosbridgeDrive(_Rosbridge):
    cannot: ClassVar = {"a velocity that is not finite": _NO_NAN}

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        sent_s = 1000.0 + _now_s() - self.late_s
        self.receive(
            json.dumps(
                {"op": "drive", "id": 1, "robot": ROBOT, "linear": speed_m_s, "angular": 0.0, "sent_s": sent_s}
                | ({"linear_y": left_m_s} if left_m_s else {})
                | ({"take_over": True} if self.take_over else {})
                | ({} if epoch is None else {"epoch": epoch})
            ),
            _now_s(),
        )
        for _ in iter(self.queue.pop, None):
            continue


class RosbridgePublishAtOnce(RosbridgePublish):
    """A Twist that arrives alone."""

    def receive(self, text: str, came_s: float) -> None:
        _at_once(self.client, text, came_s)


class RosbridgeDriveAtOnce(RosbridgeDrive):
    """A `drive` that arrives alone."""

    def receive(self, text: str, came_s: float) -> None:
        _at_once(self.client, text, came_s)


def _at_once(client: RosbridgeClient, text: str, came_s: float) -> None:
    """Execute a velocity as in the turn of its read; what is not one, or not for a robot here, as from the queue."""
    if not client.take(text.encode(), came_s):
        client.receive(text, came_s)


class Page(_Rosbridge):
    """The messages of the page, as its connection.ts and drive.ts make them, for a stick that is held."""

    period_s: ClassVar = 0.08
    priority: ClassVar = 60
    cannot: ClassVar = dict.fromkeys(_EPOCHS, "it sends the number of the device's connection instead") | {
        "a stream from before a new robot is disarmed": "it shows no robot that is not there",
        "a velocity that is not finite": _NO_NAN,
        **dict.fromkeys(_SIDEWAYS, "its stick goes forward and turns"),
    }
    link: int | None = None

    async def start(self) -> None:
        link = self.made.hub.robots.find(ROBOT).link
        self.link = None if link is None else link.number
        await super().start()

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        assert not left_m_s
        came_s, link = _now_s(), self.link if speed_m_s else None
        command = {"robot": ROBOT, "linear": speed_m_s, "angular": 0, "priority": 60, "link": link}
        command["take_over"] = self.take_over
        message = {"op": "drive", "id": "drive", **command, "sent_s": 5.5 + came_s - self.late_s}
        self.client.receive(json.dumps(message), came_s)
        for _ in iter(self.queue.pop, None):
            continue


# -- the other protocols of the port ----------------------------------------------------------------------------------


class RestPut(EntryPoint):
    cannot: ClassVar = {"a velocity that is not finite": _NO_NAN}

    def __init__(self, made: Scene) -> None:
        super().__init__(made)
        host = host_in(made.hub)
        self._owners = Owners(host)
        unused = cast(Any, None)  # no request of a velocity asks for clients, drives or settings
        rest = Rest(host, unused, unused, self._owners)
        (self._route,) = (each for each in rest.routes() if each.path.endswith("/velocity"))

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        request = make_mocked_request("PUT", f"/api/robots/{ROBOT}/velocity", match_info={"name": ROBOT})
        body: dict[str, object] = {"linear": speed_m_s, "linear_y_m_s": left_m_s, "angular": 0.0}
        body |= {"take_over": self.take_over} | ({} if epoch is None else {"epoch": epoch})
        request[BODY], request[CAME] = json.dumps(body).encode(), _now_s() - self.late_s
        request[GRANT] = Grant("phone", Role.DRIVE)
        await self._route.handler(request)

    async def vanish(self) -> None:
        """Withdraw the token of the source."""
        self._owners.end(["phone"])


class FoxglovePublish(EntryPoint):
    cannot: ClassVar = _PUBLISHED

    def __init__(self, made: Scene) -> None:
        super().__init__(made)
        self._queue = ClientQueue()
        host = host_in(made.hub)
        directory = FoxgloveDirectory(host)
        self._client = FoxgloveClient("client 1", host, directory, self._queue, spawn=made.tasks.create_task)
        channel = {"id": 1, "topic": CMD_VEL, "encoding": "ros1", "schemaName": TWIST_TYPE}
        self._client.receive(json.dumps({"op": "advertise", "channels": [channel]}))

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        frame = struct.pack("<BI", 1, 1) + PlanarVelocity(speed_m_s, left_m_s).encode()
        self._client.do(self._client.read(frame, _now_s() - self.late_s))
        for _ in iter(self._queue.pop, None):
            continue

    async def vanish(self) -> None:
        self._client.close()


# -- programs of the Python client ------------------------------------------------------------------------------------


class _Program(EntryPoint):
    def __init__(self, made: Scene) -> None:
        super().__init__(made)
        self._begin()

    def _begin(self) -> None:
        self.host = MemoryHost(self.made.hub, self.made.tasks)
        self.robot = self.host.robot(ROBOT, priority=50)

    @property
    def late_s(self) -> float:
        return self.host.connection_.delay_s

    @late_s.setter
    def late_s(self, late_s: float) -> None:
        """Delay the commands, as a slow network does."""
        if late_s:
            self.host.connection_.delay_s = late_s

    async def vanish(self) -> None:
        self.host.close()

    async def end(self) -> None:
        self.silence()
        self.host.close()


class ClientCommand(_Program):
    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        await self.robot.command(speed_m_s, 0.0, left_m_s, epoch=epoch, take_over=self.take_over)


class ClientDrive(_Program):
    """A velocity that is held: the client repeats it until it is refused."""

    goes_on: ClassVar = False
    cannot: ClassVar = _IS_DROPPED | {
        **dict.fromkeys(_EPOCHS, "drive() sends the epoch by itself: tests/unit/client/test_driving.py"),
        "a lower priority goes on afterwards": "what is refused is dropped, and the program is told",
    }

    async def start(self) -> None:
        with contextlib.suppress(HostlinkError):
            await self.give(SPEED_M_S)

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        await self.robot.drive(speed_m_s, 0.0, left_m_s, take_over=self.take_over)

    def silence(self) -> None:
        """Stop repeating, as a program that hangs."""
        self.host.stop_repeating(ROBOT)


class Teleop(_Program):
    """A person at the keys of `hostlink teleop`."""

    period_s: ClassVar = 0.02
    goes_on: ClassVar = False  # what is refused must be released, but for one who is more important
    cannot: ClassVar = _IS_DROPPED | {
        **dict.fromkeys(_EPOCHS, "a key has no epoch; the client sends it"),
        TAKES_OVER: "its stop key stops the other one, and then it drives",
        "a velocity that is not finite": "its speeds are steps from a finite one",
        **dict.fromkeys(_SIDEWAYS, "its keys go sideways at the speed of forward"),
    }

    def _begin(self) -> None:
        super()._begin()
        self._driving = Driving(layout="original", linear_m_s=SPEED_M_S, angular_rad_s=1.0)
        self._keys = KeyDriver(self.robot, self._driving, WatchedRobot(cast(RobotState, {})))

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        assert not left_m_s
        if speed_m_s:
            self._driving.receive(Key("w"), _now_s())
            await self._keys.send_due()
        else:
            self._driving.stop()
            for _ in range(round((GRACE_S + 0.1) / self.period_s)):
                await self._keys.send_due()
                await asyncio.sleep(self.period_s)


class Play(_Program):
    """`hostlink play --drive`, of a robot that was driven for a long time."""

    goes_on: ClassVar = False
    cannot: ClassVar = dict.fromkeys(
        (
            *_EPOCHS,
            "a stream from before a new robot is disarmed",
            *_IS_DROPPED,
            "a zero arms",
            "a zero of another changes nothing",
            "a velocity that is not finite",
            "a lower priority goes on afterwards",
            TAKES_OVER,
        ),
        "it gives what was recorded, and ends when that is refused",
    )

    async def begin(self) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._write("run.mcap", PlanarVelocity(SPEED_M_S))

    def _write(self, name: str, velocity: PlanarVelocity) -> None:
        self._file = Path(self._folder.name) / name
        writer = McapWriter(self._file, metadata={})
        type_ = CATALOG.message(TWIST_TYPE)
        channel = ros_channel(CMD_VEL, TWIST_TYPE, type_, is_latched=False, robot=ROBOT, origin=VELOCITY)
        for number in range(100):
            writer.write(channel, 10**18 + number * 10**8, velocity.encode())
        writer.close()

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        self._write("other.mcap", PlanarVelocity(speed_m_s, left_m_s))
        await self.start()

    async def start(self) -> None:
        self.silence()
        self._begin()
        self._stream = self.made.tasks.create_task(self._play())
        await asyncio.sleep(0)

    async def _play(self) -> None:
        pace = play.Playback(rate=1.0, start_s=0.0, is_looped=False, is_stepped=False)
        with contextlib.suppress(HostlinkError):
            await play.drive_as_recorded(self.robot, self._file, pace, ROBOT, CMD_VEL)
        self.host.close()

    def silence(self) -> None:
        super().silence()
        self.host.close()

    async def end(self) -> None:
        await super().end()
        self._folder.cleanup()


class RclpyBridge(EntryPoint):
    """`hostlink ros2`: what a publisher of ROS 2 sends, after rclpy has received it."""

    cannot: ClassVar = _PUBLISHED

    async def begin(self) -> None:
        self.hosts: list[MemoryHost] = []
        self._reported = ""
        self._driver = VelocityDriver(self._connect, 50, self._report, self._report)
        self._route = VelocityInput(CMD_VEL, ROBOT, TWIST)
        self._running = self.made.tasks.create_task(self._run())
        await asyncio.sleep(0)
        self._update()

    def _report(self, line: str) -> None:
        self._reported = line

    @contextlib.asynccontextmanager
    async def _connect(self) -> AsyncIterator[Any]:
        async with memory_host(self.made.hub, self.made.tasks) as host:
            self.hosts.append(host)
            yield host

    async def _run(self) -> None:
        async with self._driver.running():
            await asyncio.Event().wait()

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        await self.give_twist(Twist(speed_m_s, left_m_s))

    async def give_twist(self, twist: Twist) -> None:
        """One command, of any components."""
        for host in self.hosts:
            host.connection_.delay_s = self.late_s
        self._update(b"publisher")
        if self.made.hub.robots.get_here(ROBOT) is not None:  # else the bridge subscribes to no topic of it
            self._driver.receive(self._route, twist, b"publisher")
        await asyncio.sleep(0.01)
        if "finite" in self._reported:
            raise CommandRefused(ROBOT, RefusalKind.NOT_FINITE, self._reported)

    async def vanish(self) -> None:
        self.silence()
        self._update()
        await asyncio.sleep(0.01)

    async def end(self) -> None:
        self.silence()
        self._running.cancel()

    def _update(self, *publishers: bytes) -> None:
        robots = [robot.name for robot in self.made.hub.robots.here()]
        self._driver.update(robots, frozenset(publishers))


# -- graphs -----------------------------------------------------------------------------------------------------------


class Ros1Publisher(EntryPoint):
    """A node of ROS 1. It is late by what waits in its socket: TCPROS has no time."""

    cannot: ClassVar = _PUBLISHED

    async def begin(self) -> None:
        self._driver = Ros1Driver(self.made)

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        if self.late_s:
            self._driver.flood.begin()
        self._driver.drive(ROBOT, speed_m_s, self.made.hub, left_m_s=left_m_s)

    async def vanish(self) -> None:
        self._driver.vanish()


class RmwPublisher(EntryPoint):
    """A publisher of ROS 2 in the graph of rmw_zenoh."""

    cannot: ClassVar = _PUBLISHED

    async def begin(self) -> None:
        counts = Counter[str]()
        unused = cast("ZenohSession", None)  # publishers send nothing
        own = NodeToken(0, "ff", 0, "/", "hostlink")
        node = RmwNode(host_in(self.made.hub, "zenoh"), unused, Ros2Types(CATALOG, "kilted"), own, counts)
        graph = RemoteGraph(0, counts)
        self._publishers, self._sent = Publishers(node, graph, LogOnce(counts)), 0
        remote = NodeToken(0, "aa", 0, "/", "driver")
        endpoint = EndpointToken(TokenKind.PUBLISHER, remote, 1, CMD_VEL, ROS2_TWIST, "RIHS01_0", Qos()).encode()
        self._gid, token = gid_of(endpoint), graph.add(endpoint)
        assert isinstance(token, EndpointToken)
        self._publishers.add(token, endpoint)

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        velocity = PlanarVelocity(speed_m_s, left_m_s)
        if self.late_s:
            asyncio.get_running_loop().call_later(self.late_s, self._publish, velocity, self.late_s)
        else:
            self._publish(velocity, 0.0)

    def _publish(self, velocity: PlanarVelocity, late_s: float) -> None:
        self._sent += 1
        attachment = Attachment(self._sent, int((100.0 + _now_s() - late_s) * 1e9), self._gid)
        self._publishers.publish(attachment, (CMD_VEL, ROS2_TWIST), velocity.encode(), topic=CMD_VEL)

    async def vanish(self) -> None:
        """Withdraw the publisher's token."""
        self._publishers.clear()


class Fleet(EntryPoint):
    """A program at another daemon."""

    cannot: ClassVar = {"a velocity that is not finite": _NO_NAN}

    async def begin(self) -> None:
        self._driver = FleetDriver(self.made)

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        self._driver.drive(
            ROBOT,
            speed_m_s,
            self.made.hub,
            left_m_s=left_m_s,
            late_s=self.late_s,
            epoch=epoch,
            take_over=self.take_over,
        )

    async def vanish(self) -> None:
        self._driver.vanish()


class FleetPublisher(Fleet):
    """Publisher at another daemon, to a topic of a device here."""

    cannot: ClassVar = _PUBLISHED | {
        "a command that is late is refused": "a message of the fleet that is published has no time",
        "a stream from before a new robot is disarmed": "what is published to a robot of another daemon is commanded",
    }

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        self._driver.publish(
            twist_topic(self.made.hub.robots.find_here(ROBOT)), PlanarVelocity(speed_m_s, left_m_s).encode()
        )


class FleetSender(EntryPoint):
    """A program of this daemon that drives a robot of another one, with all parts of both daemons."""

    cannot: ClassVar = {"a velocity that is not finite": _NO_NAN}

    async def begin(self) -> None:
        self.hub, self._stack = Hub(Config(), CATALOG), contextlib.AsyncExitStack()
        self._running = self.made.tasks.create_task(self.hub.run())
        await self.hub.is_running.wait()
        network = MemoryNetwork()
        for hub, name, zid in ((self.made.hub, "lab", "1a"), (self.hub, "desk", "2b")):
            session = cast("ZenohSession", MemorySession(network, zid))
            host = await self._stack.enter_async_context(hosted(hub, "zenoh", Counter()))
            await self._stack.enter_async_context(fleet_running(host, session, ZenohSettings(name=name)))
        await asyncio.sleep(2.0)  # the second state of a robot has its topics
        self.participant = self.hub.join("client 3")

    @property
    def epoch(self) -> int:
        return self.hub.robots.find(ROBOT).admission.epoch

    def refused(self) -> Counter[RefusalKind]:
        return super().refused() + Counter(self.hub.robots.find(ROBOT).admission.refused)

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        participant, velocity = self.participant, PlanarVelocity(speed_m_s, left_m_s)
        robot = self.hub.robots.find(ROBOT, driver=lambda: participant)
        participant.drive(
            robot,
            velocity,
            priority=PRIORITY,
            received_s=_now_s() - self.late_s,
            epoch=epoch,
            take_over=self.take_over,
        )
        await participant.driven(robot, velocity)

    async def vanish(self) -> None:
        self.participant.leave()

    async def end(self) -> None:
        self.silence()
        await self.vanish()
        await self._stack.aclose()
        self._running.cancel()


class FleetSenderPublish(FleetSender):
    """FleetSender that publishes to a topic of the robot."""

    cannot: ClassVar = _PUBLISHED

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        self.participant.advertise(CMD_VEL, TWIST_TYPE)
        self.participant.publish(CMD_VEL, PlanarVelocity(speed_m_s, left_m_s).encode(), at_s=_now_s() - self.late_s)


class DevicePublisher(EntryPoint):
    """A remote control with a microcontroller of its own. It is late by what waits: rosserial has no time."""

    cannot: ClassVar = _PUBLISHED
    device: ClassVar[type[WiredDevice]] = TcpDevice

    async def begin(self) -> None:
        self._device = self.device(self.made.hub, [topic(EndpointKind.PUBLISHER, 126, CMD_VEL, TWIST_TYPE)])
        await asyncio.sleep(0.5)

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        assert epoch is None
        if self.late_s:
            self._device.flood.begin()
        self._device.flood.send(encode(126, PlanarVelocity(speed_m_s, left_m_s).encode()))

    async def vanish(self) -> None:
        self.silence()
        self._device.vanish()
        await asyncio.sleep(0.01)

    async def end(self) -> None:
        await self.vanish()


class SerialPublisher(DevicePublisher):
    device: ClassVar = SerialDevice


class UdpPublisher(DevicePublisher):
    device: ClassVar = UdpDeviceInMemory


# -- parts of the daemon ----------------------------------------------------------------------------------------------


class ComponentDrive(EntryPoint):
    """A component of another package."""

    async def begin(self) -> None:
        self._host = host_in(self.made.hub)
        self._participant = self._host.join("arm")

    async def give(self, speed_m_s: float, *, left_m_s: float = 0.0, epoch: int | None = None) -> None:
        self._host.drive(
            self._participant,
            ROBOT,
            PlanarVelocity(speed_m_s, left_m_s),
            received_s=_now_s() - self.late_s,
            epoch=epoch,
            take_over=self.take_over,
        )

    async def vanish(self) -> None:
        self._host.close()


class Demo(EntryPoint):
    """The driver of `hostlink demo`."""

    priority: ClassVar = 0
    goes_on: ClassVar = False  # it pauses
    cannot: ClassVar = dict.fromkeys(
        (
            *_EPOCHS,
            "a command that is late is refused",
            "a zero arms",
            "a zero of another changes nothing",
            "a velocity that is not finite",
            *_SIDEWAYS,
            TAKES_OVER,
        ),
        "it gives its curve, from inside of the daemon",
    ) | dict.fromkeys(
        (
            *(
                f"{interruption} disarms"
                for interruption in (
                    "stop",
                    "stop_all",
                    "lock_and_unlock",
                    "reconnect",
                    "come_back_after_a_while",
                    "announce_other_topics",
                    "pause",
                    "stop_and_pause",
                )
            ),
            "a command without device is refused",
            "a stream from before a new robot is disarmed",
            *_IS_DROPPED,
        ),
        "it gives no command after an interruption, until it is told",
    )

    async def begin(self) -> None:
        self._participant = self.made.hub.join("demo", priority=0)
        self.made.neighbour.drive(self.made.hub.robots.find("robot_1"), PlanarVelocity(0.2))

    async def _repeat(self) -> None:
        await demo.DemoDriver(self.made.hub, self._participant, lambda _: True).run()

    async def vanish(self) -> None:
        self.silence()
        self._participant.leave()

    async def end(self) -> None:
        await self.vanish()


def _number(value: float) -> float | None:
    """Return the value as rosbridge encodes it."""
    return value if math.isfinite(value) else None


def _now_s() -> float:
    return asyncio.get_running_loop().time()


AFTERWARDS_S: dict[type[EntryPoint], float] = {Demo: demo.PAUSE_S + 0.5}  # it returns the robot to its previous driver
