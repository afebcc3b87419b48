"""Services by rosbridge: called, and offered by programs."""

import asyncio
from typing import Any

import pytest

from tests.support.rosbridge_memory import call, offered, world
from tests.support.virtual_loop import run_virtual

CHAT = {"topic": "/chat", "type": "std_msgs/String"}


def messages(heard: list[Any]) -> list[Any]:
    return [frame["msg"] for frame in heard if frame["op"] == "publish"]


def statuses(heard: list[Any]) -> list[str]:
    return [frame["msg"] for frame in heard if frame["op"] == "status"]


async def test_arguments_may_be_a_list_in_the_order_of_the_fields() -> None:
    async with world() as here:
        peer = here.client()
        assert (await call(peer, "/rosapi/set_param", ["/gain", "7"])) == {}
        assert (await call(peer, "rosapi/get_param", ["/gain"])) == {"value": "7"}
        assert (await call(peer, "/rosapi/get_time", []))["time"].keys() == {"secs", "nsecs"}
        assert (await call(peer, "/rosapi/get_param", ["/none", "8", "one too many"])) == {"value": "8"}
        assert "args must be an object" in await call(peer, "/rosapi/get_param", "x")


async def test_a_call_goes_to_the_program_complete_and_its_answer_comes_back_complete_and_once() -> None:
    async with world() as here:
        server, caller = await offered(here), here.client()
        caller.say(op="call_service", id=7, service="/switch", args=[True])
        (asked,) = await server.answers()
        assert (asked["op"], asked["service"], asked["args"]) == ("call_service", "switch", {"data": True})
        for _ in range(2):
            server.say(op="service_response", id=asked["id"], service="switch", values={"success": True}, result=True)
        assert await caller.answers() == [
            {
                "op": "service_response", "service": "/switch", "result": True, "id": 7,
                "values": {"success": True, "message": ""},
            }
        ]  # fmt: skip


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ({"values": "no", "result": False}, "switch: no"),
        ({"result": False}, "switch: None"),
        ({"values": [1], "result": True}, "switch: its answer is no object"),
        ({"values": {"sucess": True}, "result": True}, "no field 'sucess'"),
    ],
)
async def test_a_failure_has_its_reason_in_values(answer: dict[str, Any], reason: str) -> None:
    async with world() as here:
        server, caller = await offered(here), here.client()
        caller.say(op="call_service", id=7, service="/switch")
        (asked,) = await server.answers()
        server.say(op="service_response", id=asked["id"], service="switch", **answer)
        (heard,) = await caller.answers()
        assert heard["result"] is False
        assert reason in heard["values"]


async def test_a_type_that_nobody_defines_passes_as_it_is() -> None:
    async with world() as here:
        server, caller = await offered(here, "my_srvs/Odd"), here.client()
        caller.say(op="call_service", id=7, service="/switch", args={"any": [1, None]})
        (asked,) = await server.answers()
        assert asked["args"] == {"any": [1, None]}
        server.say(op="service_response", id=asked["id"], service="switch", values={"x": 1}, result=True)
        assert (await caller.answers())[0]["values"] == {"x": 1}


async def test_a_program_that_leaves_fails_its_calls_at_once() -> None:
    async with world() as here:
        server, caller = await offered(here), here.client()
        caller.say(op="call_service", id=7, service="/switch")
        await server.answers()
        server.client.close()
        (heard,) = await caller.answers()
        assert (heard["result"], heard["values"]) == (False, "no service named switch")


def test_a_call_has_a_deadline_of_the_callers_choice() -> None:
    async def run() -> list[Any]:
        async with world() as here:
            _, caller = await offered(here), here.client()
            caller.say(op="call_service", id=7, service="/switch", timeout=2)
            await asyncio.sleep(2.5)
            short = caller.heard()
            caller.say(op="call_service", id=8, service="/switch")
            await asyncio.sleep(59)
            assert caller.heard() == []
            await asyncio.sleep(2)
            return short + caller.heard()

    heard = run_virtual(run())
    assert [answer["values"] for answer in heard] == ["/switch: no answer within 2 s", "/switch: no answer within 60 s"]


async def test_hostlinks_own_services_are_nobody_elses() -> None:
    async with world() as here:
        thief = here.client()
        thief.say(op="advertise_service", service="/rosapi/topics", type="rosapi/Topics")
        assert statuses(thief.heard()) == ["/rosapi/topics is a service of hostlink's own"]
        thief.client.close()
        assert "/rosout" in (await call(here.client(), "/rosapi/topics"))["topics"]
