"""Foxglove's services and connection graph: advertised, called with payloads of ROS 1, and who provides what."""

import asyncio
import struct
from collections.abc import Mapping
from typing import Any

from hostlink.components.gateway.foxglove import MAX_CALLS
from hostlink.errors import ServiceFailed
from tests.support.foxglove_memory import Peer, World, world
from tests.support.virtual_loop import within

SETTLE_S = 0.1
SWITCH = {"name": "/switch", "type": "std_srvs/SetBool"}


class Switch:
    """A program that provides /switch. Requests wait until `answer`."""

    def __init__(self, here: World) -> None:
        self.requests: list[Mapping[str, object]] = []
        self.may_answer = asyncio.Event()
        self.participant = here.hub.join("program 9")
        self.participant.provide("/switch", "std_srvs/SetBool", self._answer)

    async def _answer(self, request: Mapping[str, object]) -> Mapping[str, object]:
        self.requests.append(request)
        await self.may_answer.wait()
        if not request["data"]:
            raise ServiceFailed("/switch", "it is stuck")
        return {"success": True, "message": "on"}


async def switch_of(peer: Peer) -> dict[str, Any]:
    """Return the advertised service /switch."""
    await asyncio.sleep(SETTLE_S)
    (found,) = [
        each for op in peer.json() if op["op"] == "advertiseServices" for each in op["services"]
        if each["name"] == "/switch"
    ]  # fmt: skip
    return dict(found)


def request(service_id: int, call_id: int, payload: bytes = b"\1", encoding: bytes = b"ros1") -> bytes:
    """Build a service call request as the specification has it."""
    return struct.pack("<BIII", 2, service_id, call_id, len(encoding)) + encoding + payload


@within(world)
async def test_service_is_advertised_with_its_schemas_and_answers_a_call(here: World) -> None:
    switch, peer = Switch(here), here.client()
    found = await switch_of(peer)
    assert found["type"] == "std_srvs/SetBool"
    for part in ("request", "response"):
        assert (found[part]["encoding"], found[part]["schemaEncoding"]) == ("ros1", "ros1msg")
        assert found[part]["schema"] == found[f"{part}Schema"]
    assert found["request"]["schemaName"] == "std_srvs/SetBool_Request"
    assert found["response"]["schemaName"] == "std_srvs/SetBool_Response"
    assert "bool success" in found["responseSchema"]
    switch.may_answer.set()
    peer.client.receive(request(found["id"], 77))
    await asyncio.sleep(SETTLE_S)
    (answer,) = [each for each in peer.received() if isinstance(each, bytes)]
    head = struct.pack("<BIII", 3, found["id"], 77, 4) + b"ros1"
    assert answer == head + b"\1" + struct.pack("<I", 2) + b"on"
    assert switch.requests == [{"data": True}]
    assert peer.client.calls == 0


@within(world)
async def test_call_that_fails_is_answered_with_the_reason_and_its_numbers(here: World) -> None:
    switch, peer = Switch(here), here.client()
    number = (await switch_of(peer))["id"]
    switch.may_answer.set()
    for call_id, data, reason in (
        (1, request(number, 1, b"\0"), "it is stuck"),
        (2, request(number, 2, b"too long"), "/switch: "),
        (3, request(number, 3, encoding=b"cdr"), "a request must have the encoding ros1, not 'cdr'"),
        (4, request(999, 4), "there is no service 999"),
    ):
        peer.client.receive(data)
        await asyncio.sleep(SETTLE_S)
        (failure,) = [each for each in peer.json() if each["op"] == "serviceCallFailure"]
        assert (failure["callId"], failure["serviceId"]) == (call_id, 999 if call_id == 4 else number)
        assert reason in failure["message"]


@within(world)
async def test_pending_calls_are_bounded(here: World) -> None:
    switch, peer = Switch(here), here.client()
    number = (await switch_of(peer))["id"]
    for call_id in range(MAX_CALLS + 1):
        peer.client.receive(request(number, call_id))
    await asyncio.sleep(SETTLE_S)
    assert peer.client.calls == MAX_CALLS
    (failure,) = [each for each in peer.json() if each["op"] == "serviceCallFailure"]
    assert (failure["callId"], failure["message"]) == (MAX_CALLS, f"more than {MAX_CALLS} calls are pending")
    switch.may_answer.set()
    await asyncio.sleep(SETTLE_S)
    assert (peer.client.calls, len([each for each in peer.received() if isinstance(each, bytes)])) == (0, MAX_CALLS)


@within(world)
async def test_calls_of_all_clients_share_a_budget_of_bytes(here: World) -> None:
    _switch, peer, share = Switch(here), here.client(), here.hub.budget["calls"]
    number = (await switch_of(peer))["id"]
    share.add(share.max_bytes)
    peer.client.receive(request(number, 1))
    await asyncio.sleep(SETTLE_S)
    (failure,) = [each for each in peer.json() if each["op"] == "serviceCallFailure"]
    assert "bytes in pending calls" in failure["message"]


@within(world)
async def test_withdrawn_service_is_no_longer_advertised(here: World) -> None:
    switch, peer = Switch(here), here.client()
    number = (await switch_of(peer))["id"]
    switch.participant.leave()
    await asyncio.sleep(1.0)
    assert [each["serviceIds"] for each in peer.json() if each["op"] == "unadvertiseServices"] == [[number]]


@within(world)
async def test_connection_graph_names_publishers_subscribers_and_providers(here: World) -> None:
    _switch, peer = Switch(here), here.client()
    speaker, listener = here.hub.join("speaker"), here.hub.join("listener")
    speaker.advertise("/chat", "std_msgs/String")
    listener.subscribe("/chat", lambda _: None)
    listener.subscribe("/silent", lambda _: None, type_name="std_msgs/String")
    peer.send(op="subscribeConnectionGraph")
    await asyncio.sleep(1.0)
    (update,) = [each for each in peer.json() if each["op"] == "connectionGraphUpdate"]
    publishers = {each["name"]: each["publisherIds"] for each in update["publishedTopics"]}
    subscribers = {each["name"]: each["subscriberIds"] for each in update["subscribedTopics"]}
    providers = {each["name"]: each["providerIds"] for each in update["advertisedServices"]}
    assert publishers["/chat"] == ["/speaker"]
    assert "/silent" not in publishers
    assert (subscribers["/chat"], subscribers["/silent"]) == (["/listener"], ["/listener"])
    assert providers["/switch"] == ["/program_9"]
    listener.leave()
    await asyncio.sleep(1.0)
    (update,) = [each for each in peer.json() if each["op"] == "connectionGraphUpdate"]
    assert {"/chat", "/silent"} <= set(update["removedTopics"]) | {each["name"] for each in update["subscribedTopics"]}
    peer.send(op="unsubscribeConnectionGraph")
    speaker.leave()
    await asyncio.sleep(1.0)
    assert [each for each in peer.json() if each["op"] == "connectionGraphUpdate"] == []
