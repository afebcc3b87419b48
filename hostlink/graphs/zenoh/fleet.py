"""Fleet: daemons that show and drive each other's robots. The gate of a robot, and who drives it, stay where it is."""

import asyncio
import contextlib
import socket
from collections import Counter
from collections.abc import AsyncIterator, Iterable

import structlog

from hostlink.config import ZenohConfig
from hostlink.errors import BadPayload
from hostlink.graphs.zenoh.fleet_drivers import FleetDrivers
from hostlink.graphs.zenoh.fleet_exports import FleetExports
from hostlink.graphs.zenoh.fleet_imports import MAX_MESSAGE_BYTES, FleetImports
from hostlink.graphs.zenoh.fleet_messages import (
    MAX_REQUEST_BYTES,
    MAX_STATE_BYTES,
    Keys,
    Live,
    RobotState,
    Sender,
    State,
    Topics,
    TopicState,
    decode,
)
from hostlink.graphs.zenoh.fleet_post import GROUP, Post
from hostlink.graphs.zenoh.fleet_requests import FleetRequests
from hostlink.graphs.zenoh.fleet_states import FleetStates
from hostlink.graphs.zenoh.roster import Neighbour, Roster
from hostlink.graphs.zenoh.session import Declaration, Sample, Session, Token
from hostlink.hub.hub import Hub
from hostlink.hub.node import Role
from hostlink.hub.remote_robot import RemoteRobot
from hostlink.logs import of_peer, printable
from hostlink.robot.directory import RobotTopicNames
from hostlink.robot.kinematics import Pose
from hostlink.robot.odometry_estimator import OdometrySnapshot, Twist
from hostlink.robot.velocity import Velocity

log = structlog.get_logger()

TICK_S = 0.1
READ_S = 2.0  # poses come as they are made for so long after somebody has read one
TOPICS_TIMEOUT_S = 2.0


