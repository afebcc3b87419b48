"""End of a link, in virtual time."""

import asyncio

from hostlink.core.config import LinkConfig
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LAST_FRAME_TIMEOUT_S, LinkEnd
from hostlink.core.protocol.rosserial.session import Session
from tests.support.memory_transport import memory_pair
from tests.support.session_host import check
from tests.support.virtual_loop import virtual


@virtual
async def test_cancelled_link_closes_the_connection_while_its_last_frame_waits() -> None:
    transport, device = memory_pair(room_bytes=0)  # the device reads nothing
    link = Link(transport, Session(check=check), LinkConfig(), number=1, on_event=lambda _link, _event: None)
    link.last_frames = (bytes(56),)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await asyncio.sleep(1.0)
        link.end(LinkEnd.EVICTED)
        await asyncio.sleep(LAST_FRAME_TIMEOUT_S / 2)
        running.cancel()
    assert running.cancelled()
    assert device.is_ended


@virtual
async def test_device_that_closes_while_the_writer_waits_for_it_ends_the_link_as_closed_by_the_peer() -> None:
    """The writer's error counted as a cancellation of the link's task."""
    transport, device = memory_pair()
    link = Link(transport, Session(check=check), LinkConfig(), number=1, on_event=lambda _link, _event: None)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await asyncio.sleep(1.0)
        await device.aclose()
        link.session.outbox.put_urgent(100, bytes(56))
        link.write_now(asyncio.get_running_loop().time())
    assert running.result() is LinkEnd.PEER_CLOSED
