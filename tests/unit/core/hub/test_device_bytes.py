"""The limit on what the sessions of all devices keep together."""

import random

from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.byte_budget import Share
from hostlink.core.hub.device_bytes import DeviceBytes
from hostlink.core.hub.memories import Memories
from hostlink.core.link.link import Link
from hostlink.core.link.serving import LinkEnd
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_TCP
from hostlink.core.protocol.xrce.session import XrceSession
from tests.support import xrce_board as board
from tests.support.logs import logged
from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import virtual

CATALOG = Catalog()


def link_of(number: int, *, fragments: int = 0, objects: int = 0) -> Link:
    """A link whose board has sent fragments of a message that never ends, and created objects with long names."""
    session = MICRO_ROS_TCP.session(CATALOG)
    client, codec = board.Client(key=number.to_bytes(4)), board.Lengths()
    client.sent.append(client.creation())
    part = random.Random(number).randbytes(1000)
    for at in range(fragments):
        client.send(0x80, at, board.sub(board.FRAGMENT, part))
    for at in range(objects):
        client.send(0, 0, client.creating(board.object_id(at, 1), board.participant("x" * 200), 0)[1])
    for message in client.sent:
        session.receive(codec.encode(message), now_s=0.0)
    return Link(memory_pair()[0], session, Config().link, number=number, on_event=lambda _link, _event: None)


def memories_of(*links: Link) -> Memories:
    memories = Memories()
    for link in links:
        memories.join(link)
    return memories


@virtual
async def test_device_that_keeps_most_loses_its_unfinished_messages_first() -> None:
    small, large = link_of(1, fragments=10), link_of(2, fragments=200)
    assert isinstance(large.session, XrceSession)
    kept = small.session.kept_bytes
    share = Share(50_000)
    DeviceBytes(share, memories_of(small, large)).look()
    assert large.session.kept_bytes == 0
    assert small.session.kept_bytes == share.held_bytes == kept >= 10_000
    assert (small._end, large._end) == (None, None)
    assert share.refused == 1


@virtual
async def test_device_whose_objects_alone_are_too_large_loses_its_link() -> None:
    small, large = link_of(1, objects=2), link_of(2, objects=500)
    share = Share(50_000)
    with capture_logs() as lines:
        DeviceBytes(share, memories_of(small, large)).look()
    assert (small._end, large._end) == (None, LinkEnd.EVICTED)
    assert logged(lines) == ["link.too_large"]
    assert 0 < share.held_bytes <= share.max_bytes
