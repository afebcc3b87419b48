"""Names of robots: which robot a device is, which name it gets, and whether a device has reconnected."""

import itertools
import math
import re
from array import array
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from statistics import median
from typing import NamedTuple, TypeVar

from hostlink.core.robot.model import (
    LONGEST_NAME,
    NO_SETTINGS,
    CommandSettings,
    Endpoint,
    RobotTopicNames,
    find_robot,
    has_command,
    matched,
    name_of_node,
    select,
)
from hostlink.core.robot.parts import Membership, place_in, takes_velocity

SURE_S = 3.0  # docs/protocol.md#time: a live device requests the time every 2.5 s
SOONEST_S = 0.5  # longer than the project's passthrough waits before it dials again: 0.2 s
USUAL_GAPS = 5  # a radio makes one or two late, not five
USUAL_PAUSES = 2  # a slow loop sends in bursts: the second longest of the last gaps, because one may be an outage
ANSWER_S = 0.5  # a device answers a request for its topics in a turn of its loop, its line may be busy
USUAL_ANSWERS = 3  # a device with a slow loop answers in its next turn
_KEPT, _ENOUGH = 16, 8  # gaps; their median tolerates a few long ones

PLAYED = "a recording"  # the address of all recordings that are played
UNNAMED = "robot"  # with a number: the name of a robot that nothing names
MAX_REMEMBERED = 4096  # names; the one that was used least recently is forgotten first

LATE_S = 0.1  # what was on its way when the other device announced its topics
ALIVE_S = 0.25  # a link that has died delivers what was on its way at once, after an outage also later
AGAIN_S = 10.0  # two that count each other as dead, because their loops are slow, do so within a few seconds
MOVING_S = 3.0  # by then a link that died has been ended for its silence


class Presence:
    """Presence of one link. Times are monotonic, in seconds."""

    __slots__ = ("_gaps_s", "answer_s", "answered_s", "asked_at_s", "received_at_s")

    def __init__(self) -> None:
        self.received_at_s = -math.inf
        self.asked_at_s = -math.inf  # when its device was asked for its topics
        self.answered_s = -math.inf  # when the last of these requests was sent that the device answered
        self.answer_s = 0.0  # how long that answer took
        self._gaps_s = array("d")

    def note_read(self, now_s: float) -> None:
        """Note that the device sent something."""
        if now_s > self.received_at_s:
            if self.received_at_s > -math.inf:
                self._gaps_s.append(now_s - self.received_at_s)
                del self._gaps_s[:-_KEPT]
            self.received_at_s = now_s

    def note_asked(self, now_s: float) -> None:
        """Note that the device was asked for its topics, which a live one answers."""
        self.asked_at_s = now_s

    def note_answered(self, asked_at_s: float, now_s: float) -> None:
        """Note that the device has begun to answer the request that was sent at `asked_at_s`."""
        self.answered_s, self.answer_s = asked_at_s, now_s - asked_at_s

    def is_without_answer(self, since_s: float, now_s: float) -> bool:
        """Whether the device was asked after `since_s`, and is silent for longer than it takes to answer."""
        silent_s = now_s - max(self.asked_at_s, self.received_at_s)
        return self.asked_at_s >= since_s and silent_s >= max(ANSWER_S, USUAL_ANSWERS * self.answer_s)

    def is_surely_gone(self, now_s: float) -> bool:
        """Whether no device that lives is silent for so long."""
        return now_s - self.received_at_s >= SURE_S

    def is_probably_gone(self, now_s: float) -> bool:
        """Whether this one, as it used to send, would have sent by now."""
        if len(self._gaps_s) < _ENOUGH:
            return False
        *_, pause_s, _ = sorted(self._gaps_s)
        usual_s = max(SOONEST_S, USUAL_GAPS * median(self._gaps_s), USUAL_PAUSES * pause_s)
        return now_s - self.received_at_s >= usual_s


Key = TypeVar("Key")

_NUMBERED = re.compile(rf"{UNNAMED}(_[0-9]+)*", re.ASCII)  # names that robots without a name get, or announce


