"""Fleet: daemons that show and drive each other's robots. The gate of a robot, and who drives it, stay where it is."""

import asyncio
import contextlib
import itertools
import socket
from collections import Counter, OrderedDict
from collections.abc import AsyncIterator, Callable, Iterable
from typing import Any

import msgspec
import structlog
from structlog.contextvars import bound_contextvars

from hostlink.components.zenoh.fleet_commands import FleetDrivers, FleetRequests
from hostlink.components.zenoh.fleet_messages import (
    LIVE,
    MAX_REQUEST_BYTES,
    MAX_ROBOTS,
    MAX_STATE_BYTES,
    STATE,
    FleetTransport,
    Keys,
    Live,
    RobotMessage,
    RobotMotion,
    Sender,
    State,
    encode,
    is_shareable,
    message_of,
)
from hostlink.components.zenoh.fleet_orders import FleetOrders
from hostlink.components.zenoh.fleet_topics import MAX_MESSAGE_BYTES, FleetTopics, note_failure
from hostlink.components.zenoh.roster import FleetRoster, Neighbour, Place
from hostlink.components.zenoh.session import Declaration, Token, ZenohSample, ZenohSession
from hostlink.components.zenoh.settings import ZenohSettings
from hostlink.core.host import Host, RemoteRobot, RemoteRobots
from hostlink.core.mirror.inbox import SLICE_S
from hostlink.core.mirror.mirror import Mirror
from hostlink.core.runtime.logs import of_peer, printable
from hostlink.core.runtime.loop_time import loop_time_s
from hostlink.errors import BadRequest, HostlinkError

log = structlog.get_logger()

STATE_INTERVAL_S = 1.0
GREETING_S = 0.5  # after a daemon has appeared: it may not yet know who sends
_UNSTEADY: dict[str, Any] = {  # a change of these alone waits for the next interval
    "pose": None, "velocity": (0.0, 0.0), "linear_y_m_s": 0.0, "battery_v": None, "battery_percent": None,
    "signal_dbm": None,
}  # fmt: skip

READ_S = 2.0  # poses are sent at their own rate for so long after one was read
MAX_WAITING = 4  # states of one daemon; the newest counts

TICK_S = 0.1

FIND_INTERVAL_S = 5.0  # between two searches for daemons whose tokens may have been dropped


class FleetStates:
    """States of the robots here, sent each second and after each change; poses by another key while they are read."""

    def __init__(self, host: Host, transport: FleetTransport) -> None:
        self._here, self._transport = host.here, transport
        self._states = transport.session.declare_publisher(transport.key("state"), is_urgent=True)
        self._live = transport.session.declare_publisher(transport.key("live"))
        self._is_live = False
        self._live.watch(self._note_readers)
        self._due_s = 0.0
        self._greeting_until_s = 0.0
        self._known: tuple[object, ...] = ()
        self._topics = 0
        self._marks: dict[str, object] = {}  # by which a motion that was sent is known

    def greet(self) -> None:
        """Send the state repeatedly for a moment, because another daemon has appeared."""
        self._greeting_until_s = loop_time_s() + GREETING_S

    def tick(self, topics: int) -> None:
        """Send what has changed; `topics`: the number of the list of topics."""
        self._topics, now_s = topics, loop_time_s()
        states, boards_locked = self.states(), self._here.boards_lock_reason
        known = (topics, boards_locked, *(msgspec.structs.replace(each, **_UNSTEADY) for each in states))
        if now_s >= self._due_s or now_s < self._greeting_until_s or known != self._known:
            self._due_s, self._known = now_s + STATE_INTERVAL_S, known
            sent_s = self._transport.clock_s(now_s)
            self._states.put(encode(State(sent_s=sent_s, topics=topics, robots=states, boards_locked=boards_locked)))
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
        robots = [robot for robot in self._here.all() if is_shareable(robot.name)]
        if len(robots) > MAX_ROBOTS:
            self._transport.counts["unshared_robots"] += len(robots) - MAX_ROBOTS
            robots = sorted(robots, key=lambda robot: robot.link is None)[:MAX_ROBOTS]
        return tuple(message_of(self._here.state(robot.name)) for robot in robots)

    def end(self) -> None:
        """Tell the other daemons that this one ends, which stops its robots."""
        last = tuple(msgspec.structs.replace(each, link=None, holder=None) for each in self.states())
        sent_s = self._transport.clock_s(loop_time_s())
        self._states.put(encode(State(sent_s=sent_s, topics=self._topics, robots=last, is_last=True)))

    def close(self) -> None:
        """Withdraw both publishers."""
        self._states.close()
        self._live.close()

    def _note_readers(self, is_read: bool) -> None:
        self._is_live = is_read


