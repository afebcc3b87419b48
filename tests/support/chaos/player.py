"""The generator as a process of its own: plays the step that it is asked for, and reports what it does.

    python -m tests.support.chaos.player SEED STAGE [KIND...]

STAGE: JSON, the daemon's addresses as Stage has them.

Reads a JSON object a line ({"step": 3}, {"leave": true}) and writes one a line; ends with its standard input.
"""

import asyncio
import json
import os
import random
import resource
import sys
import time
from collections.abc import Awaitable, Callable
from typing import Any

from tests.support.chaos import boards, calls, devices, loads, programs, tls_strangers, upheavals
from tests.support.chaos.devices import quietly
from tests.support.chaos.plan import Action, Step, draw_step
from tests.support.chaos.stage import Stage

NICE = 5  # the daemon and the honest robot go first: they are what is measured
CALL = "call"  # a device that calls waits for its answer, as it would for ever
CALL_S = calls.PATIENCE_S + 5.0
PLAY: dict[str, Callable[[Stage, Action], Awaitable[None]]] = {
    "flood": devices.flood,
    "announce": devices.announce,
    "trickle": devices.trickle,
    "churn": devices.churn,
    "silent": devices.silent,
    "copy": devices.copy,
    "board_rogues": boards.board_rogues,
    "board_churn": boards.board_churn,
    "board_flood": boards.board_flood,
    "board_trickle": boards.board_trickle,
    "call": calls.call,
    "bridge": programs.bridge,
    "subscriber": programs.subscriber,
    "publisher": programs.publisher,
    "rival": programs.rival,
    "rest": programs.rest,
    "idle": programs.idle,
    "broken_websocket": programs.broken_websocket,
    "bodies": loads.bodies,
    "latch": loads.latch,
    "history": loads.history,
    "tls": tls_strangers.strangers,
    "reload": upheavals.reload,
    "pause": upheavals.pause,
    "restart": upheavals.restart,
    "clock": upheavals.clock,
}


def report(facts: dict[str, Any]) -> None:
    """One line for who started this process."""
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


async def play(stage: Stage, action: Action) -> None:
    """One action, to the end of its time; a call of a service has a longer time of its own."""
    report({"began": action.number, "kind": action.kind, "at_s": time.monotonic(), "may_drive": action.may_drive})
    try:
        async with asyncio.timeout(CALL_S if action.kind == CALL else action.seconds):
            await quietly(PLAY[action.kind], stage, action)
    except TimeoutError:
        pass
    finally:
        report({"ended": action.number, "at_s": time.monotonic()})


class Player:
    """Plays the steps of one seed."""

    def __init__(self, seed: int, stage: Stage, only: tuple[str, ...]) -> None:
        self._seed, self._stage, self._only = seed, stage, only
        self._playing: list[asyncio.Task[None]] = []

    async def serve(self) -> None:
        """Until the standard input ends."""
        reader = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
        async with asyncio.TaskGroup() as tasks:
            report({"ready": True})
            while line := await reader.readline():
                request = json.loads(line)
                if "step" in request:
                    await self._play_step(draw_step(self._seed, request["step"], self._only), tasks)
                else:
                    self._leave()
                    report({"left": True})
            os._exit(0)  # what still waits for an answer has waited long enough

    async def _play_step(self, step: Step, tasks: asyncio.TaskGroup) -> None:
        """Begin all actions of a step, and wait for its length."""
        self._playing = [task for task in self._playing if not task.done()]
        for action in step.actions:
            task = tasks.create_task(play(self._stage, action))
            if action.kind != CALL:
                self._playing.append(task)
        await asyncio.sleep(step.seconds)
        if step.is_last_of_phase:
            self._leave()
        report({"done": step.number})

    def _leave(self) -> None:
        """Everybody but who waits for an answer."""
        for task in self._playing:
            task.cancel()
        self._playing.clear()
        self._stage.room.clear(random.Random(self._seed))


def main() -> None:
    seed, stage, *only = sys.argv[1:]
    os.nice(NICE)
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    addresses: dict[str, Any] = {name: tuple(value) for name, value in json.loads(stage).items()}
    asyncio.run(Player(int(seed), Stage(report=report, **addresses), tuple(only)).serve())


if __name__ == "__main__":
    main()