class Fleet:
    """One daemon's part in the fleet."""

    def __init__(self, hub: Hub, session: Session, config: ZenohConfig) -> None:
        counts = hub.graph_counts["fleet"] = Counter()
        me = Sender(config.name or _host_name(), session.zid)
        self._hub, self._post = hub, Post(session, Keys(config.fleet_name), me, counts, config.drivers)
        self._participant = hub.join("fleet", role=Role.READ, group=GROUP)
        self._roster = Roster(counts, forget_after_s=hub.config.link.forget_robot_after_s)
        self._states = FleetStates(hub, self._post)
        self._drivers = FleetDrivers(hub, self._post, self._roster)
        self._exports = FleetExports(hub, self._post, self._drivers, self._roster)
        self._imports = FleetImports(hub, self._post)
        self._requests = FleetRequests(self._post, self._roster)
        self._topics: dict[str, dict[str, list[TopicState]]] = {}  # by daemon and robot
        self._fetching: set[str] = set()
        self._live: dict[str, Declaration] = {}
        self._declarations: list[Declaration] = []
        self._has_ended = False

    # -- its life -----------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Be a part of the fleet from now on."""
        keys, me, session = self._post.keys, self._post.me, self._post.session
        fleet, zid = keys.fleet, me.zid
        source = self._source
        self._declarations += [
            session.subscribe(
                f"{fleet}/stop/*/*", self._drivers.receive_stop, source_of=source, max_bytes=MAX_REQUEST_BYTES
            ),
            session.subscribe(
                f"{fleet}/drive/{zid}/*/*",
                self._drivers.receive,
                source_of=self._source_of_addressed,
                max_bytes=MAX_REQUEST_BYTES,
            ),
            session.subscribe(
                f"{fleet}/answer/{zid}/*/*",
                self._receive_answer,
                source_of=self._source_of_addressed,
                max_bytes=MAX_STATE_BYTES,
            ),
            session.subscribe(
                f"{fleet}/publish/{zid}/*/*/**",
                self._exports.receive,
                source_of=self._source_of_addressed,
                max_bytes=MAX_MESSAGE_BYTES,
            ),
            session.subscribe(
                f"{fleet}/state/*/*", self._receive_state, source_of=source, max_bytes=MAX_STATE_BYTES, max_waiting=4
            ),
            session.serve(keys.key("topics", me), self._exports.answer),
            session.subscribe_tokens(f"{fleet}/alive/*/*", self._receive_token),
            session.declare_token(keys.key("alive", me)),
        ]
        self._participant.watch_graph(self._update_topics)
        self._hub.gates.elsewhere = self._requests

    async def run(self) -> None:
        """Send states, and watch the others, until `end`."""
        while not self._has_ended:
            with self._hub.isolation.around("graph", graph="fleet"):
                self._tick()
            await asyncio.sleep(TICK_S)

    def end(self) -> None:
        """Leave the fleet: the robots of others are unknown, and what others drive here stops."""
        self._has_ended, self._hub.gates.elsewhere = True, None
        for declaration in (*self._declarations, *self._live.values()):
            declaration.close()
        self._imports.hide_all()
        self._exports.close()
        self._states.close()
        self._drivers.leave_all()
        self._participant.leave()
        for name in list(self._hub.robots.remote):
            self._hub.remote_robots.remove(name)
        for robot in self._hub.robots.here():
            robot.also_at = ()

    def _tick(self) -> None:
        now_s = _now_s()
        self._states.tick(self._exports.number)
        self._drivers.tick(now_s)
        self._requests.tick()
        self._apply(self._roster.watch(now_s) | self._roster.forget(now_s))
        self._follow(now_s)

    # -- who there is -------------------------------------------------------------------------------------------------

    def _receive_token(self, token: Token) -> None:
        sender = self._post.keys.sender(token.key)
        if sender is None or sender == self._post.me:
            return
        if not token.is_alive:
            self._lose(sender)
        elif self._roster.appear(sender, _now_s()):
            self._states.greet()
            log.info("fleet.daemon_appeared", host=printable(sender.name), zid=printable(sender.zid))

    def _lose(self, sender: Sender) -> None:
        neighbour = self._roster.find(sender)
        if neighbour is None:
            return
        log.warning("fleet.daemon_gone", host=printable(sender.name), zid=printable(sender.zid))
        self._drivers.leave(sender.zid)
        self._topics.pop(sender.zid, None)
        live = self._live.pop(sender.zid, None)
        if live is not None:
            live.close()
        self._apply(self._roster.leave(sender.zid, _now_s()))

    def _receive_state(self, sample: Sample) -> None:
        sender = self._post.keys.sender(sample.key)
        neighbour = None if sender is None else self._roster.find(sender)
        if sender is None or neighbour is None:
            self._post.counts["unannounced"] += 1
            return
        try:
            state = decode(sample.payload, State)
        except BadPayload:
            self._post.counts["malformed"] += 1
            return
        now_s = _now_s()
        neighbour.freshness.late_s(state.sent_s, now_s)
        self._apply(self._roster.receive(sender, state, now_s))
        if state.topics != neighbour.topics:
            self._fetch_topics(neighbour, state.topics)

    def _receive_motions(self, sample: Sample) -> None:
        sender = self._post.keys.sender(sample.key)
        try:
            live = decode(sample.payload, Live)
        except BadPayload:
            self._post.counts["malformed"] += 1
            return
        if sender is not None:
            self._apply(self._roster.receive_motions(sender, live, _now_s()))

    def _receive_answer(self, sample: Sample) -> None:
        """Stops and locks are answered with the robots as they are now."""
        sender, answer = self._post.keys.sender(sample.key, is_addressed=True), self._requests.receive(sample)
        neighbour = None if sender is None else self._roster.find(sender)
        if answer is None or neighbour is None:
            return
        for state in answer.robots:
            if state.name in neighbour.robots:
                neighbour.robots[state.name] = state
                self._apply((state.name,))

    # -- their robots -------------------------------------------------------------------------------------------------

    def _apply(self, names: Iterable[str]) -> None:
        """Show the robots of these names as they are known now."""
        for name in names:
            self._note_namesakes(name)
            place = self._roster.place(name)
            robot = self._hub.robots.remote.get(name)
            if place is None:
                self._imports.hide(name)
                self._hub.remote_robots.remove(name)
                continue
            sender = place.neighbour.sender
            if robot is None or robot.place != sender.zid:
                self._imports.hide(name)
                robot = _remote_robot(place.neighbour, place.state, self._requests)
                self._hub.remote_robots.add(robot)
            if robot.also_at != place.also_at:
                robot.also_at = place.also_at
                if place.also_at:
                    _log_twice(name, (sender.name, *place.also_at))
            self._update(robot, place.state, is_connected=place.is_connected)

    def _update(self, robot: RemoteRobot, state: RobotState, *, is_connected: bool) -> None:
        self._hub.remote_robots.connect(robot, state.link if is_connected else None)
        gate = robot.gate
        gate.owner_name, gate.priority, gate.lock_reason = state.holder, state.priority, state.lock_reason
        gate.current = Velocity(linear_x_m_s=state.velocity[0], angular_z_rad_s=state.velocity[1])
        gate.lease_s, robot.refusals.cause = state.lease_s, state.unreachable
        if state.pose is not None and robot.odometry.update(_snapshot(state), _now_s()):
            robot.follow()
        is_shown = is_connected and not robot.also_at and self._is_free(robot.name)
        if is_shown:
            neighbour = self._roster.place(robot.name)
            topics = self._topics.get(str(robot.place), {}).get(robot.name)
            if neighbour is not None and topics is not None:
                self._imports.show(robot, neighbour.neighbour, topics)
        else:
            self._imports.hide(robot.name)
            self._hub.remote_robots.offer(robot, ())

    def _is_free(self, name: str) -> bool:
        """Whether no robot that is connected here has this name."""
        robot = self._hub.robots.get_here(name)
        return robot is None or robot.link is None

    def _note_namesakes(self, name: str) -> None:
        """One name here and elsewhere: programs here drive the one here, and others neither."""
        robot = self._hub.robots.get_here(name)
        if robot is None:
            return
        also_at = self._roster.connected_at(name) if robot.link is not None else ()
        if also_at and not robot.also_at:
            _log_twice(name, (self._post.me.name, *also_at))
        robot.also_at = also_at

    def _follow(self, now_s: float) -> None:
        """Subscribe the poses of those daemons of which somebody reads one."""
        wanted = {
            str(robot.place)
            for robot in self._hub.robots.remote.values()
            if robot.followers or now_s < robot.odometry.read_at_s + READ_S
        }
        for zid in self._live.keys() - wanted:
            self._live.pop(zid).close()
        for neighbour in self._roster.all():
            zid = neighbour.sender.zid
            if zid in wanted and zid not in self._live:
                self._live[zid] = self._post.session.subscribe(
                    self._post.keys.key("live", neighbour.sender),
                    self._receive_motions,
                    source_of=self._source,
                    max_bytes=MAX_STATE_BYTES,
                    max_waiting=4,
                )

    # -- topics -------------------------------------------------------------------------------------------------------

    def _update_topics(self) -> None:
        topics = self._participant.graph().topics
        self._exports.update(topics)
        for robot in self._hub.robots.here():
            self._note_namesakes(robot.name)
        self._imports.update(topics)

    def _fetch_topics(self, neighbour: Neighbour, number: int) -> None:
        zid = neighbour.sender.zid
        if zid not in self._fetching:
            self._fetching.add(zid)
            self._hub.spawn(self._fetch(neighbour, number), name=f"topics of {printable(neighbour.sender.name)}")

    async def _fetch(self, neighbour: Neighbour, number: int) -> None:
        """Its list of topics; without an answer the next state is the next try."""
        try:
            answers = await self._post.session.get(
                self._post.keys.key("topics", neighbour.sender), timeout_s=TOPICS_TIMEOUT_S
            )
        finally:
            self._fetching.discard(neighbour.sender.zid)
        if self._roster.find(neighbour.sender) is not neighbour:
            return
        for answer in answers[:1]:
            try:
                listed = decode(answer.payload, Topics)
            except BadPayload:
                self._post.counts["malformed"] += 1
                return
            neighbour.topics = number
            by_robot: dict[str, list[TopicState]] = {name: [] for name in neighbour.robots}
            for topic in listed.topics:
                by_robot.setdefault(topic.robot, []).append(topic)
            self._topics[neighbour.sender.zid] = by_robot
            self._apply(neighbour.robots.keys())
            self._imports.update(self._participant.graph().topics)

    def _source(self, key: str) -> str:
        return str(self._post.keys.sender(key))

    def _source_of_addressed(self, key: str) -> str:
        return str(self._post.keys.sender(key, is_addressed=True))


