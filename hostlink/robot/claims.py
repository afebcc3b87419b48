"""Claims: who wants to drive a robot, how important he is, and until when. The gates of one robot share them."""

from collections.abc import Hashable
from typing import NamedTuple

MAX_CLAIMS = 64  # sources of commands that one robot keeps apart; each has commanded within the last lease


class Claim(NamedTuple):
    """Who drives, how important he is, and until when."""

    owner: Hashable
    priority: int
    deadline_s: float


class Claims:
    """Of one robot. An owner has one claim at each gate where he drives; it counts at all of them."""

    def __init__(self) -> None:
        self._claims: dict[tuple[Hashable, Hashable], Claim] = {}  # by gate and owner

    def put(self, gate: Hashable, claim: Claim) -> bool:
        """The owner's newest at this gate; returns whether the least important one went for it."""
        self._claims[gate, claim.owner] = claim
        if len(self._claims) <= MAX_CLAIMS:
            return False
        del self._claims[min(self._claims, key=lambda key: _strength(self._claims[key]))]
        return True

    def strongest_beside(self, owner: Hashable, now_s: float) -> Claim | None:
        """The most important claim of somebody else."""
        self._claims = {key: claim for key, claim in self._claims.items() if now_s < claim.deadline_s}
        others = (claim for claim in self._claims.values() if claim.owner != owner)
        return max(others, key=_strength, default=None)

    def has_any(self, gate: Hashable, now_s: float) -> bool:
        """Whether there is a claim that was made at this gate."""
        return any(where is gate and now_s < claim.deadline_s for (where, _), claim in self._claims.items())

    def remove(self, gate: Hashable, owner: Hashable) -> None:
        """Forget what an owner has claimed at a gate, if anything."""
        self._claims.pop((gate, owner), None)

    def clear(self, gate: Hashable) -> None:
        """Forget whatever was claimed at a gate."""
        self._claims = {key: claim for key, claim in self._claims.items() if key[0] is not gate}


def _strength(claim: Claim) -> tuple[int, float]:
    return claim.priority, claim.deadline_s
