"""Topics of robots between daemons: those here for other daemons, and theirs in the graph here.

A message is sent while the other end subscribes to it. Topics are shared below the name of their robot; a topic with
another name gets one below it.
"""

from hostlink.components.graphs.hub_source import HubSource
from hostlink.components.zenoh.fleet_commands import FleetDrivers
from hostlink.components.zenoh.fleet_messages import (
    GROUP,
    MAX_TOPICS,
    TOPIC_LIST,
    FleetTopic,
    FleetTransport,
    TopicList,
    encode,
    fleet_name,
    is_shareable,
)
from hostlink.components.zenoh.roster import FleetRoster, Neighbour
from hostlink.components.zenoh.session import Declaration, Query, ZenohSample
from hostlink.core.host import (
    MAX_ADVERTISED,
    GraphTopic,
    Host,
    Message,
    Participant,
    RemoteRobot,
    RemoteRobots,
    Role,
    Subscription,
)
from hostlink.core.messages.serialisation import ROS1
from hostlink.core.mirror.log_once import LogOnce
from hostlink.core.mirror.mirror import Mirror
from hostlink.errors import HostlinkError

TOPICS_TIMEOUT_S = 2.0
SLICE_S = 0.003  # of declarations: a hundred robots that come at once cost a second of Zenoh's
FIRST_RETRY_S, LONGEST_RETRY_S = 2.0, 60.0  # of a topic that has another type here
MAX_WAITING = 64  # messages of one topic; the oldest is dropped
MAX_MESSAGE_BYTES = 64 * 1024  # what a device sends is much smaller


class _Export:
    """A topic here that others may subscribe to."""

    def __init__(self, host: Host, transport: FleetTransport, name: str, exported: tuple[str, str]) -> None:
        """`name`: as others know it; `exported`: the robot, and the topic's name here.

        Raises:
            ConfigError: the session is closed.
        """
        robot, topic = exported
        key = transport.key("out", name.strip("/"))
        self._publisher = transport.session.declare_publisher(key)
        self._source = HubSource(
            lambda: host.join(f"fleet {robot}", group=GROUP),
            topic,
            lambda message: self._publisher.put(message.payload),
            lambda _: transport.counts.update(("refused",)),
        )
        self._publisher.watch(self._source.set_read)

    def close(self) -> None:
        """Withdraw the topic from the fleet."""
        self._source.set_read(False)
        self._publisher.close()


class _Import:
    """A topic of a robot of another daemon, in the graph here."""

    def __init__(
        self, transport: FleetTransport, neighbour: Neighbour, participant: Participant, topic: FleetTopic
    ) -> None:
        """Show it.

        Raises:
            WrongType, BadRequest: the topic has another type here, or an unknown one.
        """
        self._transport, self._neighbour, self._participant, self._name = transport, neighbour, participant, topic.name
        self._to_device: Subscription | None = None  # what programs here publish
        if topic.is_published:
            participant.advertise(topic.name, topic.type)
        if topic.is_subscribed:
            try:
                self._to_device = participant.subscribe(topic.name, self._publish, type_name=topic.type)
            except HostlinkError:
                self.close()
                raise

    def close(self) -> None:
        """Withdraw the topic from the graph here."""
        self._participant.unadvertise(self._name)
        if self._to_device is not None:
            self._to_device.close()

    def _publish(self, message: Message) -> None:
        """A program here publishes what a device over there subscribes."""
        key = self._transport.key("publish", message.topic.strip("/"), to=self._neighbour.sender.zid)
        self._transport.session.put(key, message.payload)


