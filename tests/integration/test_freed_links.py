"""What a link leaves behind is freed with it: a collection that stops the loop for 50 ms finds little."""

import asyncio
import gc
import weakref

from hostlink.hub.diagnoses import ENDED_LINKS
from hostlink.protocol.control import encode_topic_info
from hostlink.protocol.frame import Id, encode
from tests.support.daemon import Daemon, daemon
from tests.support.fake_device import robot_topics
from tests.support.waiting import expect

TIME = encode(Id.TIME, bytes(8))


async def come_and_go(host: Daemon, number: int) -> "tuple[weakref.ref[object], ...]":
    """A robot connects and hangs up; its link, session, and whoever recorded it."""
    reader, writer = await asyncio.open_connection(*host.tcp)
    infos = b"".join(encode(info.kind, encode_topic_info(info)) for info in robot_topics(f"robot_{number}"))
    writer.write(TIME + infos + TIME)
    await expect(lambda: host.hub.robots.has(f"robot_{number}"))
    name = f"/robot_{number}/odometry"
    await expect(lambda: len(host.hub.topics.find(name).subscribers) > 1)  # the black box is one
    (link,) = host.hub.links.all()
    found = tuple(weakref.ref(each) for each in (link, link.session, host.hub.topics.find(name)))
    del link
    writer.write_eof()
    await reader.read()  # all of it: a reset is an error, whose traceback keeps what it passed
    writer.close()
    await expect(lambda: not host.hub.links.all())
    return found


async def test_a_link_that_has_ended_is_freed_without_the_garbage_collector() -> None:
    async with daemon(has_black_box=True) as host:
        gc.collect()
        gc.disable()
        try:
            found = await come_and_go(host, 0)
            for number in range(1, ENDED_LINKS + 2):  # of so many the diagnoses are kept
                await come_and_go(host, number)
            await expect(lambda: [each() for each in found] == [None] * 3)
        finally:
            gc.enable()
