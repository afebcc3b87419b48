"""rosbridge v2 as in the sources of its clients: their operations, and the answers that they need."""

import asyncio
import json
import time
from typing import Any

import pytest

from hostlink.client.topics import read_raw
from hostlink.components.gateway.rosbridge import MAX_CALLS
from hostlink.core.hub.queue import MAX_MESSAGES
from hostlink.core.messages.serialisation import CDR
from tests.support.rosbridge_memory import call, offered, world
from tests.support.virtual_loop import run_virtual

CHAT = {"topic": "/chat", "type": "std_msgs/String"}


def messages(heard: list[Any]) -> list[Any]:
    return [frame["msg"] for frame in heard if frame["op"] == "publish"]


def statuses(heard: list[Any]) -> list[str]:
    return [frame["msg"] for frame in heard if frame["op"] == "status"]


async def test_integer_too_large_for_a_float_is_accepted() -> None:
    async with world() as here:
        peer, too_large = here.client(), 10**400
        peer.send(op="subscribe", **CHAT, throttle_rate=too_large, queue_length=too_large)
        peer.send(op="call_service", id="1", service="/rosapi/topics", timeout=too_large)
        await asyncio.sleep(0.05)
        assert [frame["result"] for frame in peer.received()] == [True]


# -- topics -----------------------------------------------------------------------------------------------------------


async def test_type_is_inferred_when_the_topic_is_advertised_later() -> None:
    async with world() as here:
        speaker, listener = here.client(), here.client()
        listener.send(op="subscribe", topic="/chat")
        assert "/chat" not in (await call(here.client(), "/rosapi/topics"))["topics"]
        speaker.send(op="publish", **CHAT, msg={"data": "hello"})
        assert messages(listener.received()) == [{"data": "hello"}]
        assert "/chat" in (await call(here.client(), "/rosapi/topics"))["topics"]


@pytest.mark.parametrize(("level", "count"), [("error", 2), ("none", 0)])
def test_slow_client_is_told_of_what_it_loses_at_once_and_then_every_ten_seconds(level: str, count: int) -> None:
    async def run() -> None:
        async with world() as here:
            speaker, listener = here.client(), here.client()
            listener.send(op="set_level", level=level)
            for topic in ("/chat", "/flood"):
                listener.send(op="subscribe", topic=topic, type="std_msgs/String")
            speaker.send(op="publish", **CHAT, msg={"data": "kept"})
            told = []
            for number in range(MAX_MESSAGES + 1101):
                speaker.send(op="publish", topic="/flood", type="std_msgs/String", msg={"data": f"{number}"})
                await asyncio.sleep(0.01)
            heard = listener.received()
            told = [each for each in statuses(heard) if "too slowly" in each]
            assert len(told) == count
            assert [each["msg"]["data"] for each in heard if each.get("topic") == "/chat"] == ["kept"]
            if count:
                assert "messages dropped: 1 (/flood 1)" in told[0]
                assert "messages dropped: 1000 (/flood 1000)" in told[1]

    run_virtual(run())


async def test_topic_is_echoed_in_the_spelling_of_the_client() -> None:
    spellings = ["chat", "/chat", "//chat", "~chat"]
    async with world() as here:
        listener = here.client()
        for spelling in spellings:
            listener.send(op="subscribe", topic=spelling)
        here.client().send(op="publish", **CHAT, msg={"data": "x"})
        assert [frame["topic"] for frame in listener.received()] == spellings


async def test_topic_is_advertised_until_its_last_id_is_withdrawn() -> None:
    async with world() as here:
        peer = here.client()
        for number in ("a", "b"):
            peer.send(op="advertise", id=number, **CHAT)
        peer.send(op="unadvertise", id="a", topic="chat")
        assert here.hub.topics.find("/chat").publishers == {peer.client.participant}
        peer.send(op="unadvertise", id="b", topic="/chat")
        assert here.hub.topics.find_or_none("/chat") is None
        peer.send(op="advertise", id="c", **CHAT)
        peer.send(op="unadvertise", topic="/chat")
        assert here.hub.topics.find_or_none("/chat") is None


