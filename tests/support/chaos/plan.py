"""Plan: what is played in each step, drawn from a seed. Pure: the same seed gives the same steps.

Each phase of some steps draws which kinds of action occur and how often (as in swarm testing): a mix of everything
hides what a mix of three finds. Each step draws from its own dice, so that one step can be played alone.
"""

import random
from dataclasses import dataclass

PHASE_STEPS = 4
SHORTEST_S, LONGEST_S = 1.0, 2.0
MOST_ACTIONS = 5  # that begin at once
LONG_SHARE = 0.25

# Kind -> whether it may drive a robot without a driver of a higher priority: by a velocity topic, or REST.
KINDS: dict[str, bool] = {
    "flood": True,
    "announce": True,
    "trickle": True,
    "churn": False,
    "silent": False,
    "copy": False,
    "board_rogues": True,
    "board_churn": False,
    "board_flood": True,
    "board_trickle": True,
    "call": False,
    "bridge": True,
    "subscriber": False,
    "publisher": True,
    "rival": True,
    "rest": True,
    "idle": False,
    "broken_websocket": False,
    "bodies": False,
    "latch": False,
    "history": False,
    "tls": False,
    "reload": False,
    "pause": False,
    "restart": False,
    "clock": False,
}
DOUBLE = ("flood", "announce", "call", "board_flood")  # kinds with more ways of their own than others


@dataclass(frozen=True)
class Action:
    """One action of a hostile peer; everything else about it is drawn from its seed."""

    number: int  # in its run
    kind: str
    seed: str
    seconds: float

    @property
    def may_drive(self) -> bool:
        return KINDS[self.kind]

    def dice(self) -> random.Random:
        return random.Random(self.seed)

    def dice_of(self, number: int) -> random.Random:
        """Return the dice of one of its peers."""
        return random.Random(f"{self.seed} {number}")


@dataclass(frozen=True)
class Step:
    """Actions that begin together; `is_last_of_phase`: after it everybody leaves, at once."""

    number: int
    seconds: float
    actions: tuple[Action, ...]
    is_last_of_phase: bool


def draw_mix(seed: int, phase: int, only: tuple[str, ...] = ()) -> dict[str, int]:
    """The kinds of a phase, and how often each is drawn."""
    dice = random.Random(f"{seed} phase {phase}")
    kinds = only or tuple(KINDS)
    chosen = dice.sample([*kinds, *(kind for kind in kinds if kind in DOUBLE)], min(len(kinds), dice.randint(2, 5)))
    return {kind: dice.randint(1, 4) for kind in chosen}


def draw_step(seed: int, number: int, only: tuple[str, ...] = ()) -> Step:
    """The step of this number, counted from 0."""
    mix = draw_mix(seed, number // PHASE_STEPS, only)
    dice = random.Random(f"{seed} step {number}")
    seconds = dice.uniform(SHORTEST_S, LONGEST_S)
    kinds = dice.choices(list(mix), list(mix.values()), k=dice.randint(2, MOST_ACTIONS))
    actions = []
    for index, kind in enumerate(kinds):
        own_seed = f"{seed} step {number} action {index}"
        actions.append(Action(number * MOST_ACTIONS + index, kind, own_seed, _draw_seconds(dice, seconds)))
    return Step(number, seconds, tuple(actions), number % PHASE_STEPS == PHASE_STEPS - 1)


def _draw_seconds(dice: random.Random, step_s: float) -> float:
    """Within its step, or for the rest of the phase: what adds up needs time."""
    return PHASE_STEPS * LONGEST_S if dice.random() < LONG_SHARE else dice.uniform(0.5, step_s)