class _RemoteTopics:
    """The topics of one robot of another daemon."""

    def __init__(
        self,
        host: Host,
        transport: FleetTransport,
        robots: RemoteRobots,
        log_once: LogOnce,
        robot: str,
        neighbour: Neighbour,
    ) -> None:
        self.listed: list[FleetTopic] = []
        self._host, self._transport, self._log_once, self._neighbour = host, transport, log_once, neighbour
        self._robots, self._robot = robots, robot
        self._participant = host.join(f"{robot} at {neighbour.sender.name}", group=GROUP)
        self._shown: dict[str, FleetTopic] = {}
        self._imports = Mirror[str, FleetTopic, _Import](
            lambda _, topic: _Import(transport, neighbour, self._participant, topic),
            self._refuse,
            retry_s=FIRST_RETRY_S,
            longest_s=LONGEST_RETRY_S,
        )
        self._subscriptions = Mirror[str, FleetTopic, Declaration](self._subscribe, self._fail)

    def show(self, topics: dict[str, FleetTopic]) -> None:
        """Show exactly these topics. A subscription at the other daemon ends with its topic."""
        self._shown = topics
        self._imports.want({name: topic for name, topic in topics.items() if not topic.is_velocity})
        self._subscriptions.want(
            {name: topic for name, topic in self._subscriptions.wanted.items() if topics.get(name) == topic}
        )

    def demand(self, subscribed: set[str]) -> None:
        """Subscribe at the other daemon to what is subscribed here. `subscribed`: without velocities."""
        self._subscriptions.want(
            {
                name: topic
                for name, topic in self._shown.items()
                if (self._is_read(name) if topic.is_velocity else topic.is_published and name in subscribed)
            }
        )

    def close(self) -> None:
        """Withdraw all topics."""
        self._subscriptions.close()
        self._imports.close()
        self._participant.leave()

    def _subscribe(self, name: str, topic: FleetTopic) -> Declaration:
        key = self._transport.keys.key("out", self._neighbour.sender, name.strip("/"))
        deliver = self._deliver_velocity if topic.is_velocity else self._deliver
        return self._transport.session.subscribe(
            key,
            lambda sample: deliver(name, sample.payload),
            max_bytes=MAX_MESSAGE_BYTES,
            max_waiting=MAX_WAITING,
        )

    def _is_read(self, topic: str) -> bool:
        """Whether a velocity topic of another daemon's robot has subscribers here, apart from the robot itself."""
        robot = self._robots.get(self._robot)
        return robot is not None and robot.is_read(topic)

    def _deliver_velocity(self, topic: str, payload: bytes) -> None:
        """Deliver what the other daemon's gate sent to the device to the subscribers here."""
        robot = self._robots.get(self._robot)
        if robot is not None:
            robot.show(topic, payload)

    def _deliver(self, topic: str, payload: bytes) -> None:
        try:
            self._participant.publish(topic, payload)
        except HostlinkError:
            self._transport.counts["refused"] += 1

    def _refuse(self, topic: str, error: Exception) -> None:
        note_failure(self._host, self._transport, "refused_topics", topic, error)
        if isinstance(error, HostlinkError):
            self._log_once("fleet.topic_refused", topic=topic, reason=str(error))

    def _fail(self, topic: str, error: Exception) -> None:
        note_failure(self._host, self._transport, "failed_topics", topic, error)


def note_failure(host: Host, transport: FleetTransport, cause: str, name: str, error: Exception) -> None:
    """Count a refusal; any other error is a fault of hostlink."""
    if isinstance(error, HostlinkError):
        transport.counts[cause] += 1
    else:
        host.crashed("graph", error, graph="fleet", name=name)


