"""A daemon that is killed at any moment: robots without a watchdog stand within 0.2 s.

Twelve kills here; `make soak` sets HOSTLINK_KILLS to 1000.
"""

import asyncio
import os
import random
import signal

import pytest

from tests.support.killing import LIMIT_S, driving, end_at, killer
from tests.support.unwatched_robot import Reading

KILLS = int(os.environ.get("HOSTLINK_KILLS", "12"))
AT_ONCE = 3
SHORTEST_S, LONGEST_S = 0.0, 0.3
READINGS = (
    Reading(),
    Reading(bytes_a_turn=2048, with_blobs=True),  # about 1 MB/s of frames of 32 KiB: killed in the middle of one
    Reading(bytes_a_turn=2048, with_blobs=True, gives_up=False),
)


async def kill_one(chance: random.Random) -> float:
    reading, after_s = chance.choice(READINGS), chance.uniform(SHORTEST_S, LONGEST_S)
    async with driving(reading) as drive:
        return await end_at(drive, after_s, killer(signal.SIGKILL))


@pytest.mark.alone
@pytest.mark.timeout(60 + 3 * KILLS)
async def test_a_daemon_killed_at_a_random_moment_leaves_no_robot_moving() -> None:
    seed = int(os.environ.get("HOSTLINK_SEED", random.randrange(2**32)))
    print(f"seed {seed}")  # noqa: T201
    chances = [random.Random(seed + number) for number in range(KILLS)]
    lasted_s: list[float] = []

    async def kill_in_turn() -> None:
        while chances:
            lasted_s.append(await kill_one(chances.pop()))

    async with asyncio.TaskGroup() as tasks:
        for _ in range(AT_ONCE):
            tasks.create_task(kill_in_turn())
    lasted_s.sort()
    print(f"stood after: median {lasted_s[KILLS // 2]:.4f} s, longest {lasted_s[-1]:.4f} s")  # noqa: T201
    assert len(lasted_s) == KILLS
    assert lasted_s[-1] <= LIMIT_S