class Origin(NamedTuple):
    """Facts about a device before it has a name: the name that it announces, and its address."""

    own: str  # the name that it announces; robot_0 if it announces none
    address: str
    peer: str  # the address with its port; of a serial port the path
    is_unnamed: bool = False  # neither namespace nor topic tell a name
    unfit: frozenset[str] = frozenset()  # robots whose settings at this address name topics that the device lacks


@dataclass(frozen=True, slots=True)
class Remembered:
    """Last owner of a name, as the daemon knew it before its restart: what it announced, and its address.

    The address is empty if the name was forgotten since.
    """

    own: str
    address: str
    is_unnamed: bool = False

    def is_of(self, origin: Origin) -> bool:
        """Whether a device with this origin may be that owner."""
        return (self.own, self.address, self.is_unnamed) == (origin.own, origin.address, origin.is_unnamed)


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

    def __init__(self, addresses: Mapping[str, str | None], devices: Mapping[str, Sequence[str]] | None = None) -> None:
        """`addresses`: robot name -> IP address, also with a port, or serial port. `devices`: robots of several, and
        where these are.
        """
        self._names: defaultdict[str, list[str]] = defaultdict(list)
        self._configured = frozenset(addresses)
        self._with_place = {name for name, address in addresses.items() if address is not None} | set(devices or {})
        for name, address in addresses.items():
            if address is not None:
                self._names[address].append(name)
        self._of_several = frozenset(devices or {})
        for name, places in (devices or {}).items():
            for place in places:
                self._names[place].append(name)

    def has(self, name: str) -> bool:
        """Whether this robot has a place."""
        return name in self._with_place

    def keeps(self, name: str, member: Membership | None, *, is_connected: bool) -> bool:
        """Whether a robot of several devices has its name by its part `member`, or by one that will connect."""
        if not is_connected:
            return name in self._of_several
        return member is not None and member.robot == name and name in self._names.get(member.place, ())

    def is_configured(self, name: str) -> bool:
        """Whether the configuration names this robot, with or without a place."""
        return name in self._configured

    def at(self, origin: Origin) -> list[str]:
        """The robots that are configured where the device is, without those that it cannot be."""
        names = self._names.get(origin.peer, [])
        if origin.peer != origin.address:
            names = [*names, *self._names.get(origin.address, [])]
        return [name for name in names if name not in origin.unfit] if origin.unfit else names

    def nearest(self, origin: Origin) -> list[str]:
        """The robots that are configured at the device's port, or else at its address."""
        return self._names.get(origin.peer) or self._names.get(origin.address, [])

    def differ(self, one: Origin, other: Origin) -> bool:
        """Whether the settings tell two devices of one address apart by their ports."""
        return one.peer != other.peer and any(
            each.peer != each.address and each.peer in self._names for each in (one, other)
        )


