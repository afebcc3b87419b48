"""Topics as a test needs them of a client: the next message, one that is as expected, a command until it has worked."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from hostlink import client
from hostlink.client import Refused
from hostlink.core.robot.admission import LEASE_S
from tests.support.waiting import TIMEOUT_S


async def received(
    host: client.Host, topic: str, type_name: str, is_so: Callable[[dict[str, Any]], object] = lambda _: True
) -> dict[str, Any]:
    """The next message that is so.

    Raises:
        TimeoutError: none was, for 15 s.
    """
    async with asyncio.timeout(TIMEOUT_S), host.subscribe(topic, type_name=type_name) as messages:
        async for message in messages:
            if is_so(message):
                return dict(message)
    raise AssertionError("the subscription has ended")


async def publish_until(
    host: client.Host, topic: str, message: dict[str, Any], type_name: str, done: Awaitable[object]
) -> None:
    """Publish ten times a second until the awaitable is done; after a refusal, let go for as long as a lease.

    Raises:
        TimeoutError: it was not, for 15 s.
    """

    async def repeat() -> None:
        while True:
            try:
                await host.publish(topic, message, type_name=type_name)
            except Refused:  # the device has just subscribed, and this stream was there before
                await asyncio.sleep(LEASE_S)
            await asyncio.sleep(0.1)

    async with asyncio.timeout(TIMEOUT_S), asyncio.TaskGroup() as tasks:
        repeating = tasks.create_task(repeat())
        await done
        repeating.cancel()
