"""Services by rosbridge: called, and offered by programs."""

import asyncio
from collections.abc import Mapping
from typing import Any

import pytest

from hostlink.core.hub.services import Provider
from tests.support.rosbridge_memory import Peer, World, call, offered, world
from tests.support.virtual_loop import run_virtual

CHAT = {"topic": "/chat", "type": "std_msgs/String"}


def messages(heard: list[Any]) -> list[Any]:
    return [frame["msg"] for frame in heard if frame["op"] == "publish"]


def statuses(heard: list[Any]) -> list[str]:
    return [frame["msg"] for frame in heard if frame["op"] == "status"]


async def test_call_arguments_may_be_a_list_in_field_order() -> None:
    async with world() as here:
        peer = here.client()
        assert (await call(peer, "/rosapi/set_param", ["/gain", "7"])) == {}
        assert (await call(peer, "rosapi/get_param", ["/gain"])) == {"value": "7"}
        assert (await call(peer, "/rosapi/get_time", []))["time"].keys() == {"secs", "nsecs"}
        assert (await call(peer, "/rosapi/get_param", ["/none", "8", "one too many"])) == {"value": "8"}
        assert "args must be an object" in await call(peer, "/rosapi/get_param", "x")


async def test_call_and_answer_are_completed_and_delivered_once() -> None:
    async with world() as here:
        server, caller = await offered(here), here.client()
        caller.send(op="call_service", id=7, service="/switch", args=[True])
        (request,) = await server.answers()
        assert (request["op"], request["service"], request["args"]) == ("call_service", "switch", {"data": True})
        for _ in range(2):
            server.send(
                op="service_response", id=request["id"], service="switch", values={"success": True}, result=True
            )
        assert await caller.answers() == [
            {
                "op": "service_response", "service": "/switch", "result": True, "id": 7,
                "values": {"success": True, "message": ""},
            }
        ]  # fmt: skip


async def answered(here: World, answer: dict[str, Any]) -> tuple[Peer, str, list[dict[str, Any]]]:
    """Call a service that a program offers, and answer; returns the program, the id of its request, what is heard."""
    server, caller = await offered(here), here.client()
    caller.send(op="call_service", id=7, service="/switch")
    (request,) = await server.answers()
    server.send(op="service_response", id=request["id"], service="switch", **answer)
    return server, request["id"], await caller.answers()


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ({"values": "no", "result": False}, "switch: no"),
        ({"result": False}, "switch: None"),
        ({"values": [1], "result": True}, "switch: the answer is not an object"),
        ({"values": {"sucess": True}, "result": True}, "no field 'sucess'"),
    ],
)
async def test_failed_call_has_its_reason_in_values(answer: dict[str, Any], reason: str) -> None:
    async with world() as here:
        _, _, (heard,) = await answered(here, answer)
        assert heard["result"] is False
        assert reason in heard["values"]


@pytest.mark.parametrize("result", [False, None, True])
async def test_service_answer_is_delivered_for_any_result(result: bool | None) -> None:
    """Success of a service is a field of its answer, as in rosbridge."""
    async with world() as here:
        values = {"success": False, "message": "the door is open"}
        server, _, (heard,) = await answered(here, {"values": values, "result": result})
        assert (heard["values"], heard["result"]) == (values, True)
        assert server.received() == []


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ({"values": [1], "result": True}, "switch: the answer is not an object"),
        ({"values": "ok"}, "switch: the answer is not an object"),
        ({"values": {"sucess": True}, "result": True}, "no field 'sucess'"),
        ({"values": {"sucess": True}, "result": False}, "no field 'sucess'"),
        ({"values": {"success": True}, "result": "yes"}, "switch: result must be true or false"),
        ({"values": {}, "result": [True]}, "switch: result must be true or false"),
    ],
)
async def test_invalid_answer_fails_the_call_and_is_reported_to_its_sender(answer: dict[str, Any], reason: str) -> None:
    async with world() as here:
        server, request_id, (heard,) = await answered(here, answer)
        (status,) = server.received()
        assert (heard["result"], status["level"], status["id"]) == (False, "error", request_id)
        assert reason in heard["values"]
        assert reason in status["msg"]


async def test_answer_without_a_call_is_reported() -> None:
    async with world() as here:
        server = await offered(here)
        for more in ({"id": "client 1 7"}, {}, {"id": 3}):
            server.send(op="service_response", service="switch", values={}, result=True, **more)
        assert (
            server.received()
            == [
                {
                    "op": "status",
                    "level": "warning",
                    "msg": "service_response: no call waits for an answer with this id",
                }
            ]
            * 3
        )