class RobotNames:
    """Choice of a robot's name. The first of these that is free is chosen:

    1. the name that the device announces, if the configuration gives this name to the device's address;
    2. the name that the same device had before. It is the same if it announced the same name from the same address,
       preferably from the same port. Of several, the one that connected first counts;
    3. a name that the configuration gives to the address: first those that no device had before, in their order;
    4. the name that the device announces, unless the configuration gives it to another address, or several devices
       announce it and its last owner is at another address;
    5. that name with a number: car_2, car_3, ...

    A robot that announces no name is robot_0, robot_1, ...: the first that no device has or had. `remembered` keeps
    these names over restarts of the daemon, with the addresses of their owners:

    | a name like robot_0 was that of                          | after a restart it is given to                     |
    |----------------------------------------------------------|----------------------------------------------------|
    | the only robot without a name at an address              | the robot without a name at this address           |
    | one of several robots without a name at one address      | none of them: nothing tells which one it was       |
    | a robot that announces it                                | one that announces it, by the rules above          |

    A robot that announces robot_0 is robot_0_2 while that is the name of another one that announces nothing.

    A recording that is played leaves its name to the robot, and is not counted among those that announce it.

    A name without a device stays its last owner's until it is forgotten.
    """

    def __init__(
        self,
        addresses: Mapping[str, str | None],
        several: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        """`addresses`: robot name -> where it is configured to be: IP address, also with a port, or serial port.

        `several`: robots of several devices.
        """
        self.places = Places(addresses, several)
        self.remembered: dict[str, Remembered] = {}  # name -> its owner; the one that was used last is the last one
        self.links: dict[str, int] = {}  # of the names that a device has now
        self._owners: dict[str, Origin] = {}
        self._of_origin: defaultdict[tuple[str, str, bool], dict[str, None]] = defaultdict(dict)  # in order of coming
        self._of_own: defaultdict[str, dict[str, None]] = defaultdict(dict)  # of devices that announce it

    def remember(self, remembered: Mapping[str, Remembered]) -> None:
        """Remember owners from before the restart. A name that the configuration places is not theirs any longer."""
        found = {name: owner for name, owner in remembered.items() if _NUMBERED.fullmatch(name)}
        self.remembered = {name: owner for name, owner in found.items() if not self.places.has(name)} | self.remembered
        self._bound()

    def _bound(self) -> None:
        while len(self.remembered) > MAX_REMEMBERED:
            del self.remembered[next(iter(self.remembered))]

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
        had = [name for name in self._names_of(origin) if name in here or not self.places.has(name)]
        before = [name for name in had if name not in self.links]
        if before:
            same = next((name for name in before if self._owners[name].peer == origin.peer), None)
            return Named(same or before[0], same is not None or len(had) == 1)
        if free:
            return Named(next((name for name in free if name not in self._owners), free[0]), is_only_one)
        known = self._known(origin)
        if not had and len(known) == 1 and self._is_unused(known[0]):
            return Named(known[0])
        if origin.is_unnamed:
            return Named(self._unnamed(origin))
        if self._is_free(origin):
            return Named(origin.own)
        return Named(self._numbered(origin.own), is_new_number=True)

    def assign(self, name: str, origin: Origin, link: int) -> None:
        """The device of this link has the name from now on."""
        self.forget(name)
        self.links[name] = link
        self._owners[name] = origin
        self._of_origin[_key(origin)][name] = None
        if origin.address != PLAYED:
            if not origin.is_unnamed:
                self._of_own[origin.own][name] = None
            self.remembered.pop(name, None)
            if _NUMBERED.fullmatch(name) and not self.places.has(name):
                self.remembered[name] = Remembered(origin.own, origin.address, origin.is_unnamed)
                self._bound()

    def leave(self, name: str) -> None:
        """Note that the device has disconnected; it keeps its name."""
        self.links.pop(name, None)

    def forget(self, name: str) -> None:
        """Anybody may have this name."""
        self.links.pop(name, None)
        owner = self._owners.pop(name, None)
        if owner is not None:
            _drop(self._of_origin, _key(owner), name)
            _drop(self._of_own, owner.own, name)

    def forget_address(self, name: str) -> None:
        """Forget where a robot was that announces its name: it may be anywhere. Others keep their names for long."""
        owner = self.remembered.get(name)
        if owner is not None and not owner.is_unnamed:
            del self.remembered[name]
            if owner.own == name:  # no robot that announces nothing may have it
                self.remembered[name] = replace(owner, address="")

    def has_twins(self, origin: Origin) -> bool:
        """Whether several robots were seen there that announce this name."""
        return len(self._names_of(origin)) > 1

    def is_numbered(self, name: str, origin: Origin) -> bool:
        """Whether a device was given a number, because nothing distinguished it from another.

        A recording is not a device. A robot that announces no name has the number of its address.
        """
        if origin.is_unnamed and len(self._names_of(origin)) <= 1 and len(self._known(origin)) <= 1:
            return False
        return origin.address != PLAYED and name != origin.own and name not in self.places.at(origin)

    def _names_of(self, origin: Origin) -> list[str]:
        return list(self._of_origin.get(_key(origin), ()))

    def _known(self, origin: Origin) -> list[str]:
        return [name for name, owner in self.remembered.items() if owner.is_of(origin)]

    def _is_unused(self, name: str) -> bool:
        return name not in self._owners and not self.places.has(name)

    def _is_free(self, origin: Origin) -> bool:
        name, owner = origin.own, self._owners.get(origin.own)
        if self.places.has(name):
            return False
        if not self._may_have_been(name, origin):
            return False
        if owner is not None and owner.address == PLAYED != origin.address:
            return True
        if name in self.links:
            return False
        return owner is None or (owner.own == name and len(self._of_own.get(name, ())) <= 1)

    def _may_have_been(self, name: str, origin: Origin) -> bool:
        """Whether a device that announces a name can be the last one that had it, as far as that is remembered."""
        last = self.remembered.get(name)
        if last is None or last.is_of(origin):
            return True
        namesakes = (each for each in self.remembered.values() if each.own == last.own and not each.is_unnamed)
        return not last.is_unnamed and last.own == name and (not last.address or len(list(namesakes)) <= 1)

    def _unnamed(self, origin: Origin) -> str:
        """Return the first of robot_0, robot_1, ... that no device has or had."""
        names = itertools.chain((origin.own,), (f"{UNNAMED}_{number}" for number in itertools.count()))
        return next(name for name in names if self._is_unused(name) and name not in self.remembered)

    def _numbered(self, own: str) -> str:
        numbers = (f"_{number}" for number in itertools.count(2))
        names = (own[: LONGEST_NAME - len(number)] + number for number in numbers)
        return next(name for name in names if self._is_unused(name) and name not in self.remembered)


def _key(origin: Origin) -> tuple[str, str, bool]:
    """Return what a device has in common with itself before it reconnected."""
    return origin.own, origin.address, origin.is_unnamed


def _drop(names: defaultdict[Key, dict[str, None]], key: Key, name: str) -> None:
    found = names.get(key)
    if found is not None:
        found.pop(name, None)
        if not found:
            del names[key]


_PLAYED_TYPE = "hostlink_msgs/PlayedRecording"  # of a topic that only a recording has which is played as a device


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
    settings: CommandSettings = NO_SETTINGS  # of the robot's command
    member: Membership | None = None  # of a robot of several devices, also if `robot` is None


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
    member: Membership | None = None
    is_waiting: bool = False  # for the place of its member: another device has it
    is_certain: bool = False
    replaced_at_s: float = -math.inf  # when it replaced another link
    lacks_command: bool = False  # its settings name topics that it lacks
    heard_s: dict[int, float] = field(default_factory=dict)  # by rival: its first sign of life since

    def is_alive(self, link: int, presence: Presence) -> bool:
        """Whether a rival is alive: it has answered since the device announced its topics, or sends again and again."""
        received_s = presence.received_at_s
        if presence.answered_s >= self.since_s:
            return True
        return received_s > self.since_s + LATE_S and received_s >= self.heard_s.setdefault(link, received_s) + ALIVE_S


class _Described(NamedTuple):
    """Settings that describe a device, and the robot that it is if it has their topics.

    `unfit`: robots of its address that it cannot be, because it lacks their topics.
    """

    chosen: str | None
    settings: CommandSettings
    unfit: frozenset[str] = frozenset()


class Directory:
    """Knows devices by the numbers of their links.

    A device that announces what another of its address announces is either that one, back while its old link seems
    alive, or a second one that was flashed alike. The old link's silence decides:

    | the old link                                                | then                                              |
    |-------------------------------------------------------------|---------------------------------------------------|
    | sends anything once the new one has announced its topics,   | two devices; a robot gets a name of its own       |
    | and again 0.25 s later; or answers a request for its topics |                                                   |
    | that was sent since                                         |                                                   |
    | silent for 3 s: a live one requests the time every 2.5 s    | the same device: the new link replaces the old    |
    | silent for 0.5 s and for five of its usual gaps, and for    | the same device                                   |
    | twice as long as its second longest pause of late           |                                                   |
    | else                                                        | its topics are requested, the new one waits       |
    | silent after that for 0.5 s and for three times as long as  | the same device                                   |
    | its last answer took                                        |                                                   |

    Where two were seen, or one was replaced less than 10 s ago, only after a silence of 3 s one counts as gone.

    A robot whose name lives at another address waits for up to 3 s if that one is silent: it may have moved. A
    recording that is played has a robot's name only until the robot itself connects, whose link replaces its own.

    Of several devices that an entry of a robot's `devices` means, the first one has this place until its link ends.
    The others wait: each may take the place after `offer`.
    """

    def __init__(
        self,
        addresses: Mapping[str, str | None],
        settings: Mapping[str, CommandSettings] | None = None,
    ) -> None:
        """`addresses`: robot name -> the peer address or serial port that the configuration gives it.

        `settings`: what commands each robot.
        """
        several = {name: each.devices for name, each in (settings or {}).items() if each.devices}
        self._names = RobotNames(addresses, several)
        self._set_commands(settings or {})
        self._entries: dict[int, _Entry] = {}
        self._presences: dict[int, Presence] = {}
        self._settled: defaultdict[tuple[str, Hashable], dict[int, None]] = defaultdict(dict)
        self._holders: dict[Membership, int] = {}  # link of the device that has each place

    @property
    def remembered(self) -> dict[str, Remembered]:
        """Names like robot_0 and their owners, for the next start of the daemon."""
        return self._names.remembered

    def remember(self, remembered: Mapping[str, Remembered]) -> None:
        """Remember owners of names from before the restart."""
        self._names.remember(remembered)

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
        topics: Sequence[Endpoint],
        *,
        now_s: float,
        peer: str = "",
        announced: Hashable = None,
        node: str = "",
    ) -> Accepted | Undecided:
        """A device has announced its topics (again); `announced`: all of it, if that is more than the topics.

        `node`: name of its node, if it has one, which names a robot whose topics tell no name.
        """
        self.presence(link).note_read(now_s)
        robot, settings = self.find(topics, Origin("", address, peer))
        member = self.member(topics, Origin("", address, peer))
        if member is not None and self._is_other_commanded(link, member):
            robot = None
        if is_played(topics):
            address = peer = PLAYED
        if robot is not None and not robot.name and (name := name_of_node(node)):
            robot = replace(robot, name=name)
        is_unnamed = robot is not None and not robot.name
        if robot is not None and is_unnamed:
            own = UNNAMED if self._names.places.is_configured(UNNAMED) else f"{UNNAMED}_0"
            robot = replace(robot, name=own)
        key: tuple[str, Hashable] = (address, robot.name if robot is not None and not is_unnamed else "")
        if robot is None or is_unnamed:  # nothing but its topics distinguishes it from another
            key = (address, announced or frozenset(topics))
        entry, is_new = self._entries.get(link), False
        if entry is None or entry.key != key or entry.member != member:
            self._release(link)
            unfit = self._described(topics, Origin("", address, peer)).unfit
            origin = Origin("" if robot is None else robot.name, address, peer, is_unnamed, unfit)
            was_waiting = entry is not None and entry.is_waiting and entry.member == member
            lacks_command = member is None and not has_command(settings, topics)
            entry, is_new = (
                _Entry(origin, key, now_s, member=member, is_waiting=was_waiting, lacks_command=lacks_command),
                True,
            )
            self._entries[link] = entry
        replaces = None
        if not entry.is_settled:
            gone, unclear = self._rivals(entry, now_s)
            if gone is None and unclear:
                return Undecided(probe=tuple(unclear) if is_new else ())
            entry.is_waiting |= self._is_taken(member, gone)
            if entry.is_waiting:
                robot = None
            named = None if robot is None else self._name(entry, gone, now_s)
            if robot is not None and named is None:
                return Undecided(probe=())
            # A recording that is played gives its name up to the robot.
            replaces = self._names.links.get(named.name) if gone is None and named is not None else gone
            self._settle(link, entry, named, replaces)
            entry.replaced_at_s = -math.inf if gone is None else entry.since_s
        if member is not None:
            member = member._replace(is_waiting=entry.is_waiting)
        if robot is None or entry.name is None:
            return Accepted(None, replaces, settings=settings, member=member)
        is_numbered = self._names.is_numbered(entry.name, entry.origin)
        here = replace(robot, name=entry.name)
        return Accepted(here, replaces, robot.name, entry.is_certain, is_numbered and not member, settings, member)

    def member(self, topics: Sequence[Endpoint], origin: Origin) -> Membership | None:
        """Return of which robot of several devices this is a part; None: it is not. A recording is a part of none."""
        if is_played(topics):
            return None
        for name, settings in self._of_several.items():
            place = place_in(settings.devices, topics, peer=origin.peer, address=origin.address)
            if place is not None:
                return Membership(name, place)
        return None

    def _is_taken(self, member: Membership | None, gone: int | None) -> bool:
        """Whether another device has this place. One that replaces a device that waited waits, too."""
        if member is None:
            return False
        return self._holders.get(member, gone) != gone or (gone is not None and self._entries[gone].is_waiting)

    def placed(self, origin: Origin) -> list[str]:
        """Return the robots that the settings place at the device's port, or else at its address."""
        return self._names.places.nearest(origin)

    def is_free(self, member: Membership) -> bool:
        """Whether no device has this place of a robot."""
        return member._replace(is_waiting=False) not in self._holders

    def offer(self, link: int) -> None:
        """Let a device that waits for a place have it, if it is free when the device claims again."""
        self._release(link)

    def _is_other_commanded(self, link: int, member: Membership) -> bool:
        """Whether another device has the robot's name: two that take a velocity are not one robot."""
        other = self._names.links.get(member.robot)
        return other is not None and other != link and self._entries[other].member != member

    def _described(self, topics: Sequence[Endpoint], origin: Origin) -> _Described:
        """Return the robot whose settings describe a device, and these settings.

        Settings with the device's address precede; then those without an address whose topics the device has. The only
        ones of its address describe it also if it lacks their topics: one of them may have a wrong name.
        """
        places = self._names.places
        here = {name: self._settings[name] for name in places.at(origin) if name in self._settings}
        chosen = select(here, topics) or select(self._free, topics)
        if chosen is not None:
            return _Described(chosen, self._settings[chosen])
        recognising = [each for each in here.values() if not each.topics]
        only = places.nearest(origin)
        if not recognising and len(only) == 1:
            return _Described(None, here.get(only[0], NO_SETTINGS))
        unfit = frozenset(name for name, each in here.items() if each.topics)
        return _Described(None, next(iter(recognising), NO_SETTINGS), unfit)

    def find(self, topics: Sequence[Endpoint], origin: Origin) -> tuple[RobotTopicNames | None, CommandSettings]:
        """Return the robot that a device is, by its topics and the settings, and these; None: it takes no velocity.

        The settings have the names of topics as the device announces them.
        """
        member = self.member(topics, origin)
        if member is not None:
            settings = matched(self._settings[member.robot], topics)
            is_commanded = takes_velocity(member.place, topics, settings)
            return find_robot(topics, settings) if is_commanded else None, settings
        described = self._described(topics, origin)
        settings = matched(described.settings, topics)
        robot = find_robot(topics, settings)
        if robot is not None and described.chosen is not None:
            return replace(robot, name=described.chosen), settings
        named = NO_SETTINGS if robot is None else self._settings.get(robot.name, NO_SETTINGS)
        if robot is not None and settings == NO_SETTINGS and named != NO_SETTINGS:
            is_elsewhere = self._names.places.has(robot.name)
            if not named.topics or not (is_elsewhere or named.is_spatial or named.devices):
                named = matched(named, topics)
                return find_robot(topics, named), named
        return robot, settings

    def explain(self, topics: Sequence[Endpoint], origin: Origin) -> tuple[RobotTopicNames | None, str | None]:
        """Return the robot that a device is by its own topics and settings, and the name that the settings give it."""
        member = self.member(topics, origin)
        chosen, _, unfit = self._described(topics, origin) if member is None else _Described(member.robot, NO_SETTINGS)
        given = next(iter(self._names.places.at(origin._replace(unfit=unfit))), None)
        return self.find(topics, origin)[0], chosen if chosen is not None else given

    def misplaced(self, places: Places) -> dict[str, int | None]:
        """The names that these places would change, and the link of each; None: its device is away."""
        links = {name: self._names.links.get(name) for name in self._names.misplaced(places)}
        members = {name: None if link is None else self._entries[link].member for name, link in links.items()}
        return {
            name: link
            for name, link in links.items()
            if not places.keeps(name, members[name], is_connected=link is not None)
        }

    def reconfigure(self, places: Places, settings: Mapping[str, CommandSettings]) -> dict[str, int | None]:
        """Name by these places and settings from now on; each device whose name they change must claim again.

        Returns what was `misplaced`.
        """
        misplaced = self.misplaced(places)
        self._names.places = places
        before = self._settings
        self._set_commands(settings)
        members = {number: each.member.robot for number, each in self._entries.items() if each.member is not None}
        for number, robot in members.items():
            if before.get(robot) != settings.get(robot):
                self._release(number)
        for name, link in misplaced.items():
            if link is not None:
                self._release(link)
            self._names.forget(name)
            self._names.remembered.pop(name, None)
        return misplaced

    def _set_commands(self, settings: Mapping[str, CommandSettings]) -> None:
        self._settings = dict(settings)
        self._of_several = {name: each for name, each in settings.items() if each.devices}
        free = (name for name in settings if not self._names.places.has(name))
        self._free = {name: settings[name] for name in free if settings[name].topics}

    def leave(self, link: int) -> None:
        """The device's link is gone."""
        self._release(link)
        self._presences.pop(link, None)

    def forget(self, name: str) -> None:
        """Forget the robot of that name: another device may have it."""
        if name not in self._names.links:
            self._names.forget(name)
            self._names.forget_address(name)

    def _rivals(self, entry: _Entry, now_s: float) -> tuple[int | None, list[int]]:
        """Links that claim the same identity: one that has ended, and those that may have."""
        settled = self._settled.get(entry.key, {})
        links = [link for link in settled if not self._names.places.differ(entry.origin, self._entries[link].origin)]
        is_again = any(now_s < self._entries[link].replaced_at_s + AGAIN_S for link in links)
        has_twins = is_again or len(links) > 1 or self._names.has_twins(entry.origin)
        unclear = []
        for link in links:
            presence = self._presences[link]
            if entry.is_alive(link, presence):
                continue
            is_given_up = not has_twins and (
                presence.is_probably_gone(now_s) or presence.is_without_answer(entry.since_s, now_s)
            )
            if is_given_up or presence.is_surely_gone(now_s):
                return link, []
            unclear.append(link)
        return None, unclear

    def _name(self, entry: _Entry, replaces: int | None, now_s: float) -> Named | None:
        """None: the device that has the name at another address may be this one, with a new address."""
        if entry.member is not None and entry.member.robot not in self._names.links:
            return Named(entry.member.robot, is_certain=True)
        name = None if replaces is None else self._entries[replaces].name
        if name is not None:
            return Named(name, not self._names.has_twins(entry.origin))
        holder = self._entries.get(self._names.links.get(entry.origin.own, -1))
        if holder is not None and holder.lacks_command and not entry.lacks_command:  # which only looked like this one
            return Named(entry.origin.own, is_certain=True)
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
        if entry.member is not None and not entry.is_waiting:
            self._holders[entry.member] = link
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
            if entry.member is not None and not entry.is_waiting:
                del self._holders[entry.member]
        if entry.name is not None:
            self._names.leave(entry.name)


def is_played(endpoints: Sequence[Endpoint]) -> bool:
    """Whether it is a recording that is played: it says so by a topic."""
    return any(each.type_name == _PLAYED_TYPE and not each.is_to_device for each in endpoints)
