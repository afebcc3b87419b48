"""Memories of devices: by place, and of a bounded number."""

from collections.abc import MutableMapping

import msgspec
from structlog.testing import capture_logs

from hostlink.core.config import Config
from hostlink.core.hub.kept import MAX_FILE_BYTES
from hostlink.core.hub.memories import MOST, MOST_CHARS, MOST_CHARS_TOGETHER, MOST_LOGGED, Memories
from hostlink.core.link.link import Link
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from hostlink.core.protocol.xrce.resume import read_state
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


def forgotten(logs: list[MutableMapping[str, object]]) -> list[tuple[object, str]]:
    """The boards that were reported as not remembered, each with the start of the reason."""
    lines = [each for each in logs if each["event"] == "boards.forgotten"]
    return [(each["board"], str(each["reason"]).split()[0]) for each in lines]


@virtual
async def test_devices_over_the_number_and_on_tcp_are_not_remembered() -> None:
    memories = Memories()
    for number in range(MOST + 5):
        memories.join(link_of(number))
    memories.join(link_of(1001, kind="tcp"))
    with capture_logs() as logs:
        memories.note()
    assert len(memories.texts) == MOST
    assert not memories.has(MICRO_ROS_UDP, "udp", "10.0.0.1:0")
    assert not memories.has(MICRO_ROS_UDP, "tcp", "10.0.0.1:1001")
    assert forgotten(logs) == [(f"micro-ROS udp 10.0.0.1:{number}", "others") for number in range(5)]


@virtual
async def test_device_with_many_long_objects_is_remembered() -> None:
    memories, large = Memories(), link_of(7, objects=400)
    memories.join(large)
    memories.note()
    text = memories.of(MICRO_ROS_UDP, "udp", "10.0.0.1:7", "")
    assert len(text) > 150_000
    state = read_state(text)
    assert state is not None
    assert len(state.clients[0].objects) == 400


@virtual
async def test_device_over_the_limit_of_one_is_logged_once() -> None:
    memories, larger = Memories(), link_of(7, objects=700)
    assert len(larger.session.memory()) > MOST_CHARS
    memories.join(larger)
    with capture_logs() as logs:
        memories.note()
        memories.leave(larger)
    assert not memories.has(MICRO_ROS_UDP, "udp", "10.0.0.1:7")
    assert forgotten(logs) == [("micro-ROS udp 10.0.0.1:7", "its")]


@virtual
async def test_devices_over_the_limit_of_all_together_are_forgotten_and_the_file_can_be_read() -> None:
    memories = Memories()
    text = "x" * (MOST_CHARS - 10)
    memories.restore({f"micro-ROS udp 10.0.0.2:{number}": text for number in range(MOST_CHARS_TOGETHER // len(text))})
    before = len(memories.texts)
    memories.forget(MICRO_ROS_UDP, "udp", "10.0.0.2:1")
    with capture_logs() as logs:
        for number in range(4):
            memories.join(link_of(number, objects=400))
            memories.note()
    assert forgotten(logs)[0] == ("micro-ROS udp 10.0.0.2:0", "others")
    assert before - 1 < len(memories.texts) < before + 3
    assert len(msgspec.json.encode(memories.texts)) < MAX_FILE_BYTES


@virtual
async def test_reports_of_forgotten_devices_are_bounded() -> None:
    memories = Memories()
    with capture_logs() as logs:
        for number in [*range(MOST_LOGGED + 1), 0]:
            memories._log_forgotten(f"board {number}", "why")
    assert len(logs) == MOST_LOGGED + 2
    assert len(memories._logged) == 2


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
