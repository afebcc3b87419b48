"""The generator as a process of its own: plays the step that it is asked for, and reports what it does.

    python -m tests.support.chaos.player SEED TCP_PORT API_PORT [KIND...]

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

from tests.support.chaos import calls, devices, programs
from tests.support.chaos.devices import quietly
from tests.support.chaos.plan import Action, Step, draw_step
from tests.support.chaos.stage import Stage

NICE = 5  # the daemon and the honest robot go first: they are what is measured
CALL_S = calls.PATIENCE_S + 5.0
PLAY: dict[str, Callable[[Stage, Action], Awaitable[None]]] = {
    "flood": devices.flood,
    "announce": devices.announce,
    "trickle": devices.trickle,
    "churn": devices.churn,
    "silent": devices.silent,
    "copy": devices.copy,
    "call": calls.call,
    "bridge": programs.bridge,
    "subscriber": programs.subscriber,
    "publisher": programs.publisher,
    "rival": programs.rival,
    "rest": programs.rest,
    "idle": programs.idle,
    "broken_websocket": programs.broken_websocket,
}


def report(facts: dict[str, Any]) -> None:
    """One line for who started this process."""
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


async def play(stage: Stage, action: Action) -> None:
    """One action, to the end of its time; a call of a service has a longer time of its own."""
    report({"began": action.number, "kind": action.kind, "at_s": time.monotonic(), "may_drive": action.may_drive})
    try:
        async with asyncio.timeout(CALL_S if action.kind == "call" else action.seconds):
            await quietly(PLAY[action.kind], stage, action)
    except TimeoutError:
        pass
    finally:
        report({"ended": action.number, "at_s": time.monotonic()})


async def play_step(stage: Stage, step: Step, tasks: asyncio.TaskGroup) -> None:
    """Begin all actions of a step, and wait for its length."""
    for action in step.actions:
        tasks.create_task(play(stage, action))
    await asyncio.sleep(step.seconds)
    if step.is_last_of_phase:
        stage.room.clear(random.Random(f"{step.number} leave"))
    report({"done": step.number})


async def serve(seed: int, stage: Stage, only: tuple[str, ...]) -> None:
    """Until the standard input ends."""
    reader = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    async with asyncio.TaskGroup() as tasks:
        report({"ready": True})
        while line := await reader.readline():
            request = json.loads(line)
            if "step" in request:
                await play_step(stage, draw_step(seed, request["step"], only), tasks)
            else:
                stage.room.clear(random.Random(seed))
                report({"left": True})
        os._exit(0)  # what still waits for an answer has waited long enough


def main() -> None:
    seed, tcp_port, api_port, *only = sys.argv[1:]
    os.nice(NICE)
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    stage = Stage(("127.0.0.1", int(tcp_port)), ("127.0.0.1", int(api_port)), report)
    asyncio.run(serve(int(seed), stage, tuple(only)))


if __name__ == "__main__":
    main()
