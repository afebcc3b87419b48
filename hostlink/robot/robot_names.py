"""RobotNames: which device has which robot's name. Boards that were flashed alike announce one name."""

import itertools
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

Key = TypeVar("Key")

PLAYED = "a recording"  # the address of whatever is played, wherever that is
LONGEST_NAME = 64  # characters; a name goes into logs, paths and labels


class Origin(NamedTuple):
    """What is known of a device before it has a name: the name that it announces, and where it is."""

    own: str  # the name that it announces
    address: str
    peer: str  # the address with its port; of a serial port the path


@dataclass(frozen=True, slots=True)
class Named:
    """A name; `is_certain`: it can be nobody else's, because of the configuration or of an address of its own.

    `is_new_number`: nobody ever had it; the device is one more of those that announce the same.
    """

    name: str
    is_certain: bool = False
    is_new_number: bool = False


class Places:
    """Where robots are configured to be. Making it takes time with thousands of them."""

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
    """A name is chosen in this order:

    1. the name that it announces, where the configuration gives it to its address;
    2. the name that the same device had before: one that announced the same name from the same address, and best the
       same port; of several the one that came first;
    3. a name that the configuration gives to its address: those that nobody ever had first, in their order;
    4. the name that it announces, unless it is another's: somebody has it now, the configuration gives it to an
       address, or several were seen that announce it, and it is the one of a device elsewhere;
    5. that name with a number: robot_0_2, robot_0_3, ...

    A recording that is played leaves its name to the robot, and counts as none of those that announce it.

    A name without a device stays its last owner's until it is forgotten.
    """

    def __init__(self, addresses: Mapping[str, str | None]) -> None:
        """`addresses`: robot name -> where it is configured to be: IP address, also with a port, or serial port."""
        self._places = Places(addresses)
        self._live: set[str] = set()  # that a device has now
        self._owners: dict[str, Origin] = {}
        self._of_origin: defaultdict[tuple[str, str], dict[str, None]] = defaultdict(dict)  # in the order of coming
        self._of_own: defaultdict[str, dict[str, None]] = defaultdict(dict)

    def reconfigure(self, places: Places) -> None:
        """Whoever has another's name by these, or should have another, has none from now on."""
        misplaced = self.misplaced(places)
        self._places = places
        for name in misplaced:
            self.forget(name)

    def misplaced(self, places: Places) -> list[str]:
        """The names that would be others' by these places, or whose devices would have others."""
        right = {name for name, owner in self._owners.items() if name in places.at(owner)}
        return [
            name
            for name, owner in self._owners.items()
            if name not in right and (places.has(name) or any(here not in right for here in places.at(owner)))
        ]

    def choose(self, origin: Origin) -> Named:
        """The name of a device that has none."""
        here = self._places.at(origin)
        free = [name for name in here if name not in self._live]
        is_only_one = len(here) == 1
        if origin.own in free:
            return Named(origin.own, is_only_one)
        had = self._names_of(origin)
        before = [name for name in had if name not in self._live]
        if before:
            same = next((name for name in before if self._owners[name].peer == origin.peer), None)
            return Named(same or before[0], same is not None or len(had) == 1)
        if free:
            return Named(next((name for name in free if name not in self._owners), free[0]), is_only_one)
        if self._is_free(origin):
            return Named(origin.own)
        return Named(self._numbered(origin.own), is_new_number=True)

    def assign(self, name: str, origin: Origin) -> None:
        """The device has the name from now on."""
        self.forget(name)
        self._live.add(name)
        self._owners[name] = origin
        self._of_origin[origin.own, origin.address][name] = None
        if origin.address != PLAYED:
            self._of_own[origin.own][name] = None

    def leave(self, name: str) -> None:
        """Its device is gone; the name stays its own."""
        self._live.discard(name)

    def forget(self, name: str) -> None:
        """Anybody may have this name."""
        self._live.discard(name)
        owner = self._owners.pop(name, None)
        if owner is not None:
            _drop(self._of_origin, owner[:2], name)
            _drop(self._of_own, owner.own, name)

    def has_twins(self, origin: Origin) -> bool:
        """Whether several robots were seen there that announce this name."""
        return len(self._names_of(origin)) > 1

    def is_numbered(self, name: str, origin: Origin) -> bool:
        """Whether a device was given a number, because nothing distinguished it from another."""
        return name != origin.own and name not in self._places.at(origin)

    def _names_of(self, origin: Origin) -> list[str]:
        return list(self._of_origin.get((origin.own, origin.address), ()))

    def _is_free(self, origin: Origin) -> bool:
        name, owner = origin.own, self._owners.get(origin.own)
        if owner is not None and owner.address == PLAYED != origin.address:
            return not self._places.has(name)
        if name in self._live or self._places.has(name):
            return False
        return owner is None or (owner.own == name and len(self._of_own.get(name, ())) <= 1)

    def _numbered(self, own: str) -> str:
        numbers = (f"_{number}" for number in itertools.count(2))
        names = (own[: LONGEST_NAME - len(number)] + number for number in numbers)
        return next(name for name in names if name not in self._owners and not self._places.has(name))


def _drop(names: defaultdict[Key, dict[str, None]], key: Key, name: str) -> None:
    names[key].pop(name, None)
    if not names[key]:
        del names[key]
