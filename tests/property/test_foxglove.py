"""Any text, any request with any fields, any bytes from a client of Foxglove's protocol: refused, bounded, alive."""

import asyncio
import json
import struct

from hypothesis import given
from hypothesis import strategies as st

from hostlink.components.gateway.foxglove_protocol import Published, ServiceCall, decode_frame
from hostlink.core.hub.queue import MAX_MESSAGES, MAX_RESULTS
from hostlink.errors import BadRequest
from tests.support.foxglove_memory import World, world
from tests.support.virtual_loop import within

OPS = (
    "subscribe", "unsubscribe", "advertise", "unadvertise", "getParameters", "setParameters",
    "subscribeParameterUpdates", "unsubscribeParameterUpdates", "subscribeConnectionGraph",
    "unsubscribeConnectionGraph", "fetchAsset", "dance",
)  # fmt: skip
FIELDS = (
    "subscriptions", "subscriptionIds", "channels", "channelIds", "parameterNames", "parameters", "id", "uri",
    "requestId",
)  # fmt: skip
KNOWN = (
    "/chat", "chat", "/rosout", "std_msgs/String", "std_msgs/msg/String", "geometry_msgs/Twist", "nav_msgs/Path",
    "ros1", "json", "/gain", "/rosapi/topics", "float64", "float64_array", "byte_array", "",
)  # fmt: skip

scalars = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=5), st.sampled_from(KNOWN),
    st.integers(0, 4),
)  # fmt: skip
items = st.fixed_dictionaries(
    {},
    optional={
        "id": st.integers(0, 4),
        "channelId": st.integers(0, 6),
        "topic": st.sampled_from(KNOWN),
        "encoding": st.sampled_from(("ros1", "json")),
        "schemaName": st.sampled_from(KNOWN),
        "name": st.sampled_from(KNOWN),
        "value": st.recursive(scalars, lambda inner: st.lists(inner, max_size=3), max_leaves=4),
        "type": st.sampled_from(KNOWN),
    },
)
values = st.one_of(scalars, st.lists(st.one_of(scalars, items), max_size=4), items)
requests = st.builds(
    lambda op, fields: {"op": op, **fields},
    st.sampled_from(OPS),
    st.dictionaries(st.sampled_from(FIELDS), values, max_size=3),
)
right_requests = st.one_of(
    st.builds(lambda one: {"op": "subscribe", "subscriptions": [one]}, items),
    st.builds(lambda one: {"op": "advertise", "channels": [one]}, items),
    st.builds(lambda one: {"op": "setParameters", "parameters": [one]}, items),
    st.builds(
        lambda names: {"op": "subscribeParameterUpdates", "parameterNames": names}, st.lists(st.sampled_from(KNOWN))
    ),
    st.builds(lambda ids: {"op": "unsubscribe", "subscriptionIds": ids}, st.lists(st.integers(0, 4), max_size=3)),
)
numbers = st.integers(0, 4)
frames = st.one_of(
    st.binary(max_size=40),
    st.builds(lambda number, rest: struct.pack("<BI", 1, number) + rest, numbers, st.binary(max_size=60)),
    st.builds(
        lambda service, length, rest: struct.pack("<BIII", 2, service, 7, length) + rest,
        numbers,
        st.one_of(st.just(4), st.integers(0, 2**32 - 1)),
        st.one_of(st.binary(max_size=20), st.binary(max_size=9).map(lambda payload: b"ros1" + payload)),
    ),
)
sent = st.one_of(
    right_requests.map(json.dumps), requests.map(json.dumps), values.map(json.dumps), st.text(max_size=30), frames,
)  # fmt: skip


@given(st.lists(st.tuples(st.integers(0, 1), sent), max_size=25))
@within(world)
async def test_no_client_can_break_itself_or_another(here: World, messages: list[tuple[int, str | bytes]]) -> None:
    peers = [here.client(), here.client()]
    for number, data in messages:
        peers[number].client.receive(data)
        await asyncio.sleep(0)
    await asyncio.sleep(100)  # virtual: every deadline is over
    for peer in peers:
        peer.client.flush(asyncio.get_running_loop().time())
        assert len(list(iter(peer.queue.pop, None))) <= MAX_MESSAGES + MAX_RESULTS
    await still_works(here)
    for peer in peers:
        peer.client.participant.leave()
    assert [topic.name for topic in here.hub.topics.all()] == ["/rosout"]
    assert here.hub.isolation.crashes.total() == 0


async def still_works(here: World) -> None:
    """Clients as good as new do what clients do."""
    speaker, listener = here.client(), here.client()
    channel = {"id": 1, "topic": "/fresh", "encoding": "ros1", "schemaName": "std_msgs/String"}
    speaker.send(op="advertise", channels=[channel])
    await asyncio.sleep(0.1)
    (number,) = [each["id"] for each in listener.channels() if each["topic"] == "/fresh"]
    listener.send(op="subscribe", subscriptions=[{"id": 3, "channelId": number}])
    payload = struct.pack("<I", 1) + b"x"
    speaker.client.receive(struct.pack("<BI", 1, 1) + payload)
    ((opcode, subscription, _, received),) = listener.messages()
    assert (opcode, subscription, received) == (1, 3, payload)
    for peer in (speaker, listener):
        peer.client.participant.leave()


@given(sent)
@within(world)
async def test_one_wrong_message_has_at_most_one_status(here: World, data: str | bytes) -> None:
    peer = here.client()
    peer.json()
    peer.client.receive(data)
    assert sum(each["op"] == "status" for each in peer.json()) <= 1


@given(st.binary(max_size=64))
def test_every_frame_is_read_or_refused(data: bytes) -> None:
    try:
        frame = decode_frame(data)
    except BadRequest:
        return
    match frame:
        case Published(number, payload):
            assert struct.pack("<BI", 1, number) + payload == data
        case ServiceCall(service, call, encoding, payload):
            head = struct.pack("<BII", 2, service, call)
            assert data.startswith(head)
            assert data.endswith(payload)
            assert len(encoding) <= len(data)