@contextlib.asynccontextmanager
async def fleet_running(hub: Hub, session: Session, config: ZenohConfig) -> AsyncIterator[None]:
    """A part of the fleet for the length of the block."""
    fleet = Fleet(hub, session, config)
    fleet.begin()
    hub.spawn(fleet.run(), name="fleet")
    try:
        yield
    finally:
        fleet.end()


def _remote_robot(neighbour: Neighbour, state: RobotState, requests: FleetRequests) -> RemoteRobot:
    return RemoteRobot(
        name=state.name,
        host=printable(neighbour.sender.name),
        place=neighbour.sender.zid,
        shown=RobotTopicNames(
            state.name, state.velocity_topic, state.odometry_topic, state.odometry_type, state.reset_topic
        ),
        elsewhere=requests,
    )


def _snapshot(state: RobotState) -> OdometrySnapshot:
    pose = state.pose
    assert pose is not None  # noqa: S101 - the caller has looked
    return OdometrySnapshot(
        pose=Pose(pose.x_m, pose.y_m, pose.theta_rad),
        twist=Twist(pose.linear_m_s, pose.angular_rad_s),
        stamp_ns=pose.stamp_ns,
        age_s=pose.age_s,
        rate_hz=pose.rate_hz,
        count=pose.count,
        restarts=pose.restarts,
        ignored=pose.ignored,
    )


def _log_twice(name: str, hosts: Iterable[str]) -> None:
    with_budget = of_peer("fleet names")
    with structlog.contextvars.bound_contextvars(**with_budget):
        log.warning("fleet.name_twice", robot=name, hosts=[printable(host) for host in hosts])


def _host_name() -> str:
    """As a part of a key."""
    return "".join(char if char.isalnum() or char in "._-" else "-" for char in socket.gethostname())[:64] or "host"


def _now_s() -> float:
    return asyncio.get_running_loop().time()
