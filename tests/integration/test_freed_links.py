"""Memory of an ended link or client is freed with it: a collection that stops the loop for 50 ms finds little."""

import asyncio
import gc
import socket
import struct
from typing import NamedTuple

import pytest

from hostlink.components.gateway.clients import ClientQueue
from hostlink.components.gateway.foxglove import FoxgloveClient
from hostlink.components.gateway.rosbridge import RosbridgeClient
from hostlink.core.hub.diagnoses import ENDED_LINKS
from hostlink.core.hub.topic import Topic
from hostlink.core.link.link import Link
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import Id, encode
from hostlink.core.protocol.rosserial.session import Session
from tests.support.api_loads import frame, operation, websocket_head
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import robot_topics
from tests.support.waiting import expect

TIME = encode(Id.TIME, bytes(8))
CLOSE = frame((1000).to_bytes(2, "big"), 8)


class Left(NamedTuple):
    """Numbers and names of what a connection that ended has left in memory."""

    links: set[int]
    sessions: int
    topics: set[str]


def kept() -> list[object]:
    """Links, sessions and topics in memory: objects of compiled classes take no weak references."""
    return [each for each in gc.get_objects() if type(each) in (Link, Session, Topic)]


def left(before: list[object]) -> Left:
    """Search the objects that were not in memory `before`."""
    known = set(map(id, before))
    objects = [each for each in kept() if id(each) not in known]
    links = {each.number for each in objects if type(each) is Link}
    topics = {each.name for each in objects if type(each) is Topic}
    return Left(links, sum(type(each) is Session for each in objects), topics)


async def come_and_go(host: Daemon, number: int, *, is_reset: bool = False) -> tuple[int, str]:
    """A robot connects and disconnects, or resets its connection: the number of its link, the name of its topic."""
    reader, writer = await asyncio.open_connection(*host.tcp)
    infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics(f"robot_{number}"))
    writer.write(TIME + infos + TIME)
    await expect(lambda: host.hub.robots.has(f"robot_{number}"))
    name = f"/robot_{number}/odometry"
    await expect(lambda: len(host.hub.topics.find(name).subscribers) > 1)  # the black box is one
    (link,) = host.hub.links.all()
    link_number = link.number
    del link
    if is_reset:
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        writer.transport.abort()
    else:
        writer.write_eof()
        await reader.read()
        writer.close()
    await expect(lambda: not host.hub.links.all())
    return link_number, name


@pytest.mark.parametrize("is_reset", [False, True])
async def test_a_link_that_has_ended_is_freed_without_the_garbage_collector(is_reset: bool) -> None:
    async with daemon(has_black_box=True) as host:
        gc.collect()
        gc.disable()
        try:
            before = kept()  # a failed test keeps what its traceback names
            link_number, topic = await come_and_go(host, 0, is_reset=is_reset)
            for number in range(1, ENDED_LINKS + 2):  # of so many the diagnoses are kept
                await come_and_go(host, number, is_reset=is_reset)
            await expect(lambda: link_number not in left(before).links)
            await expect(lambda: topic not in left(before).topics)
            await expect(lambda: left(before).sessions <= ENDED_LINKS)
        finally:
            gc.enable()


def clients_in_memory() -> int:
    return sum(type(each) in (RosbridgeClient, FoxgloveClient, ClientQueue) for each in gc.get_objects())


@pytest.mark.parametrize("protocol", [(), ("Sec-WebSocket-Protocol: foxglove.sdk.v1",)])
@pytest.mark.parametrize("is_reset", [False, True])
async def test_a_client_that_has_left_is_freed_without_the_garbage_collector(
    is_reset: bool, protocol: tuple[str, ...]
) -> None:
    """One that leaves before it has read the answers, and one that says goodbye."""
    async with daemon() as host:
        gc.collect()
        gc.disable()
        try:
            before = clients_in_memory()
            reader, writer = await asyncio.open_connection("127.0.0.1", int(host.url.rpartition(":")[2]))
            writer.write(websocket_head("", *protocol))
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b"".join(operation(op="advertise", topic=f"/a{i}", type="std_msgs/String") for i in range(50)))
            await expect(lambda: clients_in_memory() > before)
            if is_reset:
                writer.transport.abort()
            else:
                writer.write(CLOSE)
                await reader.read()
                writer.close()
            await expect(lambda: clients_in_memory() == before)
        finally:
            gc.enable()
