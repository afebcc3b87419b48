"""The rosapi services over rosbridge: topics, types, services and nodes of the graph, and parameters."""

import socket
from typing import Any

import pytest

from tests.support.rosbridge_memory import Peer, World, call, offered, world

CHAT = "/chat"


async def rosapi(peer: Peer, method: str, **args: Any) -> Any:
    return await call(peer, f"/rosapi/{method}", args)


def conversation(here: World) -> tuple[Peer, Peer]:
    """Return a client that publishes /chat and one that subscribes to it."""
    speaker, listener = here.client(), here.client()
    speaker.send(op="advertise", topic=CHAT, type="std_msgs/String")
    listener.send(op="subscribe", topic=CHAT)
    return speaker, listener


async def test_rosapi_topics_lists_names_beside_types_and_definitions() -> None:
    async with world() as here:
        speaker, listener = conversation(here)
        listener.send(op="subscribe", topic="/without_type")
        known = dict(zip(*(await rosapi(speaker, "topics")).values(), strict=True))
        assert known[CHAT] == "std_msgs/String"
        assert "/without_type" not in known
        found = await rosapi(speaker, "topics_and_raw_types")
        assert found["typedefs_full_text"][found["topics"].index(CHAT)].strip() == "string data"
        assert (await rosapi(speaker, "topics_for_type", type="std_msgs/msg/String"))["topics"] == [CHAT]
        assert (await rosapi(speaker, "topics_for_type", type="std_msgs/Bool"))["topics"] == []
        assert await rosapi(speaker, "topic_type", topic="chat") == {"type": "std_msgs/String"}
        assert await rosapi(speaker, "topic_type", topic="/none") == {"type": ""}


async def test_rosapi_details_describe_a_message_a_request_and_a_response() -> None:
    async with world() as here:
        peer = here.client()
        (text,) = (await rosapi(peer, "message_details", type="std_msgs/String"))["typedefs"]
        assert (text["type"], text["fieldnames"], text["fieldtypes"]) == ("std_msgs/String", ["data"], ["string"])
        (asked,) = (await rosapi(peer, "service_request_details", type="std_srvs/SetBool"))["typedefs"]
        (answered,) = (await rosapi(peer, "service_response_details", type="std_srvs/SetBool"))["typedefs"]
        assert (asked["fieldnames"], answered["fieldnames"]) == (["data"], ["success", "message"])


@pytest.mark.parametrize(
    ("service", "args", "reason"),
    [
        ("message_details", {"type": "std_msgs/None"}, "no message type named std_msgs/None"),
        ("service_request_details", {"type": "std_srvs/None"}, "no service type named std_srvs/None"),
        ("topic_type", {}, "topic must be a text"),
        ("publishers", {"topic": "/none"}, "/none"),
        ("subscribers", {"topic": "/none"}, "/none"),
        ("delete_param", {"name": "/none"}, "no parameter named /none"),
    ],
)
async def test_rosapi_request_that_cannot_be_met_is_answered_with_the_reason(
    service: str, args: dict[str, str], reason: str
) -> None:
    async with world() as here:
        assert reason in await rosapi(here.client(), service, **args)


async def test_rosapi_services_names_the_type_node_and_host_of_each() -> None:
    async with world() as here:
        await offered(here)
        peer = here.client()
        services = (await rosapi(peer, "services"))["services"]
        assert {"/switch", "/rosapi/topics"} <= set(services)
        assert (await rosapi(peer, "services_for_type", type="std_srvs/srv/SetBool"))["services"] == ["/switch"]
        assert await rosapi(peer, "service_type", service="switch") == {"type": "std_srvs/SetBool"}
        assert await rosapi(peer, "service_type", service="/none") == {"type": ""}
        assert await rosapi(peer, "service_node", service="/switch") == {"node": "/client_1"}
        assert await rosapi(peer, "service_node", service="/none") == {"node": ""}
        assert await rosapi(peer, "service_host", service="/switch") == {"host": socket.gethostname()}
        assert await rosapi(peer, "service_host", service="/none") == {"host": ""}
        for wanted in ("/switch", "switch", "std_srvs/SetBool"):
            assert await rosapi(peer, "service_providers", service=wanted) == {"providers": ["/client_1"]}
        assert await rosapi(peer, "service_providers", service="/none") == {"providers": []}


async def test_rosapi_nodes_names_what_each_publishes_subscribes_and_offers() -> None:
    async with world() as here:
        server = await offered(here)
        speaker, listener = conversation(here)
        assert (await rosapi(speaker, "nodes"))["nodes"] == ["/client_1", "/client_2", "/client_3", "/hostlink"]
        assert await rosapi(speaker, "publishers", topic=CHAT) == {"publishers": ["/client_2"]}
        assert await rosapi(speaker, "subscribers", topic=CHAT) == {"subscribers": ["/client_3"]}
        details = [await rosapi(server, "node_details", node=f"/client_{number}") for number in (1, 2, 3)]
        assert details == [
            {"publishing": [], "subscribing": [], "services": ["/switch"]},
            {"publishing": [CHAT], "subscribing": [], "services": []},
            {"publishing": [], "subscribing": [CHAT], "services": []},
        ]
        listener.client.close()
        assert await rosapi(speaker, "subscribers", topic=CHAT) == {"subscribers": []}


async def test_rosapi_parameter_is_set_found_searched_and_deleted() -> None:
    async with world() as here:
        peer = here.client()
        assert await rosapi(peer, "has_param", name="/gain") == {"exists": False}
        assert await rosapi(peer, "search_param", name="gain") == {"global_name": ""}
        assert await rosapi(peer, "set_param", name="/gain", value="7") == {}
        assert await rosapi(peer, "get_param", name="gain", default="8") == {"value": "7"}
        assert await rosapi(peer, "has_param", name="/gain") == {"exists": True}
        assert await rosapi(peer, "search_param", name="gain") == {"global_name": "/gain"}
        assert await rosapi(peer, "get_param_names") == {"names": ["/gain"]}
        assert await rosapi(peer, "delete_param", name="/gain") == {}
        assert await rosapi(peer, "get_param", name="/gain", default="8") == {"value": "8"}


async def test_rosapi_says_which_ros_it_speaks_and_that_it_has_no_actions() -> None:
    async with world() as here:
        peer = here.client()
        assert await rosapi(peer, "get_ros_version") == {"version": 1, "distro": "noetic"}
        assert await rosapi(peer, "action_servers") == {"action_servers": []}


async def test_every_answer_fits_the_type_of_its_service() -> None:
    """The definitions are rosapi's own; an answer that encodes has no field more and none of another kind."""
    args = {
        "type": "std_msgs/Header", "topic": "/rosout", "service": "/rosapi/topics", "node": "/hostlink",
        "name": "/gain", "value": "1",
    }  # fmt: skip
    async with world() as here:
        services, here.hub.parameters["gain"] = here.hub.services, 7
        names = [name for name, _ in services.all() if name.startswith("/rosapi/")]
        assert len(names) == 26
        for name in sorted(names, key=lambda name: "delete" in name):
            type_ = services.type_of(name)
            assert type_ is not None, name
            wanted = {field.name for field in type_.request.fields}
            if "service_re" in name:
                request = {"type": "rosapi/NodeDetails"}
            else:
                request = {key: value for key, value in args.items() if key in wanted}
            answer = await services.call(name, request)
            assert answer.keys() == {field.name for field in type_.response.fields}
            assert type_.response.encode(answer)[:0] == b"", name
