"""Names of robots: which robot a device is, which name it gets, and whether a device has reconnected."""

import itertools
import math
import re
from array import array
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import NamedTuple, TypeVar

from hostlink.robot.velocity import TWIST_TYPE

SURE_S = 3.0  # docs/protocol.md#time: a live device requests the time every 2.5 s
SOONEST_S = 0.5  # longer than the project's passthrough waits before it dials again: 0.2 s
USUAL_GAPS = 5  # a radio makes one or two late, not five
_KEPT, _ENOUGH = 16, 8  # gaps; their median tolerates a few long ones


class Presence:
    """Presence of one link. Times are monotonic, in seconds."""

    __slots__ = ("_gaps_s", "received_at_s")

    def __init__(self) -> None:
        self.received_at_s = -math.inf
        self._gaps_s = array("d")

    def note_read(self, now_s: float) -> None:
        """Note that the device sent something."""
        if now_s > self.received_at_s:
            if self.received_at_s > -math.inf:
                self._gaps_s.append(now_s - self.received_at_s)
                del self._gaps_s[:-_KEPT]
            self.received_at_s = now_s

    def is_surely_gone(self, now_s: float) -> bool:
        """Whether no device that lives is silent for so long."""
        return now_s - self.received_at_s >= SURE_S

    def is_probably_gone(self, now_s: float) -> bool:
        """Whether this one, as it used to send, would have sent by now."""
        if len(self._gaps_s) < _ENOUGH:
            return False
        return now_s - self.received_at_s >= max(SOONEST_S, USUAL_GAPS * median(self._gaps_s))


Key = TypeVar("Key")

PLAYED = "a recording"  # the address of all recordings that are played
LONGEST_NAME = 64  # characters; names are used in logs, paths and labels


class Origin(NamedTuple):
    """Facts about a device before it has a name: the name that it announces, and its address."""

    own: str  # the name that it announces
    address: str
    peer: str  # the address with its port; of a serial port the path


@dataclass(frozen=True, slots=True)
class Named:
    """A name. `is_certain`: no other device can have it, because of the configuration or of an address of its own.

    `is_new_number`: no device had it before; several devices announce the same name.
    """

    name: str
    is_certain: bool = False
    is_new_number: bool = False


class Places:
    """Addresses of robots by configuration. With thousands of robots its construction takes time."""

    def __init__(self, addresses: Mapping[str, str | None]) -> None:
        """`addresses`: robot name -> IP address, also with a port, or serial port."""
        self._names: defaultdict[str, list[str]] = defaultdict(list)
        self._with_place = {name for name, address in addresses.items() if address is not None}
        for name, address in addresses.items():
            if address is not None:
                self._names[address].append(name)

    def has(self, name: str) -> bool:
        """Whether this robot has a place."""
        return name in self._with_place

    def at(self, origin: Origin) -> list[str]:
        """The robots that are configured where the device is."""
        names = self._names.get(origin.peer, [])
        return names if origin.peer == origin.address else [*names, *self._names.get(origin.address, [])]