async def test_withdrawn_service_fails_only_its_pending_calls() -> None:
    async with world() as here:
        server, caller = await offered(here), here.client()
        server.send(op="advertise_service", service="/other", type="std_srvs/Trigger")
        caller.send(op="call_service", id=1, service="/switch")
        caller.send(op="call_service", id=2, service="/other")
        request = await server.answers()
        server.send(op="unadvertise_service", service="/switch")
        (heard,) = await caller.answers()
        assert (heard["id"], heard["result"], heard["values"]) == (1, False, "no service named /switch")
        server.send(op="service_response", id=request[1]["id"], service="/other", values={"success": True}, result=True)
        assert [answer["id"] for answer in await caller.answers()] == [2]


async def test_newest_provider_gets_the_calls_until_it_withdraws() -> None:
    async with world() as here:
        first, caller = await offered(here), here.client()
        caller.send(op="call_service", id=1, service="/switch")
        (request,) = await first.answers()
        second = await offered(here)
        expected = f"/switch: {second.client.participant.name} offers it too and gets the calls, as long as it is there"
        assert statuses(first.received()) == [expected]
        first.send(op="service_response", id=request["id"], service="switch", values={"message": "first"}, result=True)
        assert (await caller.answers())[0]["values"]["message"] == "first"
        caller.send(op="call_service", id=2, service="/switch")
        assert (len(await second.answers()), first.received()) == (1, [])
        second.client.participant.leave()
        caller.send(op="call_service", id=3, service="/switch")
        assert [request["op"] for request in await first.answers()] == ["call_service"]


async def test_provider_that_advertises_again_is_not_notified() -> None:
    async with world() as here:
        server = await offered(here)
        server.send(op="advertise_service", service="/switch", type="std_srvs/SetBool")
        assert server.received() == []


async def test_service_with_a_bug_fails_only_its_call() -> None:
    async def answer(_: Mapping[str, object]) -> Mapping[str, object]:
        raise ZeroDivisionError("a bug")

    async with world() as here:
        caller = here.client()
        here.hub.services.provide(Provider("/odd", "std_srvs/Trigger", "it", answer))
        caller.send(op="call_service", id=7, service="/odd")
        (heard,) = await caller.answers()
        assert (heard["result"], heard["values"]) == (False, "/odd: ZeroDivisionError: a bug")
        assert (await call(caller, "/rosapi/get_param", ["/none", "8"])) == {"value": "8"}


async def test_call_of_an_unknown_type_is_passed_unchanged() -> None:
    async with world() as here:
        server, caller = await offered(here, "my_srvs/Odd"), here.client()
        caller.send(op="call_service", id=7, service="/switch", args={"any": [1, None]})
        (request,) = await server.answers()
        assert request["args"] == {"any": [1, None]}
        server.send(op="service_response", id=request["id"], service="switch", values={"x": 1}, result=True)
        assert (await caller.answers())[0]["values"] == {"x": 1}


async def test_provider_that_disconnects_fails_its_calls_at_once() -> None:
    async with world() as here:
        server, caller = await offered(here), here.client()
        caller.send(op="call_service", id=7, service="/switch")
        await server.answers()
        server.client.participant.leave()
        (heard,) = await caller.answers()
        assert (heard["result"], heard["values"]) == (False, "no service named /switch")


def test_call_has_the_deadline_of_its_caller() -> None:
    async def run() -> list[Any]:
        async with world() as here:
            _, caller = await offered(here), here.client()
            caller.send(op="call_service", id=7, service="/switch", timeout=2)
            await asyncio.sleep(2.5)
            short = caller.received()
            caller.send(op="call_service", id=8, service="/switch")
            await asyncio.sleep(59)
            assert caller.received() == []
            await asyncio.sleep(2)
            return short + caller.received()

    heard = run_virtual(run())
    assert [answer["values"] for answer in heard] == ["/switch: no answer within 2 s", "/switch: no answer within 60 s"]


async def test_services_of_hostlink_cannot_be_advertised() -> None:
    async with world() as here:
        thief = here.client()
        thief.send(op="advertise_service", service="/rosapi/topics", type="rosapi/Topics")
        assert statuses(thief.received()) == ["/rosapi/topics is a service of hostlink's own"]
        thief.client.participant.leave()
        assert "/rosout" in (await call(here.client(), "/rosapi/topics"))["topics"]