async def test_another_type_is_refused_while_the_topic_is_used() -> None:
    async with world() as here:
        first, second = here.client(), here.client()
        first.send(op="advertise", **CHAT)
        second.send(op="subscribe", topic="/chat")
        second.send(op="advertise", topic="/chat", type="std_msgs/Int32")
        assert statuses(second.received()) == ["/chat: wanted std_msgs/String, got std_msgs/Int32"]
        first.client.participant.leave()
        second.send(op="publish", topic="/chat", type="std_msgs/Int32", msg={"data": 7})
        assert messages(second.received()) == [{"data": 7}]


async def test_latched_message_is_sent_to_later_subscribers() -> None:
    async with world() as here:
        speaker = here.client()
        speaker.send(op="advertise", latch=True, topic="/map", type="std_msgs/String")
        speaker.send(op="publish", latch=True, topic="/map", msg={"data": "old"})
        speaker.send(op="publish", latch=True, topic="/map", msg={"data": "new"})
        speaker.send(op="publish", latch=True, topic="/unsaid", type="std_msgs/String", msg={"data": "too"})
        listener = here.client()
        for topic in ("/map", "/unsaid"):
            listener.send(op="subscribe", topic=topic)
        assert messages(listener.received()) == [{"data": "new"}, {"data": "too"}]
        speaker.client.participant.leave()
        late = here.client()
        late.send(op="subscribe", topic="/map")
        assert late.received() == []


# -- subscriptions ----------------------------------------------------------------------------------------------------


def test_ids_of_a_topic_share_one_stream_at_the_highest_rate() -> None:
    async def run() -> list[Any]:
        async with world() as here:
            listener, speaker = here.client(), here.client()
            listener.send(op="subscribe", id="slow", throttle_rate=10_000, **CHAT)
            listener.send(op="subscribe", id="fast", throttle_rate=100, **CHAT)
            for number in range(10):
                speaker.send(op="publish", topic="/chat", msg={"data": str(number)})
                await asyncio.sleep(0.06)
            listener.send(op="unsubscribe", id="fast", topic="/chat")
            for number in range(10, 90):
                speaker.send(op="publish", topic="/chat", msg={"data": str(number)})
                await asyncio.sleep(0.06)
            return listener.received()

    assert [message["data"] for message in messages(run_virtual(run()))] == ["0", "2", "4", "6", "8"]


async def test_repeated_subscribe_keeps_the_throttle() -> None:
    async with world() as here:
        listener = here.client()
        for number in range(5):
            listener.send(op="subscribe", id="a", throttle_rate=10_000, **CHAT)
            here.client().send(op="publish", topic="/chat", msg={"data": str(number)})
        assert len(messages(listener.received())) == 1


async def test_two_compressions_of_one_topic_send_the_rawest_once() -> None:
    async with world() as here:
        listener, speaker = here.client(), here.client()
        for number, form in enumerate(["none", "cbor", "cbor-raw"]):
            listener.send(op="subscribe", id=number, compression=form, **CHAT)
        forms = []
        for number in (2, 1, 0):
            speaker.send(op="publish", topic="/chat", msg={"data": "x"})
            (frame,) = listener.received()
            forms.append(frame["msg"].get("bytes") or frame["msg"])
            listener.send(op="unsubscribe", id=number, topic="/chat")
        assert forms == [b"\x01\x00\x00\x00x", {"data": "x"}, {"data": "x"}]
        speaker.send(op="publish", topic="/chat", msg={"data": "x"})
        assert listener.received() == []


async def test_png_compression_sends_json_and_a_warning() -> None:
    async with world() as here:
        listener = here.client()
        listener.send(op="subscribe", compression="png", fragment_size=10, **CHAT)
        assert statuses(listener.received()) == ["subscribe: compression png is not offered, /chat is sent as JSON"]
        here.client().send(op="publish", topic="/chat", msg={"data": "x" * 100})
        assert messages(listener.received()) == [{"data": "x" * 100}]


# -- values -----------------------------------------------------------------------------------------------------------


async def encoded(type_name: str, message: object) -> Any:
    """Return the message that one client receives of another, or the reason of its refusal."""
    async with world() as here:
        speaker, listener = here.client(), here.client()
        listener.send(op="subscribe", topic="/t", type=type_name)
        speaker.send(op="publish", topic="/t", msg=message)
        return (messages(listener.received()) or statuses(speaker.received()))[0]


