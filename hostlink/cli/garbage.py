"""When the garbage collector goes through everything, which stops the loop: while no robot moves.

Each connection leaves a cycle behind (asyncio's transport, aiohttp's request and WebSocket), and it lived long enough
to be in the oldest generation. With the thresholds of `serve` that one is collected after some 5000 connections.
"""

import asyncio
import gc

from hostlink.hub.robots import Robots

CHECK_INTERVAL_S = 1.0
LONGEST_INTERVAL_S = 8.0  # 200 connections a second leave some 10 MiB behind in it
ENOUGH = 20  # collections of the generation before it: about a hundred connections since the last time
WORTH = 1000  # objects: a dozen connections


async def collect_while_idle(robots: Robots) -> None:
    """Check regularly whether it is worth it, until cancelled; less often while it is not.

    A crowd of robots makes enough objects for a collection each second, and leaves no cycles behind.
    """
    interval_s = CHECK_INTERVAL_S
    while True:
        await asyncio.sleep(interval_s)
        if gc.get_count()[2] >= ENOUGH and not any(robot.gate.may_move for robot in robots.here()):
            is_worth_it = gc.collect() >= WORTH
            interval_s = CHECK_INTERVAL_S if is_worth_it else min(2 * interval_s, LONGEST_INTERVAL_S)
