"""Robots in a fleet: what other daemons receive of the robots here, and how theirs are shown here."""

import asyncio
import contextlib
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Any

import msgspec
import structlog

from hostlink.errors import HostlinkError
from hostlink.graphs.zenoh.fleet_messages import (
    MAX_ROBOTS,
    MAX_STATE_BYTES,
    FleetTransport,
    Live,
    RobotMessage,
    RobotMotion,
    Sender,
    State,
    encode,
    is_shareable,
    state_of,
)
from hostlink.graphs.zenoh.fleet_topics import FleetTopics, note_failure
from hostlink.graphs.zenoh.roster import FleetRoster, Place
from hostlink.graphs.zenoh.session import Declaration, ZenohSample
from hostlink.hub.hub import Hub
from hostlink.hub.robot import LocalRobot, RemoteRobot, RobotHosts
from hostlink.logs import of_peer, printable
from hostlink.mirror.inbox import SLICE_S
from hostlink.mirror.mirror import Mirror

STATE_INTERVAL_S = 1.0
GREETING_S = 0.5  # after a daemon has appeared: it may not yet know who sends
_UNSTEADY: dict[str, Any] = {  # a change of these alone waits for the next interval
    "pose": None, "velocity": (0.0, 0.0), "linear_y_m_s": 0.0, "battery_v": None, "battery_percent": None,
    "signal_dbm": None,
}  # fmt: skip


class FleetStates:
    """States of the robots here, sent each second and after each change; poses by another key while they are read."""

    def __init__(self, hub: Hub, transport: FleetTransport) -> None:
        self._hub, self._transport = hub, transport
        self._states = transport.session.declare_publisher(transport.key("state"), is_urgent=True)
        self._live = transport.session.declare_publisher(transport.key("live"))
        self._is_live = False
        self._live.watch(self._note_readers)
        self._due_s = 0.0
        self._greeting_until_s = 0.0
        self._known: tuple[object, ...] = ()
        self._marks: dict[str, object] = {}  # by which a motion that was sent is known

    def greet(self) -> None:
        """Send the state repeatedly for a moment, because another daemon has appeared."""
        self._greeting_until_s = _now_s() + GREETING_S

    def tick(self, topics: int) -> None:
        """Send what has changed; `topics`: the number of the list of topics."""
        now_s = _now_s()
        states = self.states()
        known = (topics, *(msgspec.structs.replace(each, **_UNSTEADY) for each in states))
        if now_s >= self._due_s or now_s < self._greeting_until_s or known != self._known:
            self._due_s, self._known = now_s + STATE_INTERVAL_S, known
            self._states.put(encode(State(sent_s=now_s, topics=topics, robots=states)))
        elif self._is_live:
            self._send_motions(states)

    def _send_motions(self, states: tuple[RobotMessage, ...]) -> None:
        """Send the motions of robots that moved or have another velocity."""
        motions = {
            state.name: RobotMotion(state.name, state.velocity, state.pose, state.linear_y_m_s) for state in states
        }
        marks: dict[str, object] = {
            name: (each.velocity, each.linear_y_m_s, each.pose and each.pose.count) for name, each in motions.items()
        }
        moved = tuple(motion for name, motion in motions.items() if marks[name] != self._marks.get(name))
        self._marks = marks
        if moved:
            self._live.put(encode(Live(robots=moved)))

    def states(self) -> tuple[RobotMessage, ...]:
        """Return the state of every robot here whose name a key may contain."""
        robots = [robot for robot in self._hub.robots.here() if is_shareable(robot)]
        if len(robots) > MAX_ROBOTS:
            self._transport.counts["unshared_robots"] += len(robots) - MAX_ROBOTS
            robots = sorted(robots, key=lambda robot: robot.link is None)[:MAX_ROBOTS]
        return tuple(map(state_of, robots))

    def close(self) -> None:
        """Withdraw both publishers."""
        self._states.close()
        self._live.close()

    def _note_readers(self, is_read: bool) -> None:
        self._is_live = is_read


def _now_s() -> float:
    return asyncio.get_running_loop().time()


log = structlog.get_logger()

READ_S = 2.0  # poses are sent at their own rate for so long after one was read
MAX_WAITING = 4  # states of one daemon; the newest counts


