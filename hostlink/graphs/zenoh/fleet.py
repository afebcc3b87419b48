"""Fleet: daemons that show and drive each other's robots. The gate of a robot, and who drives it, stay where it is."""

import asyncio
import contextlib
import socket
from collections import Counter
from collections.abc import AsyncIterator, Callable

import structlog
from structlog.contextvars import bound_contextvars

from hostlink.config import ZenohConfig
from hostlink.graphs.zenoh.fleet_commands import FleetDrivers, FleetRequests
from hostlink.graphs.zenoh.fleet_messages import (
    LIVE,
    MAX_REQUEST_BYTES,
    MAX_STATE_BYTES,
    STATE,
    FleetTransport,
    Keys,
    Sender,
)
from hostlink.graphs.zenoh.fleet_robots import FleetRobots, FleetStates
from hostlink.graphs.zenoh.fleet_topics import MAX_MESSAGE_BYTES, FleetTopics
from hostlink.graphs.zenoh.roster import FleetRoster, Neighbour
from hostlink.graphs.zenoh.session import Declaration, Token, ZenohSample, ZenohSession
from hostlink.hub.hub import Hub
from hostlink.logs import of_peer, printable

log = structlog.get_logger()

TICK_S = 0.1
FIND_INTERVAL_S = 5.0  # between two searches for daemons whose tokens may have been dropped


class Fleet:
    """Membership of this daemon in the fleet."""

    def __init__(self, hub: Hub, session: ZenohSession, config: ZenohConfig) -> None:
        counts: Counter[str] = Counter()
        hub.counts.graphs["fleet"] = lambda: counts
        me = Sender(config.name or sender_name(socket.gethostname()), session.zid)
        self._hub, self._transport = hub, FleetTransport(session, Keys(config.fleet_name), me, counts, config.drivers)
        self._roster = FleetRoster(counts, forget_after_s=hub.config.link.forget_robot_after_s)
        self._states = FleetStates(hub, self._transport)
        self._drivers = FleetDrivers(hub, self._transport, self._roster)
        self._requests = FleetRequests(self._transport, self._roster)
        self._topics = FleetTopics(hub, self._transport, self._drivers, self._roster)
        self._robots = FleetRobots(
            hub, self._transport, self._roster, self._requests, self._topics, receive=self._receive_motions
        )
        self._declarations: list[Declaration] = []
        self._tokens = Declaration()  # the subscription to those of other daemons
        self._dropped = 0  # by Zenoh, when it was made
        self._found_at_s = 0.0
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
        self._find_daemons(_now_s())
        self._topics.begin()
        self._hub.gates.reach(self._requests)

    async def run(self) -> None:
        """Send states, and watch the others, until `end`."""
        while not self._has_ended:
            with self._hub.isolation.around("graph", graph="fleet"):
                self._tick()
            await asyncio.sleep(TICK_S)

    def end(self) -> None:
        """Leave the fleet: the robots of others are unknown, and what others drive here stops."""
        self._has_ended = True
        self._hub.gates.reach(None)
        for declaration in (*self._declarations, self._tokens):
            declaration.close()
        self._topics.end()
        self._robots.end()
        self._states.close()
        self._drivers.leave_all()

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
        now_s, transport = _now_s(), self._transport
        self._states.tick(self._topics.number)
        self._drivers.tick(now_s)
        self._requests.tick()
        self._robots.apply_soon(self._roster.watch(now_s) | self._roster.forget(now_s))
        self._robots.apply(self._names_here())
        self._robots.follow(now_s)
        if self._dropped != transport.session.counts["dropped"] and now_s >= self._found_at_s + FIND_INTERVAL_S:
            self._find_daemons(now_s)  # what was dropped may have been a token

    def _names_here(self) -> set[str]:
        """Return robots here whose name another daemon has too: one of them may have connected or left."""
        return {robot.name for robot in self._hub.robots.here()} & self._hub.robots.remote.keys()

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
            elif self._roster.appear(sender, _now_s()):
                self._states.greet()
                log.info("fleet.daemon_appeared", host=printable(sender.name), zid=printable(sender.zid))
                self._compare_name(sender)

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
        self._robots.lose(sender.zid)
        self._robots.apply_soon(self._roster.leave(sender.zid, _now_s()))

    def _receive_state(self, sample: ZenohSample) -> None:
        neighbour = self._roster.announced(self._transport.keys.sender(sample.key))
        state = None if neighbour is None else self._transport.decode(sample.payload, STATE)
        if neighbour is None or state is None:
            return
        now_s = _now_s()
        neighbour.freshness.late_s(state.sent_s, now_s)
        self._robots.apply_soon(self._roster.receive(neighbour.sender, state, now_s))
        if state.topics != neighbour.topics:
            self._hub.spawn(self._fetch_topics(neighbour, state.topics), name="topics of another daemon")

    async def _fetch_topics(self, neighbour: Neighbour, number: int) -> None:
        if await self._topics.fetch(neighbour, number):
            for name in list(neighbour.robots):
                self._robots.apply((name,))
                await asyncio.sleep(0)
            self._topics.demand()

    def _receive_motions(self, sample: ZenohSample) -> None:
        sender, live = self._transport.keys.sender(sample.key), self._transport.decode(sample.payload, LIVE)
        if sender is not None and live is not None:
            self._robots.apply_soon(self._roster.receive_motions(sender, live, _now_s()))

    def _receive_answer(self, sample: ZenohSample) -> None:
        """Stops and locks are answered with the robots as they are now."""
        neighbour, answer = self._roster.find(self._transport.keys.sender(sample.key)), self._requests.receive(sample)
        if answer is None or neighbour is None:
            return
        for state in answer.robots:
            if state.name in neighbour.robots:
                neighbour.robots[state.name] = state
                self._robots.apply((state.name,))


@contextlib.asynccontextmanager
async def fleet_running(hub: Hub, session: ZenohSession, config: ZenohConfig) -> AsyncIterator[None]:
    """A part of the fleet for the length of the block."""
    fleet = Fleet(hub, session, config)
    fleet.begin()
    hub.spawn(fleet.run(), name="fleet")
    try:
        yield
    finally:
        fleet.end()


def sender_name(host: str) -> str:
    """Return the name of a host in a form that a key may contain."""
    return "".join(char if char.isalnum() or char in "._-" else "-" for char in host)[:64] or "host"


def _now_s() -> float:
    return asyncio.get_running_loop().time()