class RobotNames:
    """Choice of a robot's name. The first of these that is free is chosen:

    1. the name that the device announces, if the configuration gives this name to the device's address;
    2. the name that the same device had before. It is the same if it announced the same name from the same address,
       preferably from the same port. Of several, the one that connected first counts;
    3. a name that the configuration gives to the address: first those that no device had before, in their order;
    4. the name that the device announces, unless the configuration gives it to another address, or several devices
       announce it and its last owner is at another address;
    5. that name with a number: robot_0_2, robot_0_3, ...

    A recording that is played leaves its name to the robot, and is not counted among those that announce it.

    A name without a device stays its last owner's until it is forgotten.
    """

    def __init__(self, addresses: Mapping[str, str | None]) -> None:
        """`addresses`: robot name -> where it is configured to be: IP address, also with a port, or serial port."""
        self.places = Places(addresses)
        self.links: dict[str, int] = {}  # of the names that a device has now
        self._owners: dict[str, Origin] = {}
        self._of_origin: defaultdict[tuple[str, str], dict[str, None]] = defaultdict(dict)  # in the order of coming
        self._of_own: defaultdict[str, dict[str, None]] = defaultdict(dict)

    def misplaced(self, places: Places) -> list[str]:
        """Return the names that these places give to another device, or whose device they give another name."""
        right = {name for name, owner in self._owners.items() if name in places.at(owner)}
        return [
            name
            for name, owner in self._owners.items()
            if name not in right and (places.has(name) or any(here not in right for here in places.at(owner)))
        ]

    def choose(self, origin: Origin) -> Named:
        """Choose the name of a device that has none."""
        here = self.places.at(origin)
        free = [name for name in here if name not in self.links]
        is_only_one = len(here) == 1
        if origin.own in free:
            return Named(origin.own, is_only_one)
        had = self._names_of(origin)
        before = [name for name in had if name not in self.links]
        if before:
            same = next((name for name in before if self._owners[name].peer == origin.peer), None)
            return Named(same or before[0], same is not None or len(had) == 1)
        if free:
            return Named(next((name for name in free if name not in self._owners), free[0]), is_only_one)
        if self._is_free(origin):
            return Named(origin.own)
        return Named(self._numbered(origin.own), is_new_number=True)

    def assign(self, name: str, origin: Origin, link: int) -> None:
        """The device of this link has the name from now on."""
        self.forget(name)
        self.links[name] = link
        self._owners[name] = origin
        self._of_origin[origin.own, origin.address][name] = None
        if origin.address != PLAYED:
            self._of_own[origin.own][name] = None

    def leave(self, name: str) -> None:
        """Note that the device has disconnected; it keeps its name."""
        self.links.pop(name, None)

    def forget(self, name: str) -> None:
        """Anybody may have this name."""
        self.links.pop(name, None)
        owner = self._owners.pop(name, None)
        if owner is not None:
            _drop(self._of_origin, owner[:2], name)
            _drop(self._of_own, owner.own, name)

    def has_twins(self, origin: Origin) -> bool:
        """Whether several robots were seen there that announce this name."""
        return len(self._names_of(origin)) > 1

    def is_numbered(self, name: str, origin: Origin) -> bool:
        """Whether a device was given a number, because nothing distinguished it from another.

        A recording is not a device.
        """
        return origin.address != PLAYED and name != origin.own and name not in self.places.at(origin)

    def _names_of(self, origin: Origin) -> list[str]:
        return list(self._of_origin.get((origin.own, origin.address), ()))

    def _is_free(self, origin: Origin) -> bool:
        name, owner = origin.own, self._owners.get(origin.own)
        if owner is not None and owner.address == PLAYED != origin.address:
            return not self.places.has(name)
        if name in self.links or self.places.has(name):
            return False
        return owner is None or (owner.own == name and len(self._of_own.get(name, ())) <= 1)

    def _numbered(self, own: str) -> str:
        numbers = (f"_{number}" for number in itertools.count(2))
        names = (own[: LONGEST_NAME - len(number)] + number for number in numbers)
        return next(name for name in names if name not in self._owners and not self.places.has(name))


def _drop(names: defaultdict[Key, dict[str, None]], key: Key, name: str) -> None:
    names[key].pop(name, None)
    if not names[key]:
        del names[key]


ODOMETRY_TYPES = ("geometry_msgs/Pose2D", "nav_msgs/Odometry")
RESET_TYPE = "std_msgs/Empty"
_MARK, _MARK_TYPE = "played", "std_msgs/String"  # a topic of a recording that is played as a device
_USUAL_NAMES = ("velocity_commands", "cmd_vel")  # the likelier first
_DEFAULT_NAME = "robot"

LATE_S = 0.1  # what was on its way when the other device announced its topics
ANSWER_S = 0.5  # a device answers a request for its topics in a turn of its loop, its line may be busy
AGAIN_S = 10.0  # two that count each other as dead, because their loops are slow, do so within a few seconds
MOVING_S = 3.0  # by then a link that died has been ended for its silence
TopicClaim = tuple[str, str, bool]  # name, type, whether its direction is to the device
Odometry = tuple[str, str]  # name, type


