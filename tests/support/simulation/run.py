"""Runs of the simulated world: one seed, or many."""

import asyncio
from dataclasses import dataclass

from tests.support.simulation.clock import WorldLoop
from tests.support.simulation.journal import Failed
from tests.support.simulation.oracle import judge
from tests.support.simulation.world import World

TURNS_S = (0.0, 0.0, 0.0, 0.0005, 0.002)  # what a turn of the daemon's loop costs


@dataclass(frozen=True)
class Run:
    """Result of a run."""

    seed: int
    seconds: float
    log: str
    broken: list[str]  # promises

    def __str__(self) -> str:
        again = f"python -m tests.support.simulation {self.seed} --seconds {self.seconds:g}"
        return "\n".join([f"seed {self.seed}: {again}", *self.broken])


def play(seed: int, seconds: float = 60.0) -> Run:
    """Play so many seconds, and the end of all. The same seed and seconds give the same log."""
    made: list[World] = []
    turn_s = TURNS_S[seed % len(TURNS_S)]

    async def live() -> None:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, WorldLoop)
        made.append(World(loop, seed, seconds))
        await made[0].live()

    crash: Exception | None = None
    try:
        with asyncio.Runner(loop_factory=lambda: WorldLoop(turn_s)) as runner:
            runner.run(live())
    except Exception as error:  # noqa: BLE001 - a crash of the daemon is a broken promise of this seed
        crash = error
    journal = made[0].journal
    broken = judge(journal.records, turn_s=turn_s)
    if crash is not None:
        broken.insert(0, f"the run has crashed: {_first(crash)!r}")
    broken += [f"{each.at_s:.3f} {each.promise}" for each in journal.records if isinstance(each, Failed)]
    return Run(seed, seconds, journal.text, broken)


def _first(error: BaseException) -> BaseException:
    return _first(error.exceptions[0]) if isinstance(error, BaseExceptionGroup) else error
