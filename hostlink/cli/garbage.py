"""When the garbage collector goes through everything, which stops the loop: while no robot moves.

Each connection leaves a cycle behind (asyncio's transport, aiohttp's request and WebSocket), and it lived long enough
to be in the oldest generation. With the thresholds of `serve` that one is collected after some 5000 connections.
"""

import asyncio
import gc

from hostlink.hub.robots import Robots

CHECK_INTERVAL_S = 1.0
ENOUGH = 20  # collections of the generation before it: about a hundred connections since the last time


async def collect_while_idle(robots: Robots) -> None:
    """Check at an interval whether a collection pays, until cancelled."""
    while True:
        await asyncio.sleep(CHECK_INTERVAL_S)
        if gc.get_count()[2] >= ENOUGH and not any(robot.gate.may_move for robot in robots.all()):
            gc.collect()
