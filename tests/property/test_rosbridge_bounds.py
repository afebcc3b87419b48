"""Bounds of what one rosbridge client costs, for any number of any requests."""

import tracemalloc
from typing import Any

import pytest

from hostlink.components.gateway.rosbridge import MAX_TEXT
from hostlink.core.hub.participant import MAX_ADVERTISED, MAX_LATCHED, MAX_SERVICES, MAX_SUBSCRIPTIONS
from tests.support.rosbridge_memory import world


def statuses(heard: list[Any]) -> list[str]:
    return [frame["msg"] for frame in heard if frame["op"] == "status"]


@pytest.mark.slow
async def test_resources_of_one_client_are_bounded() -> None:
    async with world() as here:
        peer = here.client()
        for number in range(10_000):
            peer.send(op="subscribe", topic=f"/topic_{number}", type="std_msgs/Bool")
            peer.send(op="subscribe", id=number, topic="/one", type="std_msgs/Bool")
            peer.queue.pop()
        assert sum(len(topic.subscribers) for topic in here.hub.topics.all()) == MAX_SUBSCRIPTIONS // 2 + 1
        for number in range(MAX_ADVERTISED + 50):
            peer.send(op="advertise", id=number, latch=number < 50, topic=f"/mine_{number}", type="std_msgs/Bool")
            peer.send(op="advertise_service", service=f"/mine_{number}", type="std_srvs/Empty")
        topics = here.hub.topics.all()
        assert sum(peer.client.participant in topic.publishers for topic in topics) == MAX_ADVERTISED
        assert sum(bool(topic.latched) for topic in here.hub.topics.all()) == MAX_LATCHED
        assert sum(name.startswith("/mine_") for name, _ in here.hub.services.all()) == MAX_SERVICES
        peer.received()
        peer.send(op="subscribe", topic="x" * (MAX_TEXT + 1))
        assert statuses(peer.received()) == [f"subscribe: topic is longer than {MAX_TEXT} characters"]


@pytest.mark.slow
async def test_a_gigabyte_of_nesting_costs_no_memory() -> None:
    async with world() as here:
        peer = here.client()
        deep = ["[" * 1_000_000, '{"op":' * 160_000, '{"op":"publish","topic":"/x","msg":' + '{"a":' * 200_000]
        for text in deep:
            peer.client.receive(text)
        assert all("invalid JSON" in text for text in statuses(peer.received()))
        tracemalloc.start()
        for _ in range(340):
            for text in deep:
                peer.client.receive(text)
            peer.received()
        held_bytes, peak_bytes = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert held_bytes < 100_000
    assert peak_bytes < 10_000_000


async def test_a_megabyte_of_lists_is_let_go() -> None:
    async with world() as here:
        peer = here.client()
        peer.client.receive('{"op":"subscribe","topic":"/x","id":[' + "[]," * 300_000 + "[]]}")
        assert statuses(peer.received()) == ["subscribe: id must be a number, or a text of at most 1024 characters"]
