"""How long a link outlives its device, in virtual time."""

import asyncio

import pytest

from hostlink.config import LinkConfig
from hostlink.link.link import Link, LinkEnd
from hostlink.protocol.session import Session
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.session_host import LED, ODOMETRY, TIME, check, wire
from tests.support.virtual_loop import run_virtual

ANNOUNCEMENT = TIME + wire(ODOMETRY, LED) + TIME


async def silence_until_the_end(config: LinkConfig, *, time_requests: int) -> tuple[LinkEnd, float]:
    """A device announces its topics, asks for the time so often, and vanishes without a word."""
    transport, device = memory_pair()
    link = Link(transport, Session(check=check), config, number=1, on_event=lambda _link, _event: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await device.send(ANNOUNCEMENT)
        for _ in range(time_requests):
            await asyncio.sleep(2.5)
            await device.send(TIME)
        vanished_at_s = asyncio.get_running_loop().time()
        end = await running
    return end, asyncio.get_running_loop().time() - vanished_at_s


@pytest.mark.parametrize(
    ("config", "time_requests", "silence_s"),
    [
        (LinkConfig(), 0, 11.0),
        (LinkConfig(), 1, 5.0),
        (LinkConfig(), 20, 5.0),
        (LinkConfig(silence_timeout_s=None), 3, 11.0),
        (LinkConfig(silence_timeout_s=8.0), 3, 8.0),
        (LinkConfig(silence_timeout_s=20.0), 3, 11.0),
        (LinkConfig(idle_timeout_s=None), 3, 5.0),
    ],
)
def test_a_dead_device_is_found_in_time(config: LinkConfig, time_requests: int, silence_s: float) -> None:
    end, lasted_s = run_virtual(silence_until_the_end(config, time_requests=time_requests))
    assert end is LinkEnd.IDLE
    assert lasted_s == pytest.approx(silence_s, abs=0.01)


async def serve_a_device_that_restarts(transport: MemoryTransport, device: MemoryTransport) -> int:
    """The board restarts behind a radio that keeps the connection, and is silent until it is asked for its topics."""
    session = Session(check=check)
    link = Link(transport, session, LinkConfig(), number=1, on_event=lambda _link, _event: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        for _ in range(3):
            await device.receive()  # the request for topics, alone: each start is one
            await device.send(ANNOUNCEMENT)
            for _ in range(4):
                await device.receive()  # the time
                await asyncio.sleep(2.5)
                await device.send(TIME)
            await device.receive()
        await device.aclose()
        assert await running is LinkEnd.PEER_CLOSED
    return session.counts.negotiations


def test_a_board_that_restarts_behind_its_radio_keeps_its_link() -> None:
    assert run_virtual(serve_a_device_that_restarts(*memory_pair())) == 3
