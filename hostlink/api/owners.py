"""Owners: who drives and publishes over REST. It is no connection, for one may carry a single request."""

from collections import OrderedDict
from collections.abc import Iterable

from hostlink.hub.hub import Hub
from hostlink.hub.node import Role
from hostlink.hub.participant import Participant

MAX_OWNERS = 64  # as many as one robot keeps apart; each that drives sends a request in every lease


class Owners:
    """All requests with one token, or from one computer, are one participant; its lease ends by itself.

    Over MAX_OWNERS the one leaves that sent nothing for the longest time, and what it drives stops.
    """

    def __init__(self, hub: Hub) -> None:
        self.evicted = 0
        self._hub = hub
        self._owners: OrderedDict[str, Participant] = OrderedDict()

    def __len__(self) -> int:
        return len(self._owners)

    @property
    def names(self) -> list[str]:
        """Of tokens; of addresses, while there are no tokens."""
        return list(self._owners)

    def end(self, names: Iterable[str]) -> None:
        """Their tokens are withdrawn: what they drive stops."""
        for name in names:
            if name in self._owners:
                self._owners.pop(name).leave()

    def of(self, name: str, role: Role) -> Participant:
        """The participant of this name, a new one if there is none."""
        owner = self._owners.pop(name, None)
        if owner is None or owner.has_left:
            owner = self._hub.join(f"rest {name}", role=role)
        self._owners[name] = owner
        if len(self._owners) > MAX_OWNERS:
            self._owners.popitem(last=False)[1].leave()
            self.evicted += 1
        return owner
