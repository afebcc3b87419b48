"""FleetRoster: which other daemons there are, and which robots each of them has. Pure."""

import math
from collections import Counter, OrderedDict, defaultdict, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import msgspec

from hostlink.components.zenoh.fleet_messages import FleetTopic, Live, RobotMessage, Sender, State
from hostlink.core.robot.admission import Freshness

MAX_DAEMONS = 256
MAX_GONE = 64  # daemons that are gone, whose robots are still shown
MAX_REMOTE_ROBOTS = 1024  # names; each change of so many keeps the loop for 40 ms
MAX_NAMESAKES = 4  # daemons that have a robot of one name; if there are two, no other daemon may drive either robot
MAX_STOPS = 64  # of one daemon, by which a repetition is known
SILENT_S = 3.0  # a daemon sends its state each second; one that has a token and sends nothing has stopped
STUCK_S = 5.0  # a daemon with a token that is silent for so long is not heard over its link


@dataclass(slots=True, eq=False)
class Neighbour:
    """Another daemon of the fleet, and its robots."""

    sender: Sender
    heard_at_s: float
    gone_at_s: float = math.inf
    robots: dict[str, RobotMessage] = field(default_factory=dict)
    topics: int = -1  # version of its list of topics
    listed: dict[str, list[FleetTopic]] = field(default_factory=dict)  # that list, by robot
    freshness: Freshness = field(default_factory=Freshness)
    is_silent: bool = False
    relinked_at_s: float = -math.inf
    was_heard: bool = False
    has_ended: bool = False  # it said so: its robots are stopped
    boards_locked: str | None = None  # reason of the lock of its boards
    successor: Sender | None = None  # the same daemon after a restart
    stops: deque[int] = field(default_factory=lambda: deque(maxlen=MAX_STOPS))  # numbers of its stops and locks, obeyed
    unanswered_since_s: float = math.inf  # the first command to it since it was heard

    @property
    def is_alive(self) -> bool:
        """Whether its robots may be connected."""
        return math.isinf(self.gone_at_s) and not self.is_silent

    def answers(self, now_s: float, within_s: float) -> bool:
        """Whether it has answered, or sent a state, within this time of a command: else users here do not see it."""
        return now_s <= self.unanswered_since_s + within_s

    def is_connected(self, name: str) -> bool:
        """Whether a robot of it is there to be driven."""
        return self.is_alive and self.robots[name].link is not None


class Place(NamedTuple):
    """Last known place of a robot. `also_at`: other daemons at which it is connected."""

    neighbour: Neighbour
    state: RobotMessage
    is_connected: bool
    also_at: tuple[str, ...]


