"""PieceSize: small pieces of expensive frames, so that others have their turn."""

import asyncio

from hostlink.core.config import LinkConfig
from hostlink.core.link.fair_share import FairShare
from hostlink.core.link.link import (
    FIRST_BYTES,
    LARGE_PIECE_S,
    LEAST_BYTES,
    MOST_BYTES,
    PIECE_S,
    Link,
    PieceSize,
)
from hostlink.core.protocol.events import Event
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.protocol.rosserial.session import MOST_FRAMES, Session
from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import VirtualLoop, virtual

FRAME = encode(999, b"")


def test_expensive_pieces_become_small_and_cheap_ones_large_again() -> None:
    piece = PieceSize()
    for _ in range(10):
        piece.update(2 * PIECE_S)
    assert piece.size_bytes == LEAST_BYTES
    piece.update(PIECE_S / 2)
    assert piece.size_bytes == LEAST_BYTES
    for _ in range(10):
        piece.update(PIECE_S / 10)
    assert piece.size_bytes == FIRST_BYTES
    for _ in range(10):
        piece.update(LARGE_PIECE_S / 3)
    assert piece.size_bytes == MOST_BYTES
    piece.update(2 * LARGE_PIECE_S)
    assert piece.size_bytes == MOST_BYTES // 2


@virtual
async def test_expensive_frames_after_cheap_ones_delay_others_by_one_first_piece() -> None:
    """A device enlarges its pieces with cheap frames, then sends expensive ones."""
    cost_s, cheap_s = 0.0001, 0.00001
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    virtual, frames = loop, 0

    def burn(_link: Link, _event: Event) -> None:
        nonlocal frames
        frames += 1
        virtual.burn(cheap_s if 1 < frames <= 1 + 200 else cost_s)

    host, device = memory_pair(room_bytes=1 << 20)
    link = Link(host, Session(check=lambda _: None), LinkConfig(), number=1, on_event=burn, share=FairShare())
    running = loop.create_task(link.run())
    await device.send(encode(999, bytes(1000)) * 200 + FRAME * 3000)
    turns_s, before_s = [], loop.time()
    while link.session.counts.frames_from_device < 3200:
        await asyncio.sleep(0)
        turns_s.append(loop.time() - before_s)
        before_s = loop.time()
    assert link.unread_bytes == 0
    await device.aclose()
    await running
    assert max(turns_s) <= (MOST_FRAMES + 4) * cost_s


@virtual
async def test_flood_of_expensive_frames_yields_the_loop_each_millisecond() -> None:
    cost_s = 0.0001  # of a refused request
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    virtual = loop

    def burn(_link: Link, _event: Event) -> None:
        virtual.burn(cost_s)

    host, device = memory_pair(room_bytes=1 << 20)
    link = Link(
        host, Session(check=lambda _: None), LinkConfig(), number=1, on_event=burn, share=FairShare()
    )  # fmt: skip
    running = loop.create_task(link.run())
    await device.send(FRAME * 3000)
    turns_s, before_s = [], loop.time()
    while link.session.counts.frames_from_device < 3000:
        await asyncio.sleep(0)
        turns_s.append(loop.time() - before_s)
        before_s = loop.time()
    await device.aclose()
    await running
    assert max(turns_s) > 0.005  # the cost of the first piece is unknown
    assert sorted(turns_s)[-20] <= LEAST_BYTES / len(FRAME) * cost_s + 2 * cost_s
