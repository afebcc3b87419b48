"""Any JSON, any operation with any fields, any bytes: never an error that escapes, never without bound, still alive."""

import asyncio
import json

from hypothesis import given
from hypothesis import strategies as st

from hostlink.core.hub.queue import MAX_MESSAGES, MAX_RESULTS
from tests.support.rosbridge_memory import World, world
from tests.support.virtual_loop import within

OPS = (
    "advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service", "advertise_service",
    "unadvertise_service", "service_response", "set_level", "auth", "fragment", "drive", "send_action_goal",
    "cancel_action_goal", "advertise_action", "unadvertise_action", "action_feedback", "action_result", "dance",
)  # fmt: skip
FIELDS = (
    "id", "topic", "type", "msg", "latch", "priority", "compression", "throttle_rate", "queue_length", "service",
    "args", "timeout", "values", "result", "level", "num", "total", "data", "action", "robot", "linear", "angular",
    "sent_s",
)  # fmt: skip
KNOWN = (
    "/a", "a", "/b", "~b", "/rosout", "/rosapi/topics", "rosapi/set_param", "/rosapi/get_param", "std_msgs/String",
    "std_msgs/msg/Header", "nav_msgs/Path", "std_srvs/SetBool", "rosapi/GetParam", "cbor", "cbor-raw", "png", "none",
    "error", "now", "client 1 1", "client 2 1", '{"op":"subscribe","topic":"/a"}', "",
)  # fmt: skip
MESSAGE_KEYS = ("data", "header", "stamp", "frame_id", "secs", "nsecs", "poses", "pose", "name", "value", "success")

scalars = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=5), st.sampled_from(KNOWN),
    st.integers(0, 3),
)  # fmt: skip
values = st.recursive(
    scalars,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.one_of(st.sampled_from(MESSAGE_KEYS), st.text(max_size=3)), inner, max_size=3),
    ),
    max_leaves=8,
)
requests = st.builds(
    lambda op, fields: {"op": op, **fields},
    st.sampled_from(OPS),
    st.dictionaries(st.sampled_from(FIELDS), st.one_of(st.sampled_from(KNOWN), values), max_size=8),
)
texts = st.one_of(
    requests.map(json.dumps),
    requests.map(json.dumps),
    values.map(json.dumps),
    st.text(max_size=30),
    st.binary(max_size=30),
)


@given(st.lists(st.tuples(st.integers(0, 1), texts), max_size=25))
@within(world)
async def test_no_client_can_break_itself_or_another(here: World, sent: list[tuple[int, str | bytes]]) -> None:
    peers = [here.client(), here.client()]
    for number, text in sent:
        peers[number].client.receive(text)
        await asyncio.sleep(0)
    await asyncio.sleep(100)  # virtual: every deadline is over
    for peer in peers:
        peer.client.participant.flush(asyncio.get_running_loop().time())
        assert len(list(iter(peer.queue.pop, None))) <= MAX_MESSAGES + MAX_RESULTS
    await still_works(here)
    for peer in peers:
        peer.client.participant.leave()
    assert [topic.name for topic in here.hub.topics.all()] == ["/rosout"]
    assert all(name.startswith("/rosapi/") for name, _ in here.hub.services.all())


async def still_works(here: World) -> None:
    """A client as good as new does what clients do."""
    speaker, listener = here.client(), here.client()
    listener.send(op="subscribe", topic="/fresh", type="std_msgs/String")
    speaker.send(op="publish", topic="fresh", msg={"data": "x"})
    listener.send(op="call_service", id=1, service="/rosapi/topics")
    heard = await listener.answers()
    assert heard[0] == {"op": "publish", "topic": "/fresh", "msg": {"data": "x"}}
    assert "/fresh" in heard[1]["values"]["topics"]
    for peer in (speaker, listener):
        peer.client.participant.leave()


ids = st.sampled_from([None, "x", "y", 1, 2])


@given(st.lists(st.tuples(st.sampled_from(["/a", "a", "/b"]), ids, st.booleans()), max_size=60))
@within(world)
async def test_subscriptions_after_any_ids_are_those_that_were_not_ended(
    here: World, sent: list[tuple[str, object, bool]]
) -> None:
    peer, wanted = here.client(), set[tuple[str, object]]()
    for topic, request_id, is_wanted in sent:
        peer.send(op="subscribe" if is_wanted else "unsubscribe", topic=topic, id=request_id)
        if is_wanted:
            wanted.add((topic, request_id))
        elif request_id is None:
            wanted = {other for other in wanted if other[0] != topic}
        else:
            wanted.discard((topic, request_id))
    subscribers = [each.key for topic in here.hub.topics.all() for each in topic.subscribers]
    assert subscribers.count(peer.client.participant) == len({topic for topic, _ in wanted})
    assert peer.received() == []