class FleetRobots:
    """Robots of other daemons. Of several with one name none is driven from here, except the one that is here."""

    def __init__(
        self,
        host: Host,
        transport: FleetTransport,
        robots: RemoteRobots,
        roster: FleetRoster,
        requests: FleetRequests,
        topics: FleetTopics,
    ) -> None:
        self._host, self._here, self._transport, self._robots, self._roster = host, host.here, transport, robots, roster
        self._requests, self._topics = requests, topics
        self._live = Mirror[str, Sender, Declaration](
            self._subscribe, lambda zid, error: note_failure(host, transport, "failed_topics", zid, error)
        )
        self._due: OrderedDict[str, None] = OrderedDict()  # names
        self._is_due = False
        self._known_links: dict[str, int] = {}  # of robots here whose name another daemon has too

    def apply(self, names: Iterable[str]) -> None:
        """Show the robots of these names as they are known now."""
        for name in names:
            self._note_namesakes(name)
            place = self._roster.place(name)
            robot = self._robots.get(name)
            if place is None:
                self._topics.hide(name)
                self._robots.withdraw(name)
                continue
            sender = place.neighbour.sender
            if robot is None or robot.place != sender.zid:
                self._topics.hide(name)
                host = printable(sender.name)
                try:
                    robot = self._robots.announce(place.state.state, host=host, place=sender.zid)
                except BadRequest as error:
                    note_failure(self._host, self._transport, "refused_robots", name, error)
                    continue
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
        ends_s = loop_time_s() + SLICE_S
        while self._due:
            with self._host.around("graph", graph="fleet"):
                self.apply((self._due.popitem(last=False)[0],))
            if loop_time_s() >= ends_s:
                asyncio.get_running_loop().call_soon(self._apply_due)
                return
        self._is_due = False

    def _update(self, robot: RemoteRobot, place: Place) -> None:
        state, epoch = place.state.state, place.state.epoch
        robot.connect(state.link if place.is_connected else None, epoch)
        lock_reason = state.lock_reason or self._requests.lock_reason(state.name)
        holder = state.holder and state.holder.removesuffix(f" at {self._transport.me.name}")  # one who is here
        robot.update(msgspec.structs.replace(state, holder=holder, lock_reason=lock_reason), epoch=epoch)
        is_driven_here = not robot.also_at and self._is_free(robot.name)
        if place.is_connected and is_driven_here:
            self._topics.show(robot, place.neighbour)
        else:
            self._topics.hide(robot.name)
        if not is_driven_here:  # else its gates stay while its device is away, as those of a robot that is here
            robot.offer(())

    def _is_free(self, name: str) -> bool:
        """Whether no robot that is connected here has this name."""
        robot = self._here.get(name)
        return robot is None or robot.link is None

    def _note_namesakes(self, name: str) -> None:
        """Note a name that another daemon has too: programs here drive the robot here, other programs neither."""
        robot = self._here.get(name)
        if robot is None:
            return
        also_at = self._roster.connected_at(name) if robot.link is not None else ()
        if also_at and not robot.also_at:
            _log_duplicate(name, (self._transport.me.name, *also_at))
        if robot.also_at != also_at:
            self._here.note_others(name, also_at)
        if robot.link is not None and self._known_links.get(name) != robot.link:
            self._known_links[name] = robot.link
            if robot.lock_reason is None:
                self._lock_likewise(name)

    def _lock_likewise(self, name: str) -> None:
        """Lock a robot that was locked at another daemon, or for one out of sight, before it connected here."""
        reason = self._requests.lock_reason(name)
        states = ((each.sender.name, each.robots.get(name)) for each in self._roster.all())
        locked = (f"locked at {host}: {each.lock_reason}" for host, each in states if each and each.lock_reason)
        reason = reason or next(locked, None)
        if reason is not None:
            with contextlib.suppress(HostlinkError):  # it is locked, although its device refused the zero
                self._here.lock(name, reason)

    def follow(self) -> None:
        """Subscribe to the poses of daemons whose robots are read here."""
        wanted = {str(robot.place) for robot in self._robots.all() if robot.is_followed(READ_S)}
        senders = [neighbour.sender for neighbour in self._roster.all()]
        self._live.want({sender.zid: sender for sender in senders if sender.zid in wanted})

    def _subscribe(self, _: str, sender: Sender) -> Declaration:
        key = self._transport.keys.key("live", sender)
        return self._transport.session.subscribe(key, self._receive, max_bytes=MAX_STATE_BYTES, max_waiting=MAX_WAITING)

    def _receive(self, sample: ZenohSample) -> None:
        """Follow the motions of one daemon's robots."""
        sender, live = self._transport.keys.sender(sample.key), self._transport.decode(sample.payload, LIVE)
        if sender is not None and live is not None:
            self.apply_soon(self._roster.receive_motions(sender, live, loop_time_s()))

    def end(self) -> None:
        """Remove all robots of other daemons."""
        self._due.clear()
        self._live.close()
        self._here.close()

    def names_here(self) -> list[str]:
        """Return robots here whose name another daemon has too: one of them may have connected or left."""
        return [robot.name for robot in self._robots.all() if self._here.get(robot.name) is not None]


