"""Views of the hub: complete, and made without blocking the event loop."""

import asyncio

import msgspec

from hostlink.components.gateway.views import Slices, links_view
from hostlink.core.config import Config
from hostlink.core.hub.devices import Devices
from hostlink.core.hub.hub import Hub
from hostlink.core.link.serving import LinkEnd
from hostlink.core.messages.catalog import Catalog
from hostlink.core.protocol.endpoint import EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.robot.device_views import LinksView, LinkView
from tests.support.fake_device import topic
from tests.support.memory_transport import memory_pair

LINKS, TOPICS = 20, 255


def crowd(hub: Hub) -> None:
    """Links of devices that have announced as many topics as a device may have."""
    infos = [
        topic(EndpointKind.PUBLISHER, 125 + number, f"/a/name/of/topic/{number}", "std_msgs/String")
        for number in range(TOPICS)
    ]
    announced = b"".join(encode(info.kind, encode_topic_info(info)) for info in infos)
    for _ in range(LINKS):
        session = hub.links.open(memory_pair()[0], ROSSERIAL).session
        session.open(now_s=0.0)
        session.receive(announced, now_s=0.0)
        session.tick(now_s=1.0)


async def test_view_of_many_topics_yields_the_loop_after_each_link() -> None:
    hub = Hub(Config(), Catalog(), reraises=True)
    crowd(hub)
    turns = 0

    async def neighbour() -> None:
        nonlocal turns
        while True:
            await asyncio.sleep(0)
            turns += 1

    other = asyncio.get_running_loop().create_task(neighbour())
    view = await links_view(Devices(hub), Slices(hub.turns()))
    other.cancel()
    encoded = msgspec.json.encode(view)
    found = msgspec.json.decode(encoded, type=LinksView)
    assert [len(link["topics"]) for link in found["links"]] == [TOPICS] * LINKS
    assert msgspec.json.decode(encoded)["links"][0].keys() == LinkView.__annotations__.keys()
    assert turns >= LINKS / 2  # a turn each, or two where a processor is fast


async def test_link_that_ends_while_the_view_is_made_is_not_among_the_live_ones() -> None:
    hub = Hub(Config(), Catalog(), reraises=True)
    crowd(hub)
    last = hub.links.all()[-1]
    last.end(LinkEnd.EVICTED)
    ending = asyncio.get_running_loop().create_task(hub.links.serve(last))
    view = await links_view(Devices(hub), Slices(hub.turns()))
    await ending
    found = msgspec.json.decode(msgspec.json.encode(view), type=LinksView)
    assert [link["number"] for link in found["ended"]] == [last.number]
    assert last.number not in [link["number"] for link in found["links"]]
