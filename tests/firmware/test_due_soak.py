"""The chain on QEMU for a while, in squares with stops and reversals at 38400 baud: nothing lost in either direction,
odometry true to 0.2 %.

Twelve seconds here, with a reversal; `make soak` sets HOSTLINK_SOAK_S to ten minutes.
"""

import asyncio
import json
import math
import os

import aiohttp
import pytest

from tests.firmware.boards import Board, chain
from tests.support.driving import put_velocity
from tests.support.process import Process

pytestmark = pytest.mark.usefixtures("esp8266_built")

SOAK_S = float(os.environ.get("HOSTLINK_SOAK_S", "12"))
# Pieces of each corner: seconds, m/s, rad/s. A stop, a turn on the spot, reversing without a stop, and a curve.
CORNER = (
    (5.0, 0.25, 0.0), (0.4, 0.0, 0.0), (2.6, 0.0, 0.8), (0.4, 0.0, 0.0),
    (3.0, 0.25, 0.0), (2.0, -0.2, 0.0), (2.0, 0.1, 0.6),
)  # fmt: skip
CORNER_S = sum(seconds for seconds, *_ in CORNER)
COMMAND_INTERVAL_S = 0.1
ROUNDING_M = 0.0015  # the board reports the true pose in whole millimetres
ODOMETRY, PLOT, VELOCITY = "/robot_0/odometry", "/robot_0/plot_data", "/robot_0/velocity_commands"
BATTERY, ERRORS = "/robot_0/battery", "/robot_0/errors"
FROM_DEVICE = (ODOMETRY, PLOT, BATTERY, ERRORS)


async def messages(session: aiohttp.ClientSession, daemon: Process) -> dict[str, int]:
    async with session.get(f"{daemon.url}/api/topics") as response:
        return {topic["name"]: topic["messages"] for topic in (await response.json())["topics"]}


def velocity(driven_s: float) -> dict[str, float]:
    """Command at this time of the drive."""
    left_s = driven_s % CORNER_S
    for seconds, linear, angular in CORNER:
        if left_s < seconds:
            return {"linear": linear, "angular": angular}
        left_s -= seconds
    return {"linear": 0.0, "angular": 0.0}


async def drive_squares(session: aiohttp.ClientSession, daemon: Process) -> None:
    """Send a command every tenth of a second."""
    url = f"{daemon.url}/api/robots/robot_0"
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    while (driven_s := loop.time() - began_s) < SOAK_S:
        await put_velocity(session, url, json.dumps(velocity(driven_s)).encode())
        await asyncio.sleep(COMMAND_INTERVAL_S)


async def settled(made: Board) -> dict[str, float]:
    """Report of the board after it has stopped and reported that twice."""
    await asyncio.sleep(2.0)
    await made.expect_speed(-0.5, 0.5, within_s=5.0)
    await asyncio.sleep(1.2)
    return made.facts


@pytest.mark.long
@pytest.mark.timeout(SOAK_S + 300)  # the first test builds the firmware
async def test_squares_without_a_lost_message_and_with_true_odometry() -> None:
    async with chain("cortex-m3", with_esp=True) as (daemon, made), aiohttp.ClientSession() as session:
        await daemon.read_log("robot.appeared")
        await asyncio.sleep(1.5)
        before, observed_before = made.facts, await messages(session, daemon)
        async with session.get(f"{daemon.url}/api/links") as response:
            requests = (await response.json())["links"][0]["topic_requests"]  # two if the emulator starts slowly
        await drive_squares(session, daemon)
        after = await settled(made)
        observed = await messages(session, daemon)
        async with session.get(f"{daemon.url}/api/links") as response:
            link = (await response.json())["links"][0]
        async with session.get(f"{daemon.url}/api/robots/robot_0/odometry") as response:
            pose = (await response.json())["pose"]

    # To the device: every velocity reached its callback, except those that a newer one replaced before they were sent.
    sent = observed[VELOCITY] - link["replaced"]
    assert (after["got"], after["lost"], after["dropped"]) == (sent, 0, 0)
    assert sent >= 0.8 * SOAK_S / COMMAND_INTERVAL_S
    # From the device: every queued message arrived; report and count are half a second apart.
    assert abs(sum(observed[topic] for topic in FROM_DEVICE) - after["sent"]) <= 2 * 12
    assert all(observed[topic] - observed_before[topic] >= 9.0 * SOAK_S for topic in (ODOMETRY, PLOT))
    assert all(observed[topic] - observed_before[topic] >= 0.9 * SOAK_S for topic in (BATTERY, ERRORS))
    assert (link["skipped_bytes"], link["unknown_ids"], link["topic_requests"]) == (0, 0, requests)

    rolled_m = (after["rolled_mm"] - before["rolled_mm"]) / 1000
    wrong_m = math.hypot(pose["x_m"] - after["x_mm"] / 1000, pose["y_m"] - after["y_mm"] / 1000)
    assert rolled_m > 0.08 * SOAK_S  # a reversal does not roll on
    assert wrong_m <= 0.002 * rolled_m + ROUNDING_M
