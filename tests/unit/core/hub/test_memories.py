"""Memories of devices: by place, and of a bounded number."""

from hostlink.core.config import Config
from hostlink.core.hub.memories import MOST, MOST_CHARS, Memories
from hostlink.core.link.link import Link
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from tests.support import xrce_board as board
from tests.support.memory_transport import memory_pair
from tests.support.virtual_loop import virtual

CATALOG = Catalog()


def link_of(number: int, *, kind: str = "udp", objects: int = 1) -> Link:
    """A link of a board that has created some participants."""
    session, client = MICRO_ROS_UDP.session(CATALOG), board.Client(key=number.to_bytes(4))
    client.sent.append(client.creation())
    for at in range(objects):
        client.send(0, 0, client.creating(board.object_id(at, 1), board.participant("x" * 200), 0)[1])
    for message in client.sent:
        session.receive(message, now_s=0.0)
    session.tick(now_s=2.0)
    transport = memory_pair()[0]
    transport.kind, transport.peer = kind, f"10.0.0.1:{number}"
    return Link(transport, session, Config().link, number=number, on_event=lambda _link, _event: None)


@virtual
async def test_device_is_remembered_by_protocol_and_place_after_its_link() -> None:
    memories, changes = Memories(), list[int]()
    memories.on_change = lambda: changes.append(len(memories.texts))
    link = link_of(7)
    memories.join(link)
    memories.note()
    memories.note()
    memories.leave(link)
    assert changes == [1]
    assert memories.peers(MICRO_ROS_UDP, "udp") == ["10.0.0.1:7"]
    assert memories.of(MICRO_ROS_UDP, "udp", "10.0.0.1:7", "") == link.session.memory()
    assert not memories.has(ROSSERIAL, "udp", "10.0.0.1:7")
    assert not memories.has(MICRO_ROS_UDP, "serial", "10.0.0.1:7")
    memories.forget(MICRO_ROS_UDP, "udp", "10.0.0.1:7")
    assert memories.texts == {}
    assert not memories.has_links.is_set()


@virtual
async def test_devices_over_the_limit_of_long_texts_and_of_connections_are_not_remembered() -> None:
    memories = Memories()
    for number in range(MOST + 5):
        memories.join(link_of(number))
    memories.note()
    assert len(memories.texts) == MOST
    assert not memories.has(MICRO_ROS_UDP, "udp", "10.0.0.1:0")
    large = link_of(1000, objects=200)
    assert len(large.session.memory()) > MOST_CHARS
    memories.join(large)
    memories.join(link_of(1001, kind="tcp"))
    memories.note()
    assert not memories.has(MICRO_ROS_UDP, "udp", "10.0.0.1:1000")
    assert not memories.has(MICRO_ROS_UDP, "tcp", "10.0.0.1:1001")


@virtual
async def test_memory_of_a_link_that_ends_has_its_last_numbers() -> None:
    memories, link = Memories(), link_of(7)
    memories.join(link)
    memories.note()
    version, before = link.session.memory_version, dict(memories.texts)
    link.session.receive(b"\x81\x80\x00\x00" + board.sub(board.WRITE, b"\0\1\0\5"), now_s=2.1)
    assert link.session.memory_version == version
    memories.leave(link)
    (text,) = memories.texts.values()
    assert text == link.session.memory()
    assert before != memories.texts