@dataclass(frozen=True, slots=True)
class RobotTopicNames:
    """A robot and the topics by which it is driven and read."""

    name: str
    velocity: str
    odometry: str
    odometry_type: str
    reset: str | None

    @property
    def namespace(self) -> tuple[str, ...]:
        """Common namespace of velocity and odometry; otherwise that of the velocity, or of the odometry."""
        return _common(_namespace(self.velocity), _namespace(self.odometry))

    @property
    def own(self) -> dict[str, str]:
        """The topics that no other device may use with another type, and their types.

        Its velocity, wherever it is: that all of these have one type. The others in its namespace.
        """
        others = {self.odometry: self.odometry_type}
        if self.reset is not None:
            others[self.reset] = RESET_TYPE
        here = self.namespace
        own = {name: type_name for name, type_name in others.items() if _namespace(name)[: len(here)] == here}
        return {**own, self.velocity: TWIST_TYPE}


@dataclass(frozen=True, slots=True)
class Accepted:
    """The device may stay; `replaces` is the number of an older link of the same one.

    `own_name`: what the device calls its robot; `robot.name` is what it is called here. `is_certain`: no other device
    can have meant that name. `is_numbered`: nothing but the order distinguishes it from another device; false for a
    recording.
    """

    robot: RobotTopicNames | None
    replaces: int | None
    own_name: str = ""
    is_certain: bool = True
    is_numbered: bool = False


@dataclass(frozen=True, slots=True)
class Undecided:
    """Another link of the same robot is silent, but maybe not dead: claim again soon.

    `probe`: the links whose devices must announce their topics now.
    """

    probe: tuple[int, ...]


@dataclass(slots=True)
class _Entry:
    """Identity that a device claims."""

    origin: Origin
    key: tuple[str, Hashable]  # what it has in common with itself before a reconnect
    since_s: float
    is_settled: bool = False
    name: str | None = None  # of its robot
    is_certain: bool = False
    replaced_at_s: float = -math.inf  # when it replaced another link