@pytest.mark.parametrize(
    ("type_name", "message", "heard"),
    [
        ("std_msgs/msg/String", {}, {"data": ""}),
        ("std_msgs/Float64", {"data": None}, {"data": None}),
        ("std_msgs/Int64", {"data": 2**63 - 1}, {"data": 2**63 - 1}),
        ("std_msgs/UInt64", {"data": 2**64 - 1}, {"data": 2**64 - 1}),
        ("std_msgs/Time", {"data": {"secs": 1, "nsecs": 2}}, {"data": {"secs": 1, "nsecs": 2}}),
        ("std_msgs/Time", {"data": {"sec": 1, "nanosec": 2}}, {"data": {"secs": 1, "nsecs": 2}}),
        ("std_msgs/Duration", {"data": {"secs": -1}}, {"data": {"secs": -1, "nsecs": 0}}),
        ("sensor_msgs/CompressedImage", {"data": "AQID"}, "AQID"),
        ("sensor_msgs/CompressedImage", {"data": [1, 2, 3]}, "AQID"),
    ],
)
async def test_values_are_read_and_written_as_clients_expect(type_name: str, message: object, heard: object) -> None:
    got = await encoded(type_name, message)
    assert (got["data"] if isinstance(heard, str) else got) == heard


@pytest.mark.parametrize(
    ("type_name", "message", "reason"),
    [
        ("std_msgs/String", {"date": ""}, "std_msgs/String has no field 'date'; its fields: data"),
        ("std_msgs/Int64", {"data": 2**63}, "outside -9223372036854775808..9223372036854775807"),
        ("std_msgs/Int32", {"data": 1.5}, "wanted a whole number, got 1.5"),
        ("std_msgs/Header", {"stamp": "soon"}, "std_msgs/Header.stamp: wanted an object with fields"),
        ("sensor_msgs/CompressedImage", {"data": "?"}, "wanted base64"),
        ("geometry_msgs/PoseArray", {"poses": [{}] * 20_000}, "more than 1048576 bytes"),
    ],
)
async def test_invalid_values_are_named(type_name: str, message: object, reason: str) -> None:
    assert reason in await encoded(type_name, message)


@pytest.mark.parametrize(
    "header",
    [
        {},
        {"frame_id": ""},
        {"stamp": {"secs": 0, "nsecs": 0}},
        {"stamp": {"sec": 0}},
        {"stamp": "now"},
        {"seq": None, "stamp": None, "frame_id": None},
    ],
)
async def test_stamp_that_is_missing_or_zero_or_now_is_filled_in(header: dict[str, object]) -> None:
    pose = {"header": header} if header else {}
    single = await encoded("geometry_msgs/PoseStamped", pose)
    path = await encoded("nav_msgs/Path", {"poses": [pose, {}]})
    for stamp in (single["header"]["stamp"], *(one["header"]["stamp"] for one in (path, *path["poses"]))):
        assert abs(stamp["secs"] - time.time()) < 5


async def test_given_stamp_is_kept_and_now_fills_any_time() -> None:
    kept = await encoded("std_msgs/Header", {"stamp": {"secs": 5, "nsecs": 6}})
    assert kept["stamp"] == {"secs": 5, "nsecs": 6}
    assert abs((await encoded("std_msgs/Time", {"data": "now"}))["data"]["secs"] - time.time()) < 5
    assert (await encoded("std_msgs/Time", {}))["data"] == {"secs": 0, "nsecs": 0}


# -- the rest ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "op", ["cancel_action_goal", "advertise_action", "unadvertise_action", "action_feedback", "action_result"]
)
async def test_actions_are_refused_with_a_reason(op: str) -> None:
    async with world() as here:
        peer = here.client()
        peer.send(op=op, id="g", action="/dock")
        (status,) = peer.received()
        assert status == {
            "op": "status", "level": "error", "msg": f"{op}: actions are unsupported", "kind": "BadRequest", "id": "g",
        }  # fmt: skip


