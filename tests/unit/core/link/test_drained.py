"""Link.drained: waiting until every queued frame was sent, in virtual time."""

import asyncio

from hostlink.core.config import LinkConfig
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.protocol.rosserial.frame import STOP_REQUEST, TOPICS_REQUEST
from hostlink.core.protocol.rosserial.session import Session
from tests.support.memory_transport import memory_pair
from tests.support.session_host import check
from tests.support.virtual_loop import virtual

SLOW_BYTES_S = 80  # a frame of 8 bytes takes 0.1 s


@virtual
async def test_drained_waits_for_the_frames_on_a_slow_line_and_returns_at_once_afterwards() -> None:
    transport, device = memory_pair()
    session = Session(check=check, uart_bytes_s=SLOW_BYTES_S)
    link = Link(transport, session, LinkConfig(), number=1, on_event=lambda _link, _event: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await asyncio.sleep(0.001)
        began_s = asyncio.get_running_loop().time()
        session.stop()
        link.wake()
        both = [tasks.create_task(link.drained()) for _ in range(2)]
        await asyncio.wait(both)
        waited_s = asyncio.get_running_loop().time() - began_s
        assert await device.receive() == TOPICS_REQUEST + STOP_REQUEST
        assert 0.05 < waited_s < 0.2
        async with asyncio.timeout(0.01):
            await link.drained()
        running.cancel()


@virtual
async def test_drained_returns_when_the_link_ends() -> None:
    transport, _ = memory_pair(room_bytes=0)  # the device reads nothing
    session = Session(check=check)
    link = Link(transport, session, LinkConfig(), number=1, on_event=lambda _link, _event: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        waiting = tasks.create_task(link.drained())
        await asyncio.sleep(0.1)
        assert not waiting.done()
        link.end(LinkEnd.EVICTED)
        async with asyncio.timeout(0.1):
            await waiting
            await link.drained()
        await running