def _log_duplicate(name: str, hosts: Iterable[str]) -> None:
    with_budget = of_peer("fleet names")
    with structlog.contextvars.bound_contextvars(**with_budget):
        log.warning("fleet.duplicate_name_found", robot=name, hosts=[printable(host) for host in hosts])


_UNHEARD = "Robots there are shown as last seen; a stop or a lock is in force there when the host is seen again"


class FleetMemory:
    """State for the next run of the fleet: other daemons, and the stops and locks that they have not obeyed."""

    def __init__(self, forget_after_s: float) -> None:
        self.counts: Counter[str] = Counter()
        self.roster = FleetRoster(self.counts, forget_after_s=forget_after_s)
        self.orders = FleetOrders(self.roster)
        self.numbers = itertools.count(1)  # of requests

    def end(self, now_s: float) -> None:
        """Note that nothing is heard from now on."""
        self.orders.end()
        self.roster.leave_all(now_s)


class Fleet:
    """Membership of this daemon in the fleet."""

    def __init__(self, host: Host, session: ZenohSession, config: ZenohSettings) -> None:
        """Reach the other daemons from now on: a stop here is one there."""
        memory = self._memory = host.kept("fleet", lambda: FleetMemory(host.forget_after_s))
        counts = memory.counts
        host.count_by(lambda: counts, part="fleet")
        me, keys = Sender(config.name or sender_name(socket.gethostname()), session.zid), Keys(config.fleet_name)
        self._host = host
        self._transport = FleetTransport(session, keys, me, counts, config.drivers, lambda: host.slept_s)
        self._roster = memory.roster
        self._states = FleetStates(host, self._transport)
        self._drivers = FleetDrivers(host, self._transport, self._roster)
        self._requests = FleetRequests(self._transport, self._roster, memory.orders, memory.numbers)
        self._remote = host.announce_robots(self._requests)
        self._topics = FleetTopics(host, self._transport, self._remote, self._drivers, self._roster)
        self._robots = FleetRobots(host, self._transport, self._remote, self._roster, self._requests, self._topics)
        self._requests.show = self._robots.apply_soon
        self._declarations: list[Declaration] = []
        self._tokens = Declaration()  # the subscription to those of other daemons
        self._dropped = 0  # by Zenoh, when it was made
        self._found_at_s = 0.0
        self._unheard: tuple[str, ...] = ()  # names of daemons
        self._has_ended = False

    # -- its life -----------------------------------------------------------------------------------------------------

    def begin(self) -> None:
        """Be a part of the fleet from now on."""
        transport, fleet, zid = self._transport, self._transport.keys.fleet, self._transport.me.zid
        self._declarations += [
            self._subscribe(f"{fleet}/stop/*/*", self._drivers.receive_stop, MAX_REQUEST_BYTES, 64),
            self._subscribe(f"{fleet}/drive/{zid}/*/*", self._drivers.receive, MAX_REQUEST_BYTES, 64),
            self._subscribe(f"{fleet}/answer/{zid}/*/*", self._receive_answer, MAX_STATE_BYTES, 64),
            self._subscribe(f"{fleet}/publish/{zid}/*/*/**", self._topics.receive, MAX_MESSAGE_BYTES, 64),
            self._subscribe(f"{fleet}/state/*/*", self._receive_state, MAX_STATE_BYTES, 1),  # the newest counts
            transport.session.serve(transport.key("topics"), self._topics.answer),
            transport.session.declare_token(transport.key("alive")),
        ]
        self._find_daemons(loop_time_s())
        self._topics.begin()
        self._robots.apply_soon(self._roster.names())  # of an earlier run

    async def run(self) -> None:
        """Send states, and watch the others, until `end`."""
        while not self._has_ended:
            with self._host.around("graph", graph="fleet"):
                self._tick()
            await asyncio.sleep(TICK_S)

    def end(self) -> None:
        """Leave the fleet: the robots of others are unknown, and what others drive here stops."""
        self._has_ended = True
        declarations = [each.close for each in (*self._declarations, self._tokens)]
        self._drivers.leave_all()
        with contextlib.ExitStack() as steps:  # each is taken, also after a failure; the last one first
            for step in (self._states.close, self._robots.end, self._topics.end, *reversed(declarations)):
                steps.callback(step)
            steps.callback(lambda: self._memory.end(loop_time_s()))
            steps.callback(self._states.end)  # before the token is withdrawn
            steps.callback(self._remote.withdraw_all)

    def _subscribe(
        self, keys: str, receive: Callable[[ZenohSample], None], max_bytes: int, max_waiting: int
    ) -> Declaration:
        """Subscribe to messages for this daemon (its id is in the key), or for all, with a queue for each daemon."""
        return self._transport.session.subscribe(
            keys,
            receive,
            source_of=lambda sample: self._transport.keys.sender(sample.key),
            is_known=lambda sender: self._roster.find(sender) is not None,
            max_bytes=max_bytes,
            max_waiting=max_waiting,
        )

    def _tick(self) -> None:
        now_s, transport = loop_time_s(), self._transport
        self._states.tick(self._topics.number)
        self._drivers.tick(now_s)
        self._requests.tick()
        self._robots.apply_soon(self._roster.watch(now_s) | self._roster.forget(now_s))
        self._robots.apply(self._robots.names_here())
        self._robots.follow()
        self._tell_unheard()
        for sender in self._roster.pop_stuck(now_s):
            self._relink(sender)
        if self._dropped != transport.session.counts["dropped"] and now_s >= self._found_at_s + FIND_INTERVAL_S:
            self._find_daemons(now_s)  # what was dropped may have been a token

    def _tell_unheard(self) -> None:
        """Tell users here which daemons are not heard, and that none is heard: then this host may be cut off."""
        before, self._unheard = self._unheard, self._roster.unheard()
        if before == self._unheard:
            return
        names = ", ".join(map(printable, self._unheard))
        is_deaf = bool(self._unheard) and not any(each.is_alive for each in self._roster.all())
        log.warning("fleet.hearing_changed", unheard=list(map(printable, self._unheard)), is_deaf=is_deaf)
        self._transport.counts["deaf"] += is_deaf
        if is_deaf:
            text = f"this host hears no other host of the fleet ({names} before): it may be cut off. {_UNHEARD}"
        elif self._unheard:
            text = f"not heard: {names}. {_UNHEARD}"
        else:
            text = "every host of the fleet is heard again"
        self._host.warn("fleet", text)

    def _relink(self, sender: Sender) -> None:
        """Close the links to a daemon that has a token and sends nothing: Zenoh connects again.

        After a freeze of a host, Zenoh may take a new link for one of the earlier connection. It then sends no
        declarations over it, so that the other daemon never learns who subscribes here.
        """
        self._transport.counts["relinked"] += 1
        log.warning("fleet.silent_link_closed", host=printable(sender.name), zid=printable(sender.zid))
        self._transport.session.close_links(sender.zid)

    # -- who there is -------------------------------------------------------------------------------------------------

    def _find_daemons(self, now_s: float) -> None:
        """Find all living daemons, and follow later changes."""
        session = self._transport.session
        self._tokens.close()
        self._dropped, self._found_at_s = session.counts["dropped"], now_s
        self._tokens = session.subscribe_tokens(f"{self._transport.keys.fleet}/alive/*/*", self._receive_token)

    def _receive_token(self, token: Token) -> None:
        sender = self._transport.keys.sender(token.key)
        if sender is None or sender == self._transport.me:
            return
        with bound_contextvars(**of_peer("fleet")):
            if not token.is_alive:
                self._lose(sender)
            elif self._roster.appear(sender, loop_time_s()):
                self._states.greet()
                self._requests.greet()
                log.info("fleet.daemon_appeared", host=printable(sender.name), zid=printable(sender.zid))
                self._compare_name(sender)
                self._compare_names(sender)

    def _compare_names(self, sender: Sender) -> None:
        """Warn of two daemons of one name: `drivers` and the holder of a robot name both of them."""
        others = [self._transport.me, *(each.sender for each in self._roster.all())]
        if any(other.name == sender.name and other != sender for other in others):
            log.warning("fleet.duplicate_host_found", host=printable(sender.name), zid=printable(sender.zid))
            self._host.warn(
                "fleet",
                f"two hosts of the fleet have the name {printable(sender.name)}: a driver of that name may "
                "drive from both; set zenoh.name to a different name on each",
            )

    def _compare_name(self, sender: Sender) -> None:
        """Warn of a daemon whose name is not that of its certificate: access rules use the certificate."""
        certificate = self._transport.session.certificate_of(sender.zid)
        if certificate not in ("", sender.name):
            log.warning("fleet.name_differs", host=printable(sender.name), certificate=printable(certificate))

    def _lose(self, sender: Sender) -> None:
        neighbour = self._roster.find(sender)
        if neighbour is None:
            return
        log.warning("fleet.daemon_gone", host=printable(sender.name), zid=printable(sender.zid))
        self._drivers.leave(sender.zid)
        self._robots.apply_soon(self._roster.leave(sender.zid, loop_time_s()))

    def _receive_state(self, sample: ZenohSample) -> None:
        neighbour = self._roster.announced(self._transport.keys.sender(sample.key))
        state = None if neighbour is None else self._transport.decode(sample.payload, STATE)
        if neighbour is None or state is None:
            return
        now_s = loop_time_s()
        neighbour.freshness.late_s(state.sent_s, now_s)
        self._robots.apply_soon(self._roster.receive(neighbour.sender, state, now_s))
        if state.topics != neighbour.topics:
            self._host.spawn(self._fetch_topics(neighbour, state.topics), name="topics of another daemon")

    async def _fetch_topics(self, neighbour: Neighbour, number: int) -> None:
        with self._host.around("task", task="topics of another daemon"):
            if await self._topics.fetch(neighbour, number):
                for name in list(neighbour.robots):
                    self._robots.apply((name,))
                    await asyncio.sleep(0)
                self._topics.demand()

    def _receive_answer(self, sample: ZenohSample) -> None:
        """Stops and locks are answered with the robots as they are now."""
        answer = self._requests.receive(sample)
        if answer is not None:
            self._robots.apply(state.name for state in answer.robots)


@contextlib.asynccontextmanager
async def fleet_running(host: Host, session: ZenohSession, config: ZenohSettings) -> AsyncIterator[None]:
    """A part of the fleet for the length of the block."""
    fleet = Fleet(host, session, config)
    try:
        fleet.begin()
        host.spawn(fleet.run(), name="fleet")
        yield
    finally:
        fleet.end()


def sender_name(host: str) -> str:
    """Return the name of a host in a form that a key may contain."""
    return "".join(char if char.isalnum() or char in "._-" else "-" for char in host)[:64] or "host"