async def test_auth_is_accepted_and_unknown_op_is_ignored() -> None:
    async with world() as here:
        peer = here.client()
        peer.send(op="auth", mac="m", client="c", dest="d", rand="r", t=1, level="l", end=2)
        assert peer.received() == []
        peer.send(op="dance", id="x")
        assert statuses(peer.received()) == ["unknown op 'dance'"]
        peer.send(op="set_level", level="none")
        peer.send(op="dance")
        assert peer.received() == []


async def test_fragments_are_joined_in_any_order() -> None:
    text = json.dumps({"op": "publish", **CHAT, "msg": {"data": "ä" * 50}}, ensure_ascii=False)
    pieces = [text[at : at + 20] for at in range(0, len(text), 20)]
    async with world() as here:
        listener, speaker = here.client(), here.client()
        listener.send(op="subscribe", topic="/chat")
        for number in reversed(range(len(pieces))):
            speaker.send(op="fragment", id="f", num=number, total=len(pieces), data=pieces[number])
        assert messages(listener.received()) == [{"data": "ä" * 50}]
        assert speaker.received() == []


# -- bounds -----------------------------------------------------------------------------------------------------------


async def test_pending_calls_are_bounded_and_all_answered() -> None:
    async with world() as here:
        await offered(here)
        caller = here.client()
        for number in range(MAX_CALLS + 3):
            caller.send(op="call_service", id=number, service="/switch")
        refused = await caller.answers()
        assert [answer["id"] for answer in refused] == [MAX_CALLS, MAX_CALLS + 1, MAX_CALLS + 2]
        assert {answer["values"] for answer in refused} == {f"more than {MAX_CALLS} calls are pending"}


async def test_many_quick_calls_in_one_read_are_all_answered() -> None:
    async with world() as here:
        caller, answers = here.client(), []
        for number in range(200):
            caller.send(op="call_service", id=number, service="/rosapi/get_time")
            if caller.client.calls > MAX_CALLS // 2:
                await asyncio.sleep(0)
            answers += caller.received()
        answers += await caller.answers()
        assert sorted(answer["id"] for answer in answers if answer["result"]) == list(range(200))


async def test_client_that_does_not_read_answers_is_not_read_from() -> None:
    async with world() as here:
        peer = here.client()
        for number in range(150):
            peer.send(op="dance", id=number)
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.01):
                await peer.queue.room()
        assert len(peer.received()) == 150
        await peer.queue.room()
        assert not peer.queue.is_too_slow


# -- types without a definition ---------------------------------------------------------------------------------------


async def test_cdr_is_refused_to_a_reader_of_cbor_raw_that_does_not_read_the_encoding() -> None:
    async with world() as here:
        topic = here.hub.topics.advertise("/talk", "board", type_name="my_msgs/Own", raw_encoding=CDR)
        plain, other, known = (here.client() for _ in range(3))
        for each in (plain, other):
            each.send(op="set_level", level="warning")
        plain.send(op="subscribe", topic="/talk", compression="cbor-raw")
        other.send(op="subscribe", topic="/talk", compression="cbor-raw", any_encoding="yes")
        known.send(op="subscribe", topic="/talk", compression="cbor-raw", any_encoding=True)
        topic.publish(b"\0\1\0\0x", source="board")
        refusal = (
            'my_msgs/Own: its messages are cdr, because it has no definition; subscribe with "any_encoding": true, or '
            "put its .msg into a folder named in message_folders"
        )
        assert [statuses(each.received()) for each in (plain, other)] == [[refusal]] * 2
        (message,) = messages(known.received())
        assert (message["bytes"], message["encoding"]) == (b"\0\1\0\0x", "cdr")
        raw = read_raw(message)
        assert (raw.payload, raw.encoding) == (b"\0\1\0\0x", "cdr")


async def test_reader_of_any_encoding_gets_messages_of_ros_1_without_its_name() -> None:
    async with world() as here:
        listener = here.client()
        listener.send(op="subscribe", compression="cbor-raw", any_encoding=True, **CHAT)
        here.client().send(op="publish", topic="/chat", msg={"data": "x"})
        (message,) = messages(listener.received())
        assert message.keys() == {"secs", "nsecs", "bytes"}
        assert read_raw(message).encoding == "ros1"
