"""Silence detection of a link, in virtual time."""

import asyncio

import pytest

from hostlink.core.config import LinkConfig
from hostlink.core.hub.stall_watch import BEAT_S, StallWatch
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.protocol.events import Event
from hostlink.core.protocol.rosserial.session import Session
from tests.support.memory_transport import MemoryTransport, memory_pair
from tests.support.session_host import LED, ODOMETRY, TIME, check, wire
from tests.support.virtual_loop import VirtualLoop, run_virtual, virtual

ANNOUNCEMENT = TIME + wire(ODOMETRY, LED) + TIME


async def live(device: MemoryTransport, *, time_requests: int) -> None:
    """Announce topics, and request the time every 2.5 s."""
    await device.send(ANNOUNCEMENT)
    for _ in range(time_requests):
        await asyncio.sleep(2.5)
        await device.send(TIME)


async def silence_until_the_end(config: LinkConfig, *, time_requests: int) -> tuple[LinkEnd, float]:
    """Announce topics, request the time at that period, then fall silent. Return how long the link lasts."""
    transport, device = memory_pair()
    link = Link(transport, Session(check=check), config, number=1, on_event=lambda _link, _event: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await live(device, time_requests=time_requests)
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
def test_dead_device_is_found_in_time(config: LinkConfig, time_requests: int, silence_s: float) -> None:
    end, lasted_s = run_virtual(silence_until_the_end(config, time_requests=time_requests))
    assert end is LinkEnd.IDLE
    assert lasted_s == pytest.approx(silence_s, abs=0.01)


async def serve_a_device_that_restarts(transport: MemoryTransport, device: MemoryTransport) -> int:
    """Restart behind a radio that keeps the connection, and stay silent until the topics are requested."""
    session = Session(check=check)
    link = Link(transport, session, LinkConfig(), number=1, on_event=lambda _link, _event: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        for _ in range(3):
            await device.receive()  # the topic request alone: each start sends one
            await device.send(ANNOUNCEMENT)
            for _ in range(4):
                await device.receive()  # the time request
                await asyncio.sleep(2.5)
                await device.send(TIME)
            await device.receive()
        await device.aclose()
        assert await running is LinkEnd.PEER_CLOSED
    return session.counts.negotiations


def test_board_that_restarts_behind_its_radio_keeps_its_link() -> None:
    assert run_virtual(serve_a_device_that_restarts(*memory_pair())) == 3


async def pause_while(config: LinkConfig, *, sent: bytes, lasts_s: float, rest: bytes = b"") -> tuple[LinkEnd, Session]:
    """Stop the host while the device sends, and send `rest` a second later. The device ends the link."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    watch = StallWatch(lambda: 0.0)
    transport, device = memory_pair()
    session = Session(check=check)
    link = Link(transport, session, config, number=1, on_event=lambda _link, _event: None, pauses=watch.pauses)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await live(device, time_requests=2)
        await asyncio.sleep(0.5)
        watch.beat(loop.time())
        loop.burn(lasts_s)
        loop.call_soon(lambda: loop.call_soon(device.write, sent))  # timers run before sockets are polled
        await asyncio.sleep(1.0)
        await device.send(rest)
        await asyncio.sleep(0.5)
        await device.aclose()
        end = await running
    return end, session


@pytest.mark.parametrize("lasts_s", [4.0, 9.0, 60.0])
def test_silence_of_a_device_while_the_host_was_paused_does_not_end_its_link(lasts_s: float) -> None:
    end, session = run_virtual(pause_while(LinkConfig(), sent=TIME, lasts_s=lasts_s))
    assert end is LinkEnd.PEER_CLOSED
    assert session.counts.topic_requests == 1  # waiting bytes were read before the silence was judged


def test_half_a_frame_is_not_given_up_while_the_host_is_paused() -> None:
    end, session = run_virtual(pause_while(LinkConfig(), sent=TIME[:9], lasts_s=9.0, rest=TIME[9:]))
    assert end is LinkEnd.PEER_CLOSED
    assert session.counts.skipped_bytes == 0


@virtual
async def test_silence_of_a_dead_device_ends_its_link_after_the_pause() -> None:
    """The time before the pause counts: half a second."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    watch = StallWatch(lambda: 0.0)
    transport, device = memory_pair()
    link = Link(transport, Session(check=check), LinkConfig(), number=1, on_event=_ignore, pauses=watch.pauses)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await live(device, time_requests=2)
        await asyncio.sleep(0.5)
        watch.beat(loop.time())
        loop.burn(20.0)
        resumed_s = loop.time()
        beating = tasks.create_task(_beat(watch))
        end = await running
        beating.cancel()
    lasted_s = loop.time() - resumed_s
    assert end is LinkEnd.IDLE
    assert lasted_s == pytest.approx(4.5, abs=0.2)


async def _beat(watch: StallWatch) -> None:
    while True:
        watch.beat(asyncio.get_running_loop().time())
        await asyncio.sleep(BEAT_S)


def _ignore(_link: Link, _event: Event) -> None:
    """Ignore an event."""


class SlowTransport(MemoryTransport):
    """Transport whose peer accepts written data only after a delay."""

    drained_after_s = 3.0

    async def drain(self) -> None:
        await asyncio.sleep(self.drained_after_s)
        await super().drain()


def test_device_that_is_behind_is_not_given_up_for_a_pause_of_the_host() -> None:
    async def run() -> LinkEnd:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, VirtualLoop)
        watch = StallWatch(lambda: 0.0)
        end, device = memory_pair(room_bytes=0)
        transport = SlowTransport(end._from_peer, end._to_peer, address="slow")
        link = Link(transport, Session(check=check), LinkConfig(), number=1, on_event=_ignore, pauses=watch.pauses)
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(link.run())
            await asyncio.sleep(0.5)  # the topic request waits for the device
            watch.beat(loop.time())
            loop.burn(20.0)
            await device.receive()
            await asyncio.sleep(SlowTransport.drained_after_s + 0.5)
            await device.aclose()
            return await running

    assert run_virtual(run()) is LinkEnd.PEER_CLOSED
