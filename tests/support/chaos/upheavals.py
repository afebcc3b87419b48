"""Disturbances of the daemon itself: its process is stopped or restarted, its settings are reloaded, its wall clock
jumps. The generator draws when; DaemonKeeper, which has the process, does it."""

import asyncio
import random
from typing import Any

from tests.support.chaos.plan import Action
from tests.support.chaos.stage import Stage

SETTINGS = ("blocking", "blocking", "large", "wrong", "half", "gone", "same")
DAY_S = 86400
JUMPS_S = (-3600, 100 * DAY_S, -100 * DAY_S, 5, -5, 0, 3650 * DAY_S)
SIGNALS = ("TERM", "KILL", "KILL")
_Request = dict[str, Any]


async def reload(stage: Stage, action: Action) -> None:
    """Reloads of a file that blocks (a FIFO), is large, wrong, cut, gone or as before, by REST or by the signal."""

    def draw(dice: random.Random) -> _Request:
        return {"daemon": "reload", "settings": dice.choice(SETTINGS), "by_signal": dice.random() < 0.5}

    await _repeat(stage, action, "the settings are read anew", draw, (0.2, 1.5))


async def pause(stage: Stage, action: Action) -> None:
    """SIGSTOP, for less or more than the daemon's guardian waits."""

    def draw(dice: random.Random) -> _Request:
        return {"daemon": "pause", "seconds": dice.choice((0.1, 0.3, 0.6, 1.0, 2.0, 3.0))}

    await _repeat(stage, action, "the daemon is stopped for moments", draw, (0.5, 2.0))


async def restart(stage: Stage, action: Action) -> None:
    """One restart: by SIGTERM, or killed."""
    number = action.dice().choice(SIGNALS)
    stage.report({"action": action.number, "what": f"the daemon is restarted, SIG{number}"})
    stage.report({"daemon": "restart", "signal": number})


async def clock(stage: Stage, action: Action) -> None:
    """The wall clock is set, back and forth."""

    def draw(dice: random.Random) -> _Request:
        return {"daemon": "clock", "jump_s": dice.choice(JUMPS_S)}

    await _repeat(stage, action, "the wall clock jumps", draw, (0.1, 1.0))


async def _repeat(stage: Stage, action: Action, what: str, draw: Any, pause_s: tuple[float, float]) -> None:
    dice = action.dice()
    stage.report({"action": action.number, "what": what})
    while True:
        stage.report(draw(dice))
        await asyncio.sleep(dice.uniform(*pause_s))