class FleetTopics:
    """Topics in both directions: of the robots here for other daemons, and of theirs in the graph here.

    A daemon's list is fetched again when the number in its state has changed.
    """

    def __init__(
        self,
        host: Host,
        transport: FleetTransport,
        robots: RemoteRobots,
        drivers: FleetDrivers,
        roster: FleetRoster,
    ) -> None:
        """`robots`: those of other daemons."""
        self.number = 0  # of the list of the topics here, another one after each change
        self._host, self._transport, self._drivers, self._roster = host, transport, drivers, roster
        self._participant = host.join("fleet", role=Role.READ, group=GROUP)
        self._exports = Mirror[str, tuple[str, str], _Export](
            lambda name, exported: _Export(host, transport, name, exported), self._fail, slice_s=SLICE_S
        )
        self._here: dict[str, tuple[FleetTopic, str]] = {}  # with their names here, by the name that others know
        self._list: bytes | None = None  # encoded answer; None: not requested since the last change
        log_once = self._log_once = LogOnce(by=("topic",))
        self._remote = Mirror[str, Neighbour, _RemoteTopics](  # by robot
            lambda robot, neighbour: _RemoteTopics(host, transport, robots, log_once, robot, neighbour), self._fail
        )
        self._fetching: set[str] = set()

    def begin(self) -> None:
        self._participant.watch_graph(self._update)

    def end(self) -> None:
        """Withdraw everything."""
        self._participant.leave()
        self._remote.close()
        self._exports.close()

    def _update(self) -> None:
        topics = self._participant.graph().topics
        self._export(topics)
        self._demand(topics)

    def _fail(self, name: str, error: Exception) -> None:
        note_failure(self._host, self._transport, "failed_topics", name, error)

    # -- of the robots here -------------------------------------------------------------------------------------------

    def answer(self, query: Query) -> None:
        """Answer a request for the list."""
        if self._list is None:
            states = tuple(state for state, _ in self._here.values())
            self._list = encode(TopicList(number=self.number, topics=states))
        query.reply(self._list)
        query.close()

    def receive(self, sample: ZenohSample) -> None:
        """A program of another daemon publishes to a device here."""
        keys = self._transport.keys
        neighbour, known = self._roster.find(keys.sender(sample.key)), self._here.get(keys.topic(sample.key))
        if neighbour is None or known is None or not known[0].is_subscribed or known[0].is_velocity:
            self._transport.counts["unannounced"] += 1
            return
        try:
            self._drivers.publish(neighbour, known[1], sample.payload)
        except HostlinkError:
            self._transport.counts["refused"] += 1

    def _export(self, topics: tuple[GraphTopic, ...]) -> None:
        """Follow a change of the graph here."""
        found = self._find(topics)
        if len(found) > MAX_TOPICS:
            self._transport.counts["unshared_topics"] += len(found) - MAX_TOPICS
            found = dict(list(found.items())[:MAX_TOPICS])
        if found == self._here:
            return
        self._here, self._list, self.number = found, None, self.number + 1
        self._exports.want(
            {
                name: (state.robot, topic)
                for name, (state, topic) in found.items()
                if state.is_published or state.is_velocity
            }
        )

    def _find(self, topics: tuple[GraphTopic, ...]) -> dict[str, tuple[FleetTopic, str]]:
        robots = {robot.name: robot for robot in self._host.here.all() if is_shareable(robot.name)}
        own = {topic: robot for robot in robots.values() for topic in robot.topics}
        found = {}
        for topic in topics:
            robot = robots.get(topic.name.split("/")[1]) if topic.name.count("/") > 1 else None
            robot = robot or own.get(topic.name)
            is_there = robot is not None and (robot.link is not None or topic.is_velocity)
            if robot is not None and is_there and topic.encoding != ROS1:
                reason = f"{topic.type_name} has no definition here, its messages are {topic.encoding}"
                self._log_once("fleet.topic_refused", topic=topic.name, reason=reason)
            elif robot is not None and is_there and topic.type_name:
                name = fleet_name(robot.name, topic.name)
                state = FleetTopic(
                    robot=robot.name,
                    name=name,
                    type=topic.type_name,
                    is_published=topic.is_published,
                    is_subscribed=topic.has_device,
                    is_velocity=topic.is_velocity,
                )
                found[name] = (state, topic.name)
        return found

    # -- of robots of other daemons -----------------------------------------------------------------------------------

    def show(self, robot: RemoteRobot, neighbour: Neighbour) -> None:
        """Put the topics of a robot that are known, and whose names are below its own, into the graph."""
        topics = neighbour.listed.get(robot.name)
        if topics is None:
            return
        self._remote.put(robot.name, neighbour)
        shown = self._remote.endpoints.get(robot.name)
        if shown is None or shown.listed is topics:
            return
        shown.listed = topics
        own = {topic.name: topic for topic in topics if topic.name.startswith(f"/{robot.name}/")}
        self._transport.counts["foreign_topics"] += len(topics) - len(own)
        wanted = dict(list(own.items())[:MAX_ADVERTISED])
        robot.offer((each.name, each.type) for each in wanted.values() if each.is_velocity)
        shown.show(wanted)

    def hide(self, robot: str) -> None:
        """Withdraw the topics of a robot that is gone, or known from another daemon."""
        self._remote.put(robot, None)

    def demand(self) -> None:
        """Subscribe at other daemons to what is subscribed here."""
        self._demand(self._participant.graph().topics)

    def _demand(self, topics: tuple[GraphTopic, ...]) -> None:
        subscribed = {topic.name for topic in topics if topic.is_subscribed and not topic.is_velocity}
        for shown in self._remote.endpoints.values():
            shown.demand(subscribed)

    async def fetch(self, neighbour: Neighbour, number: int) -> bool:
        """Fetch a daemon's list; returns whether it came. Without an answer the next state is the next try."""
        sender = neighbour.sender
        if sender.zid in self._fetching:
            return False
        self._fetching.add(sender.zid)
        try:
            answers = await self._transport.session.get(
                self._transport.keys.key("topics", sender), timeout_s=TOPICS_TIMEOUT_S
            )
        finally:
            self._fetching.discard(sender.zid)
        if not answers or self._roster.find(sender) is not neighbour:
            return False
        listed = self._transport.decode(answers[0].payload, TOPIC_LIST)
        if listed is None:
            return False
        neighbour.topics, neighbour.listed = number, {name: [] for name in neighbour.robots}
        for topic in listed.topics:
            neighbour.listed.setdefault(topic.robot, []).append(topic)
        return True