class FleetRoster:
    """All other daemons, by the ids of their Zenoh sessions. Each method returns the names of the robots that changed.

    `counts`: `met`: daemons that began to send, or did again; `excess_daemons` and `excess_robots` over a bound;
    `foreign_topics`: robots with topics that are not theirs; `unannounced`: states of daemons that have no token.
    """

    def __init__(self, counts: Counter[str], *, forget_after_s: float = math.inf) -> None:
        self._counts, self._forget_after_s = counts, forget_after_s
        self._neighbours: dict[str, Neighbour] = {}
        self._gone: OrderedDict[str, Neighbour] = OrderedDict()
        self._by_name: defaultdict[str, dict[str, Neighbour]] = defaultdict(dict)

    def all(self) -> list[Neighbour]:
        """Every daemon that has a token."""
        return list(self._neighbours.values())

    def known(self) -> list[Neighbour]:
        """Every daemon, also those that ended or are out of sight, without those that were restarted since."""
        return [*self._neighbours.values(), *(each for each in self._gone.values() if each.successor is None)]

    def unheard(self) -> tuple[str, ...]:
        """The names of the daemons that are out of sight, or silent."""
        lost = [each for each in self.known() if not each.is_alive and each.was_heard and not each.has_ended]
        return tuple(sorted(each.sender.name for each in lost))

    def find_known(self, zid: str) -> Neighbour | None:
        """Return the daemon of an id, also if it is out of sight; None if it is forgotten."""
        return self._neighbours.get(zid) or self._gone.get(zid)

    def is_there(self, zid: str) -> bool:
        """Whether the daemon has a token."""
        return zid in self._neighbours

    def find(self, sender: Sender | None) -> Neighbour | None:
        """The daemon that has sent something, if it has a token under that name."""
        neighbour = None if sender is None else self._neighbours.get(sender.zid)
        return neighbour if neighbour is not None and neighbour.sender == sender else None

    def announced(self, sender: Sender | None) -> Neighbour | None:
        """Return the daemon that has sent a state. Count the state if the daemon has no token."""
        neighbour = self.find(sender)
        self._counts["unannounced"] += neighbour is None
        return neighbour

    def appear(self, sender: Sender, now_s: float) -> bool:
        """A daemon has a token; returns whether it is new."""
        if sender.zid in self._neighbours:
            return False
        if len(self._neighbours) >= MAX_DAEMONS:
            self._counts["excess_daemons"] += 1
            return False
        neighbour = self._gone.pop(sender.zid, None)
        if neighbour is None or neighbour.sender != sender:
            neighbour = Neighbour(sender, now_s)
        neighbour.gone_at_s, neighbour.heard_at_s = math.inf, now_s
        neighbour.is_silent, neighbour.topics = True, -1  # until it sends
        for gone in self._gone.values():
            if gone.sender.name == sender.name and gone.successor is None:
                gone.successor = sender
        self._neighbours[sender.zid] = neighbour
        return True

    def leave(self, zid: str, now_s: float) -> set[str]:
        """Follow the loss of a daemon's token: its robots stay known, and are not connected."""
        neighbour = self._neighbours.pop(zid, None)
        if neighbour is None:
            return set()
        neighbour.gone_at_s, neighbour.listed = now_s, {}
        self._gone[zid] = neighbour
        return set(neighbour.robots) | self.forget(now_s)

    def leave_all(self, now_s: float) -> None:
        """The fleet ends here: all daemons are out of sight."""
        for zid in list(self._neighbours):
            self.leave(zid, now_s)

    def names(self) -> list[str]:
        """Return the names of all known robots."""
        return list(self._by_name)

    def forget(self, now_s: float) -> set[str]:
        """Forget who has been gone for long, or before many others."""
        touched: set[str] = set()
        while self._gone:
            oldest = next(iter(self._gone.values()))
            if len(self._gone) <= MAX_GONE and now_s < oldest.gone_at_s + self._forget_after_s:
                break
            self._gone.popitem(last=False)
            touched |= set(oldest.robots)
            for name in list(oldest.robots):
                self._remove(oldest, name)
        return touched

    def receive(self, sender: Sender, state: State, now_s: float) -> set[str]:
        """Update the robots of a daemon from its state."""
        neighbour = self.announced(sender)
        if neighbour is None:
            return set()
        self._counts["met"] += neighbour.is_silent
        neighbour.heard_at_s, neighbour.is_silent, neighbour.was_heard = now_s, False, True
        neighbour.has_ended, neighbour.unanswered_since_s = state.is_last, math.inf
        neighbour.boards_locked = state.boards_locked
        robots = {robot.name: robot for robot in state.robots if robot.is_below_its_name}
        self._counts["foreign_topics"] += len(state.robots) - len(robots)
        touched = set(neighbour.robots) | set(robots)
        for name in neighbour.robots.keys() - robots.keys():
            self._remove(neighbour, name)
        for name, robot in robots.items():
            self._put(neighbour, name, robot)
        return touched

    def receive_motions(self, sender: Sender, live: Live, now_s: float) -> set[str]:
        """A daemon has sent how its robots move."""
        neighbour = self.announced(sender)
        if neighbour is None:
            return set()
        neighbour.heard_at_s = now_s
        touched = set()
        for motion in live.robots:
            state = neighbour.robots.get(motion.name)
            if state is not None:
                changed = msgspec.structs.replace(
                    state, velocity=motion.velocity, linear_y_m_s=motion.linear_y_m_s, pose=motion.pose
                )
                neighbour.robots[motion.name] = changed
                touched.add(motion.name)
        return touched

    def watch(self, now_s: float) -> set[str]:
        """Note the daemons that have sent nothing for SILENT_S."""
        silent = [
            each for each in self._neighbours.values() if not each.is_silent and now_s > each.heard_at_s + SILENT_S
        ]
        for neighbour in silent:
            neighbour.is_silent = True
        return {name for neighbour in silent for name in neighbour.robots}

    def pop_stuck(self, now_s: float) -> list[Sender]:
        """Return the daemons that have a token and send nothing for STUCK_S, each again after as long."""
        stuck = [
            each
            for each in self._neighbours.values()
            if each.is_silent and now_s > max(each.heard_at_s, each.relinked_at_s) + STUCK_S
        ]
        for neighbour in stuck:
            neighbour.relinked_at_s = now_s
        return [each.sender for each in stuck]

    def place(self, name: str) -> Place | None:
        """Return the daemon at which a robot is connected, or was last; None for an unknown robot."""
        known = self._by_name.get(name)
        if not known:
            return None
        ordered = sorted(known.values(), key=lambda each: each.sender)
        connected = [each for each in ordered if each.is_connected(name)]
        chosen = connected[0] if connected else max(ordered, key=lambda each: (each.is_alive, each.heard_at_s))
        also_at = tuple(each.sender.name for each in connected[1:])
        return Place(chosen, chosen.robots[name], bool(connected), also_at)

    def connected_at(self, name: str) -> tuple[str, ...]:
        """The names of the daemons at which it is connected."""
        known = self._by_name.get(name, {}).values()
        return tuple(sorted(each.sender.name for each in known if each.is_connected(name)))

    def _put(self, neighbour: Neighbour, name: str, robot: RobotMessage) -> None:
        known = self._by_name.get(name, {})
        if neighbour.sender.zid not in known:
            is_new = name not in self._by_name
            if len(known) >= MAX_NAMESAKES or (is_new and len(self._by_name) >= MAX_REMOTE_ROBOTS):
                self._counts["excess_robots"] += 1
                return
            self._by_name[name][neighbour.sender.zid] = neighbour
        neighbour.robots[name] = robot

    def _remove(self, neighbour: Neighbour, name: str) -> None:
        neighbour.robots.pop(name, None)
        known = self._by_name.get(name, {})
        known.pop(neighbour.sender.zid, None)
        if not known:
            self._by_name.pop(name, None)