class Directory:
    """Knows devices by the numbers of their links.

    A device that announces what another of its address announces is either that one, back while its old link seems
    alive, or a second one that was flashed alike. The old link's silence decides:

    | the old link                                                | then                                              |
    |-------------------------------------------------------------|---------------------------------------------------|
    | sends anything once the new one has announced its topics    | two devices; a robot gets a name of its own       |
    | silent for 3 s: a live one requests the time every 2.5 s    | the same device: the new link replaces the old    |
    | silent for 0.5 s and for five of its usual gaps             | the same device                                   |
    | else                                                        | its topics are requested, the new one waits       |
    | silent for 0.5 s after that                                 | the same device                                   |

    Where two were seen, or one was replaced less than 10 s ago, only after a silence of 3 s one counts as gone.

    A robot whose name lives at another address waits for up to 3 s if that one is silent: it may have moved. A
    recording that is played has a robot's name only until the robot itself connects, whose link replaces its own.
    """

    def __init__(self, addresses: Mapping[str, str | None]) -> None:
        """`addresses`: robot name -> the peer address or serial port that the configuration gives it."""
        self._names = RobotNames(addresses)
        self._entries: dict[int, _Entry] = {}
        self._presences: dict[int, Presence] = {}
        self._settled: defaultdict[tuple[str, Hashable], dict[int, None]] = defaultdict(dict)

    def presence(self, link: int) -> Presence:
        """Return the presence of a link, which notes each read from its device."""
        presence = self._presences.get(link)
        if presence is None:
            presence = self._presences[link] = Presence()
        return presence

    def claim(
        self,
        link: int,
        address: str,
        topics: Sequence[TopicClaim],
        *,
        now_s: float,
        peer: str = "",
        announced: Hashable = None,
    ) -> Accepted | Undecided:
        """A device has announced its topics (again); `announced`: all of it, if that is more than the topics."""
        self.presence(link).note_read(now_s)
        robot = find_robot(topics)
        if is_played(topics):
            address = peer = PLAYED
        key = (address, announced or frozenset(topics)) if robot is None else (address, robot.name)
        entry, is_new = self._entries.get(link), False
        if entry is None or entry.key != key:
            self._release(link)
            origin = Origin("" if robot is None else robot.name, address, peer)
            entry, is_new = _Entry(origin, key, now_s), True
            self._entries[link] = entry
        replaces = None
        if not entry.is_settled:
            gone, unclear = self._rivals(entry, now_s)
            if gone is None and unclear:
                return Undecided(probe=tuple(unclear) if is_new else ())
            named = None if robot is None else self._name(entry, gone, now_s)
            if robot is not None and named is None:
                return Undecided(probe=())
            # A recording that is played gives its name up to the robot.
            replaces = self._names.links.get(named.name) if gone is None and named is not None else gone
            self._settle(link, entry, named, replaces)
            entry.replaced_at_s = -math.inf if gone is None else entry.since_s
        if robot is None or entry.name is None:
            return Accepted(None, replaces)
        is_numbered = self._names.is_numbered(entry.name, entry.origin)
        return Accepted(replace(robot, name=entry.name), replaces, robot.name, entry.is_certain, is_numbered)

    def misplaced(self, places: Places) -> dict[str, int | None]:
        """The names that these places would change, and the link of each; None: its device is away."""
        return {name: self._names.links.get(name) for name in self._names.misplaced(places)}

    def reconfigure(self, places: Places) -> dict[str, int | None]:
        """Names by these places from now on; each device whose name they change must claim again.

        Returns what was `misplaced`.
        """
        misplaced = self.misplaced(places)
        self._names.places = places
        for name, link in misplaced.items():
            if link is not None:
                self._release(link)
            self._names.forget(name)
        return misplaced

    def leave(self, link: int) -> None:
        """The device's link is gone."""
        self._release(link)
        self._presences.pop(link, None)

    def forget(self, name: str) -> None:
        """Forget the robot of that name: another device may have it."""
        if name not in self._names.links:
            self._names.forget(name)

    def _rivals(self, entry: _Entry, now_s: float) -> tuple[int | None, list[int]]:
        """Links that claim the same identity: one that has ended, and those that may have."""
        links = self._settled.get(entry.key, {})
        is_again = any(now_s < self._entries[link].replaced_at_s + AGAIN_S for link in links)
        has_twins = is_again or len(links) > 1 or self._names.has_twins(entry.origin)
        unclear = []
        for link in links:
            presence = self._presences[link]
            if presence.received_at_s > entry.since_s + LATE_S:
                continue
            is_given_up = not has_twins and (
                presence.is_probably_gone(now_s) or now_s - max(entry.since_s, presence.received_at_s) >= ANSWER_S
            )
            if is_given_up or presence.is_surely_gone(now_s):
                return link, []
            unclear.append(link)
        return None, unclear

    def _name(self, entry: _Entry, replaces: int | None, now_s: float) -> Named | None:
        """None: the device that has the name at another address may be this one, with a new address."""
        name = None if replaces is None else self._entries[replaces].name
        if name is not None:
            return Named(name, not self._names.has_twins(entry.origin))
        named = self._names.choose(entry.origin)
        other = self._names.links.get(entry.origin.own)
        if other is not None and named.is_new_number and entry.origin.address != PLAYED:
            is_elsewhere = self._entries[other].origin.address != entry.origin.address
            is_silent = self._presences[other].is_probably_gone(now_s) or self._presences[other].is_surely_gone(now_s)
            if is_elsewhere and is_silent and now_s < entry.since_s + MOVING_S:
                return None
        return named

    def _settle(self, link: int, entry: _Entry, named: Named | None, replaces: int | None) -> None:
        if replaces is not None:
            self.leave(replaces)
        entry.is_settled = True
        self._settled[entry.key][link] = None
        if named is not None:
            entry.name, entry.is_certain = named.name, named.is_certain
            self._names.assign(named.name, entry.origin, link)

    def _release(self, link: int) -> None:
        entry = self._entries.pop(link, None)
        if entry is None:
            return
        if entry.is_settled:
            self._settled[entry.key].pop(link, None)
            if not self._settled[entry.key]:
                del self._settled[entry.key]
        if entry.name is not None:
            self._names.leave(entry.name)


