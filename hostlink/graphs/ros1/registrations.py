"""Registrations: what the master is to know of this node, and what it knows. Pure."""

from enum import StrEnum
from typing import NamedTuple


class Kind(StrEnum):
    """What can be registered; the value is the master's word for it."""

    PUBLISHER = "Publisher"
    SUBSCRIBER = "Subscriber"
    SERVICE = "Service"

    __hash__ = str.__hash__  # an Enum's own is in Python: a tenth of a second for a thousand robots


class Registration(NamedTuple):
    """One name, as ROS has it."""

    kind: Kind
    name: str
    type_name: str  # of a topic; of a service it is known to who provides it


class Registrations:
    """What differs is what is to be done; a master that has forgotten receives all again."""

    def __init__(self) -> None:
        self.wanted: dict[Registration, None] = {}
        self.known: dict[Registration, None] = {}

    def missing(self) -> list[Registration]:
        """To be registered: services before topics, so that a node that is there answers."""
        found = [each for each in self.wanted if each not in self.known]
        return sorted(found, key=lambda each: each.kind is not Kind.SERVICE)

    def surplus(self) -> list[Registration]:
        """To be unregistered. What only changes its type is registered again, which is enough."""
        wanted = {(each.kind, each.name) for each in self.wanted}
        return [each for each in self.known if (each.kind, each.name) not in wanted]

    def note(self, registration: Registration) -> None:
        """The master knows it."""
        for other in [each for each in self.known if each[:2] == registration[:2]]:
            del self.known[other]
        self.known[registration] = None

    def forget(self, registration: Registration) -> None:
        """The master knows it no more."""
        self.known.pop(registration, None)

    def keep(self, names: dict[Kind, set[str]]) -> int:
        """The master knows these names alone of this node; returns how many it has forgotten."""
        forgotten = [each for each in self.known if each.name not in names[each.kind]]
        for each in forgotten:
            del self.known[each]
        return len(forgotten)

    def forget_all(self) -> None:
        """Another master is there, or the same one began anew."""
        self.known.clear()
