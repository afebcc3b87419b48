"""Velocities over REST from a test that the machine may starve: the daemon refuses one that is late, by design."""

import asyncio
import json

import aiohttp

from hostlink.errors import RefusalKind
from hostlink.robot.admission import LEASE_S

REFUSED = 409


async def put_velocity(session: aiohttp.ClientSession, robot_url: str, body: bytes) -> None:
    """Send a velocity until the daemon obeys it. After a late one, a pause of a lease arms the source again.

    Raises:
        AssertionError: the daemon refused it for another reason.
    """
    was_late = False
    while True:
        async with session.put(f"{robot_url}/velocity", data=body) as response:
            answer, status = await response.read(), response.status
        if status != REFUSED:
            assert status == 200, answer
            return
        kind = json.loads(answer)["error"]["kind"]
        was_late = was_late or kind == RefusalKind.LATE
        assert was_late, answer
        assert kind in (RefusalKind.LATE, RefusalKind.DISARMED), answer
        if kind == RefusalKind.DISARMED:
            await asyncio.sleep(LEASE_S)