def find_robot(topics: Sequence[TopicClaim]) -> RobotTopicNames | None:
    """A device that subscribes to a Twist and publishes a pose is a robot, named by their common namespace."""
    velocities = [topic for topic, type_name, is_to_device in topics if is_to_device and type_name == TWIST_TYPE]
    odometries = [
        (topic, type_name)
        for topic, type_name, is_to_device in topics
        if not is_to_device and type_name in ODOMETRY_TYPES
    ]
    if not velocities or not odometries:
        return None
    velocity, (odometry, odometry_type) = _likeliest_pair(velocities, odometries)
    namespaces = (_namespace(velocity), _namespace(odometry))
    resets = [
        topic
        for topic, type_name, is_to_device in topics
        if is_to_device and type_name == RESET_TYPE and "reset" in _leaf(topic) and _namespace(topic) in namespaces
    ]
    reset = min(resets, key=lambda topic: ("odom" not in _leaf(topic), topic), default=None)
    return RobotTopicNames(_name(*namespaces), velocity, odometry, odometry_type, reset)


def is_played(topics: Sequence[TopicClaim]) -> bool:
    """Whether it is a recording that is played: it says so by a topic."""
    return any(
        type_name == _MARK_TYPE and not is_to_device and _leaf(topic) == _MARK
        for topic, type_name, is_to_device in topics
    )


def _parts(topic: str) -> list[str]:
    return [part for part in topic.lstrip("~").split("/") if part]


def _leaf(topic: str) -> str:
    return _parts(topic)[-1] if _parts(topic) else ""


def _namespace(topic: str) -> tuple[str, ...]:
    return tuple(_parts(topic)[:-1])


def _common(velocity: tuple[str, ...], odometry: tuple[str, ...]) -> tuple[str, ...]:
    """Common part of two namespaces; otherwise the one that is not empty."""
    pairs = itertools.takewhile(lambda pair: pair[0] == pair[1], zip(velocity, odometry, strict=False))
    return tuple(here for here, _ in pairs) or velocity or odometry


def _name(velocity: tuple[str, ...], odometry: tuple[str, ...]) -> str:
    name = "_".join(_common(velocity, odometry))
    return re.sub(r"\W", "_", name, flags=re.ASCII)[:LONGEST_NAME] or _DEFAULT_NAME


def _likeliest_pair(velocities: Sequence[str], odometries: Sequence[Odometry]) -> tuple[str, Odometry]:
    """The pair that a person would choose: usual names, one namespace. Each topic is visited once."""
    best: dict[tuple[str, ...], Odometry] = {}
    for odometry in sorted(odometries, key=_unlikelihood, reverse=True):
        best[_namespace(odometry[0])] = odometry
    usual = min(map(_rank, velocities))
    usual_velocities = sorted(velocity for velocity in velocities if _rank(velocity) == usual)
    together = [(velocity, best[_namespace(velocity)]) for velocity in usual_velocities if _namespace(velocity) in best]
    if together:
        return min(together, key=lambda pair: (_unlikelihood(pair[1])[0], *pair))
    return usual_velocities[0], min(odometries, key=_unlikelihood)


def _rank(velocity: str) -> int:
    leaf = _leaf(velocity)
    return _USUAL_NAMES.index(leaf) if leaf in _USUAL_NAMES else len(_USUAL_NAMES)


def _unlikelihood(odometry: Odometry) -> tuple[bool, Odometry]:
    return "odom" not in _leaf(odometry[0]), odometry
