"""Drivers of foreign graphs, as their protocols deliver them: bytes of a connection, samples of a session.

There is no network, so that they run in virtual time. `vanish` is what the graph reports when such a driver ends.
"""

import asyncio
import itertools
from collections import Counter
from typing import cast

from hostlink.components.ros1.local_node import LocalNode
from hostlink.components.ros1.settings import Ros1Config
from hostlink.components.ros1.tcpros import encode_header, encode_message
from hostlink.components.ros1.topics import _PublisherConnection
from hostlink.components.zenoh.fleet_commands import FleetDrivers
from hostlink.components.zenoh.fleet_messages import (
    ANSWER,
    FleetCommand,
    FleetTransport,
    Keys,
    Sender,
    State,
    encode,
)
from hostlink.components.zenoh.roster import FleetRoster
from hostlink.components.zenoh.session import ZenohSample, ZenohSession
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node import Role
from hostlink.core.hub.participant import Participant
from hostlink.core.hub.robot_topic_publisher import twist_topic
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.transport.base import READ_BYTES
from hostlink.errors import CommandRefused, HostlinkError, RefusalKind
from tests.support.api_memory import ApiTransport
from tests.support.fake_device import CATALOG
from tests.support.hosts import host_in
from tests.support.participants import ROBOT, Scene
from tests.support.wired_device import Flood

PRIORITY = 50


class Ros1Driver:
    """A node of ROS 1 that publishes the velocity of a robot."""

    def __init__(self, scene: Scene) -> None:
        twist = CATALOG.message(TWIST_TYPE)
        assert twist is not None
        self._node = LocalNode(
            host_in(scene.hub, "ros1"), Ros1Config(master="http://master:1/"), "/hostlink", scene.tasks
        )
        name = twist_topic(scene.hub.robots.find_here(ROBOT))
        topic = next(each for each in scene.neighbour.graph().topics if each.name == name)
        self._connection = _PublisherConnection(self._node, topic, Budget(), is_new=True)
        transport = ApiTransport("10.0.0.9")
        transport.protocol = self._connection.wire
        self._connection.wire.connection_made(transport)
        fields = {"callerid": "/joystick", "type": TWIST_TYPE, "md5sum": twist.md5, "topic": name}
        self._connection.wire.data_received(encode_header(fields))
        padding = encode_message(PlanarVelocity(0.2).encode())
        self.flood = Flood(self._deliver, READ_BYTES, padding)

    def _deliver(self, data: bytes) -> None:
        if not self._connection.wire.is_closed:
            self._connection.wire.data_received(data)

    @property
    def participant(self) -> Participant:
        assert self._connection.participant is not None
        return self._connection.participant

    def drive(self, robot: str, speed_m_s: float, hub: Hub, *, left_m_s: float = 0.0) -> None:
        assert twist_topic(hub.robots.find_here(robot)) == self._connection._topic.name
        before = self._node.counts.refused_messages
        self.flood.send(encode_message(PlanarVelocity(speed_m_s, left_m_s).encode()))
        if self._node.counts.refused_messages > before:
            raise CommandRefused(robot, RefusalKind.HELD, f"{robot}: another source was first")

    def vanish(self) -> None:
        """Lose the connection of the publisher."""
        self.flood.end()
        self._connection.wire.connection_lost(ConnectionResetError())


class _Answers:
    """The session: what this daemon sends to the others is kept for the test."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def put(self, _: str, payload: bytes, *, is_urgent: bool) -> None:
        assert is_urgent
        self.sent.append(payload)


class FleetDriver:
    """A program at another daemon of the fleet that drives a robot here."""

    def __init__(self, scene: Scene) -> None:
        self._keys, self._here, self._there = Keys("hostlink"), Sender("lab", "1a"), Sender("desk", "2b")
        self._answers, self._numbers = _Answers(), itertools.count(1)
        roster = self._roster = FleetRoster(Counter())
        transport = FleetTransport(cast("ZenohSession", self._answers), self._keys, self._here, Counter())
        self._drivers = FleetDrivers(host_in(scene.hub, "fleet"), transport, roster)
        roster.appear(self._there, _now_s())
        roster.receive(self._there, State(sent_s=_now_s(), topics=0, robots=()), _now_s())

    @property
    def participant(self) -> Participant:
        return self._drivers._drivers[self._there.zid][1].participant

    def drive(
        self,
        robot: str,
        speed_m_s: float,
        hub: Hub,  # noqa: ARG002 - as the other kinds have it
        *,
        left_m_s: float = 0.0,
        late_s: float = 0.0,
        epoch: int | None = None,
        take_over: bool = False,
    ) -> None:
        request = FleetCommand(
            number=next(self._numbers),
            epoch=epoch,
            sent_s=_now_s() - late_s,
            robot=robot,
            owner=1,
            owner_name="client 3",
            velocity=(speed_m_s, left_m_s, 0.0, 0.0, 0.0, 0.0),
            priority=PRIORITY,
            take_over=take_over,
        )
        self._drivers.receive(ZenohSample(self._keys.key("drive", self._there, to=self._here.zid), encode(request)))
        answer = ANSWER.decode(self._answers.sent.pop())
        if answer.error:
            if answer.error in set(RefusalKind):
                raise CommandRefused(robot, RefusalKind(answer.error), answer.reason, holder=answer.owner)
            raise HostlinkError(answer.reason)

    def publish(self, name: str, payload: bytes) -> None:
        """Publish at the other daemon to a topic of a device here."""
        neighbour = self._roster.find(self._there)
        assert neighbour is not None
        self._drivers.publish(neighbour, name, payload)

    def vanish(self) -> None:
        """The token of its daemon is gone."""
        self._drivers.leave(self._there.zid)


def ros1(scene: Scene, role: Role) -> Ros1Driver:
    assert role is Role.DRIVE
    return Ros1Driver(scene)


def fleet(scene: Scene, role: Role) -> FleetDriver:
    assert role is Role.DRIVE
    return FleetDriver(scene)


FOREIGN = [ros1, fleet]


def _now_s() -> float:
    return asyncio.get_running_loop().time()
