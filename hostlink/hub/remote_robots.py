"""RemoteRobots: the robots of other daemons: in the table of robots, and their velocity topics in the graph."""

import asyncio
import functools
import math
from collections.abc import Callable, Iterable

import structlog

from hostlink.errors import DeviceGone, HostlinkError, WrongType
from hostlink.hub.emergency_stop import EmergencyStop
from hostlink.hub.gates import Gates
from hostlink.hub.message import Message
from hostlink.hub.node import Node
from hostlink.hub.remote_robot import RemoteLink, RemoteRobot
from hostlink.hub.robots import Robots
from hostlink.hub.topic import DeviceSubscription
from hostlink.hub.topic_graph import TopicGraph
from hostlink.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, Twist

log = structlog.get_logger()


class RemoteRobots:
    """Whoever publishes on a velocity topic of one of them commands it, as with a robot that is here."""

    def __init__(
        self,
        robots: Robots,
        topics: TopicGraph,
        gates: Gates,
        emergency_stop: EmergencyStop,
        new_number: Callable[[], int],
    ) -> None:
        """`new_number`: for one more connection of a device."""
        self._robots, self._topics, self._gates, self._emergency_stop = robots, topics, gates, emergency_stop
        self._new_number = new_number
        self._nodes: dict[str, Node] = {}
        self._velocities: dict[str, frozenset[tuple[str, str]]] = {}

    def add(self, robot: RemoteRobot) -> None:
        """It is known from now on, by its name."""
        self.remove(robot.name)
        self._robots.put_remote(robot)
        self._nodes[robot.name] = Node(f"{robot.name} at {robot.host}")
        self._emergency_stop.serve(robot.name)

    def remove(self, name: str) -> None:
        """It is known no more; it may be removed already."""
        robot = self._robots.pop_remote(name)
        if robot is not None:
            self._topics.leave(self._nodes.pop(name))
            self._velocities.pop(name, None)
            self._emergency_stop.withdraw(name)

    def connect(self, robot: RemoteRobot, own_number: int | None, epoch: int | None) -> None:
        """Its device has this connection over there; None: none. `epoch`: of its admission there.

        Whether a reconnection is an interruption is decided there: then the epoch is another.
        """
        now_s = asyncio.get_running_loop().time()
        if own_number is None:
            if robot.link is not None:
                robot.gate.admission.disconnect(now_s)
            robot.link = None
        elif robot.link is None or robot.link.own_number != own_number:
            robot.link = RemoteLink(self._new_number(), own_number)
            is_resumed = epoch is not None and epoch == robot.gate.epoch
            robot.gate.admission.resume_after_reconnect_s = math.inf if is_resumed else 0.0
            robot.gate.admission.connect(now_s)
            robot.gate.epoch = epoch  # it may have another beginning

    def offer(self, robot: RemoteRobot, velocities: Iterable[tuple[str, str]]) -> None:
        """It is driven by these topics, by name and type, while no device here has them."""
        wanted = frozenset(velocities)
        if self._velocities.get(robot.name, frozenset()) == wanted:
            return
        node, before = self._nodes[robot.name], self._velocities.get(robot.name, frozenset())
        self._topics.leave(node)
        self._velocities[robot.name] = wanted
        for name, type_name in wanted:
            subscription = DeviceSubscription(functools.partial(self._receive, robot), is_gate=True)
            try:
                topic = self._topics.subscribe_device(name, node, subscription, type_name=type_name)
            except HostlinkError as error:
                log.warning("topic.refused", topic=name, reason=str(error))
            else:
                if (name, type_name) not in before:
                    self._gates.join(robot, topic)

    def is_read(self, topic: str) -> bool:
        """Whether anybody here subscribes to one of their velocity topics."""
        known = self._topics.find_or_none(topic)
        return known is not None and bool(known.subscribers)

    def deliver(self, topic: str, payload: bytes) -> None:
        """What the other daemon's gate sent to the device, for whoever subscribes here."""
        known = self._topics.find_or_none(topic)
        if known is not None:
            known.deliver(payload, source=self, at_s=asyncio.get_running_loop().time())

    def _receive(self, robot: RemoteRobot, message: Message) -> None:
        """A velocity that was published here.

        Raises:
            HostlinkError: as `Gates.command`; also where a device here has the same topic.
        """
        if sum(not device.is_away for device in self._topics.find(message.topic).devices.values()) > 1:
            raise DeviceGone(robot.name, f"{message.topic} is a topic here and at {robot.host}")
        if message.type_name == TWIST_TYPE:
            twist = Twist.decode(message.payload)
        elif message.type_name == TWIST_STAMPED_TYPE:
            twist = Twist.from_fields(message.decoded["twist"])  # type: ignore[arg-type]  # by its definition
        else:
            raise WrongType(message.topic, TWIST_TYPE, message.type_name)
        self._gates.follow(robot, twist, message)