class FleetRobots:
    """Robots of other daemons. Of several with one name none is driven from here, except the one that is here."""

    def __init__(
        self,
        hub: Hub,
        transport: FleetTransport,
        roster: FleetRoster,
        requests: RobotHosts,
        topics: FleetTopics,
        *,
        receive: Callable[[ZenohSample], None],
    ) -> None:
        """`receive`: is called with the motions of one daemon's robots, while they are read."""
        self._hub, self._transport, self._roster = hub, transport, roster
        self._requests, self._topics, self._receive = requests, topics, receive
        self._live = Mirror[str, Sender, Declaration](
            self._subscribe, lambda zid, error: note_failure(hub, transport, "failed_topics", zid, error)
        )
        self._due: OrderedDict[str, None] = OrderedDict()  # names
        self._is_due = False
        self._known_links: dict[str, int] = {}  # of robots here whose name another daemon has too

    def apply(self, names: Iterable[str]) -> None:
        """Show the robots of these names as they are known now."""
        for name in names:
            self._note_namesakes(name)
            place = self._roster.place(name)
            robot = self._hub.robots.remote.get(name)
            if place is None:
                self._topics.hide(name)
                self._hub.robots.pop_remote(name)
                continue
            sender = place.neighbour.sender
            if robot is None or robot.place != sender.zid:
                self._topics.hide(name)
                before, robot = robot, self._remote_robot(place)
                if before is not None:  # its drivers continue here
                    robot.admission = before.admission
                self._hub.robots.put_remote(robot)
            if place.also_at and not robot.also_at:
                _log_duplicate(name, (sender.name, *place.also_at))
            robot.also_at = place.also_at
            self._update(robot, place)

    def apply_soon(self, names: Iterable[str]) -> None:
        """Apply in slices, one in each turn of the loop: another daemon decides how many names there are."""
        self._due |= dict.fromkeys(names)
        if not self._is_due:
            self._is_due = True
            self._apply_due()

    def _apply_due(self) -> None:
        ends_s = _now_s() + SLICE_S
        while self._due:
            with self._hub.isolation.around("graph", graph="fleet"):
                self.apply((self._due.popitem(last=False)[0],))
            if _now_s() >= ends_s:
                asyncio.get_running_loop().call_soon(self._apply_due)
                return
        self._is_due = False

    def _remote_robot(self, place: Place) -> RemoteRobot:
        return RemoteRobot(
            name=place.state.name,
            host=printable(place.neighbour.sender.name),
            place=place.neighbour.sender.zid,
            known=place.state.state,
            hosts=self._requests,
            gates=self._hub.gates,
            graph=self._hub.topics,
        )

    def _update(self, robot: RemoteRobot, place: Place) -> None:
        state, epoch = place.state.state, place.state.epoch
        robot.connect(state.link if place.is_connected else None, epoch, self._hub.robots.new_number)
        holder = state.holder and state.holder.removesuffix(f" at {self._transport.me.name}")  # one who is here
        robot.update(msgspec.structs.replace(state, holder=holder), epoch=epoch)
        is_driven_here = not robot.also_at and self._is_free(robot.name)
        if place.is_connected and is_driven_here:
            self._topics.show(robot, place.neighbour)
        else:
            self._topics.hide(robot.name)
        if not is_driven_here:  # else its gates stay while its device is away, as those of a robot that is here
            robot.offer(())

    def _is_free(self, name: str) -> bool:
        """Whether no robot that is connected here has this name."""
        robot = self._hub.robots.get_here(name)
        return robot is None or robot.link is None

    def _note_namesakes(self, name: str) -> None:
        """Note a name that another daemon has too: programs here drive the robot here, other programs neither."""
        robot = self._hub.robots.get_here(name)
        if robot is None:
            return
        also_at = self._roster.connected_at(name) if robot.link is not None else ()
        if also_at and not robot.also_at:
            _log_duplicate(name, (self._transport.me.name, *also_at))
        robot.also_at = also_at
        if robot.link is not None and self._known_links.get(name) != robot.link.number:
            self._known_links[name] = robot.link.number
            self._lock_likewise(robot)

    def _lock_likewise(self, robot: LocalRobot) -> None:
        """Lock a robot that another daemon had locked before it connected here."""
        for neighbour in self._roster.all():
            state = neighbour.robots.get(robot.name)
            if state is not None and state.lock_reason is not None and robot.gate.lock_reason is None:
                with contextlib.suppress(HostlinkError):  # it is locked, although its device refused the zero
                    robot.lock_here(f"locked at {neighbour.sender.name}: {state.lock_reason}")

    def follow(self, now_s: float) -> None:
        """Subscribe to the poses of daemons whose robots are read here."""
        wanted = {
            str(robot.place)
            for robot in self._hub.robots.remote.values()
            if robot.followers or now_s < robot.odometry.read_at_s + READ_S
        }
        senders = [neighbour.sender for neighbour in self._roster.all()]
        self._live.want({sender.zid: sender for sender in senders if sender.zid in wanted})

    def lose(self, zid: str) -> None:
        """Unsubscribe from the poses of a daemon that is gone."""
        self._live.put(zid, None)

    def _subscribe(self, _: str, sender: Sender) -> Declaration:
        key = self._transport.keys.key("live", sender)
        return self._transport.session.subscribe(key, self._receive, max_bytes=MAX_STATE_BYTES, max_waiting=MAX_WAITING)

    def end(self) -> None:
        """Remove all robots of other daemons."""
        self._due.clear()
        self._live.close()
        for name in list(self._hub.robots.remote):
            self._hub.robots.pop_remote(name)
        for robot in self._hub.robots.here():
            robot.also_at = ()


def _log_duplicate(name: str, hosts: Iterable[str]) -> None:
    with_budget = of_peer("fleet names")
    with structlog.contextvars.bound_contextvars(**with_budget):
        log.warning("fleet.duplicate_name_found", robot=name, hosts=[printable(host) for host in hosts])
