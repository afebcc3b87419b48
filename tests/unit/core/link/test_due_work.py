"""Writes of a link: when it sends what its session has queued, in virtual time."""

import asyncio
from collections.abc import Callable

from hostlink.core.config import LinkConfig
from hostlink.core.link.link import Link
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.events import Event
from hostlink.core.protocol.xrce.framing import LengthFraming
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_TCP
from tests.support import xrce_board as board
from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import virtual

ZERO = bytes(48)


@virtual
async def test_answers_are_written_before_events_are_dispatched() -> None:
    transport, device = memory_pair()
    order: list[str] = []
    write: Callable[[bytes], bool] = transport.write

    def note(data: bytes) -> bool:
        order.append("written")
        return write(data)

    def react(_: Link, event: Event) -> None:
        order.append(type(event).__name__)

    transport.write = note  # type: ignore[method-assign]
    link = Link(transport, MICRO_ROS_TCP.session(Catalog()), LinkConfig(), number=1, on_event=react)
    client, framing = board.Client(key=b"key!"), LengthFraming()
    client.sent.append(client.creation())
    client.send(0, 0, board.sub(board.TIMESTAMP, bytes(8)))
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        await device.send(b"".join(map(framing.encode, client.sent)))
        await asyncio.sleep(0.05)
        running.cancel()
    assert order == ["written", "written", "TimeRequested"]


@virtual
async def test_zero_that_the_board_does_not_answer_is_repeated_after_it_was_written_at_once() -> None:
    transport, device = memory_pair()
    session = MICRO_ROS_TCP.session(Catalog())
    link = Link(transport, session, LinkConfig(), number=1, on_event=lambda _link, _event: None)
    client, framing = board.Client(key=b"key!"), LengthFraming()
    client.sent.append(client.creation())
    for id_, content, parent in (
        (0x01, board.participant("base"), 0),
        (0x02, board.topic("rt/cmd_vel", "geometry_msgs::msg::dds_::Twist_"), 1),
        (0x04, b"\0\0", 1),
        (0x06, board.endpoint(0x02, is_reader=True), 4),
    ):
        client.send(0, 0, client.creating(id_, content, parent)[1])
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(link.run())
        for message in client.sent:
            await device.send(framing.encode(message))
        await asyncio.sleep(0.5)
        await device.receive()  # the statuses
        assert session.send_zero(session.topics[0], ZERO)
        link.write_now(asyncio.get_running_loop().time())
        await asyncio.sleep(0.3)
        assert (await device.receive()).count(ZERO) > 3
        running.cancel()
