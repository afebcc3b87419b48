"""Reading speed of a link as a share of the speed of its parser alone, for any length of frame."""

import asyncio
import time

import pytest

from hostlink.core.config import LinkConfig
from hostlink.core.link.fair_share import FairShare
from hostlink.core.link.link import Link
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.events import Event
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.protocol.rosserial.session import Session
from hostlink.core.protocol.rosserial.stream import FrameStream
from hostlink.core.transport.base import READ_BYTES
from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import run_virtual

INFO = DeviceEndpoint(EndpointKind.PUBLISHER, 125, "/long", "std_msgs/String", "m", 2048)
HELLO = encode(Id.TIME, bytes(8)) + encode(Id.PUBLISHER, encode_topic_info(INFO)) + encode(Id.TIME, bytes(8))
FRAMES = 4000
ROUNDS = 7
LEAST_SHARE = 0.2  # the best round: 0.28 to 0.47, also with two busy programs running; in pieces of 512 bytes 0.17


def _ignore(_link: Link, _event: Event) -> None:
    """Ignore the event."""


def parser_s(read: bytes, reads: int) -> float:
    stream = FrameStream(limit_bytes=INFO.buffer_bytes)
    began_s = time.process_time()
    for _ in range(reads):
        for _frame in stream.feed(read):
            pass
    return time.process_time() - began_s


async def link_s(read: bytes, reads: int) -> float:
    host, device = memory_pair(room_bytes=1 << 20)
    link = Link(host, Session(check=lambda _: None), LinkConfig(), number=1, on_event=_ignore, share=FairShare())
    running = asyncio.get_running_loop().create_task(link.run())
    await device.send(HELLO)
    while link.session.counts.negotiations == 0 or link.unread_bytes:  # noqa: ASYNC110 - there is no event
        await asyncio.sleep(0)
    began_s = time.process_time()
    for _ in range(reads):
        device.write(read)
        await asyncio.sleep(0)
        while link.unread_bytes:  # noqa: ASYNC110 - there is no event
            await asyncio.sleep(0)
    lasted_s = time.process_time() - began_s
    await device.aclose()
    await running
    return lasted_s


@pytest.mark.slow
@pytest.mark.parametrize("payload_bytes", [24, 200, 1024])
def test_a_link_reads_frames_of_any_length_at_a_share_of_its_parser_alone(payload_bytes: int) -> None:
    """Processor time, alternating: what else runs on the machine disturbs both alike. The best round counts.

    In virtual time a piece costs no time, so its size does not depend on the machine: on a slow one a link reads frames
    of 200 bytes in pieces of 512, and has the share that this test refuses.
    """
    frame = encode(INFO.id, bytes(number % 251 for number in range(payload_bytes)))
    read = frame * max(1, READ_BYTES // len(frame))
    reads = FRAMES * len(frame) // len(read)
    shares = [parser_s(read, reads) / run_virtual(link_s(read, reads)) for _ in range(ROUNDS)]
    assert max(shares) > LEAST_SHARE, shares
