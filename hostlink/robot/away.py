"""Away: who has left, when, and who of them is to be forgotten: after a while, or as soon as too many left later."""

import math
from collections import OrderedDict

MAX_AWAY = 64  # more robots than people name without configuring them


class Away:
    """Names in the order in which they left. Times are monotonic, in seconds."""

    def __init__(self, forget_after_s: float = math.inf) -> None:
        self._forget_after_s = forget_after_s
        self._left_at_s: OrderedDict[str, float] = OrderedDict()

    def __len__(self) -> int:
        return len(self._left_at_s)

    def put(self, name: str, now_s: float) -> None:
        """It left; if it was away already it left again."""
        self._left_at_s.pop(name, None)
        self._left_at_s[name] = now_s

    def remove(self, name: str) -> None:
        """It is back, or must not be forgotten."""
        self._left_at_s.pop(name, None)

    def pop_forgotten(self, now_s: float) -> list[str]:
        """Those whose time has come."""
        popped: list[str] = []
        while len(self._left_at_s) > MAX_AWAY or now_s >= self.next_s():
            popped.append(self._left_at_s.popitem(last=False)[0])
        return popped

    def pop_first(self) -> str | None:
        """The one that left first, if anybody has."""
        return self._left_at_s.popitem(last=False)[0] if self._left_at_s else None

    def next_s(self) -> float:
        """When the next one is forgotten; infinite: nobody is."""
        return next(iter(self._left_at_s.values()), math.inf) + self._forget_after_s
