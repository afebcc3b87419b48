"""Graph queries of rosbridge clients, binary messages, and services that programs offer."""

import asyncio
import struct

import cbor2
import pytest
from rosbags.typesys import Stores, get_typestore

from hostlink.config import Config
from hostlink.protocol.control import Log, Parameter, decode_parameter
from hostlink.protocol.frame import Id, encode
from tests.support.daemon import daemon
from tests.support.device_codec import encode_log, encode_parameter_request
from tests.support.fake_device import fake_device, pose, robot_topics, topic
from tests.support.rosbridge import client
from tests.support.waiting import expect

TOGGLE = [
    topic(Id.SERVICE_CLIENT_PUBLISHER, 125, "/toggle", "std_srvs/SetBool"),
    topic(Id.SERVICE_CLIENT_SUBSCRIBER, 100, "/toggle", "std_srvs/SetBool"),
]


async def test_topics_types_and_definitions() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()), client(host) as program:
        topics = await program.call("/rosapi/topics")
        assert dict(zip(topics["topics"], topics["types"], strict=True)) == {
            "/robot_0/cmd_vel": "geometry_msgs/Twist",
            "/robot_0/cmd_vel_stamped": "geometry_msgs/TwistStamped",
            "/robot_0/odom": "nav_msgs/Odometry",
            "/robot_0/odometry": "geometry_msgs/Pose2D",
            "/diagnostics": "diagnostic_msgs/DiagnosticArray",
            "/robot_0/reset_odometry": "std_msgs/Empty",
            "/robot_0/velocity_commands": "geometry_msgs/Twist",
            "/rosout": "rosgraph_msgs/Log",
            "/tf": "tf2_msgs/TFMessage",
        }
        raw = await program.call("/rosapi/topics_and_raw_types")
        twist = raw["typedefs_full_text"][raw["topics"].index("/robot_0/velocity_commands")]
        assert "=" * 80 + "\nMSG: geometry_msgs/Vector3\n" in twist
        assert await program.call("/rosapi/topics_for_type", type="std_msgs/Empty") == {
            "topics": ["/robot_0/reset_odometry"]
        }
        assert await program.call("/rosapi/topic_type", topic="robot_0/odometry") == {"type": "geometry_msgs/Pose2D"}
        assert await program.call("/rosapi/topic_type", topic="/nope") == {"type": ""}


async def test_typedefs_have_the_root_first_and_each_type_once() -> None:
    async with daemon() as host, client(host) as program:
        typedefs = (await program.call("/rosapi/message_details", type="geometry_msgs/Twist"))["typedefs"]
        request = (await program.call("/rosapi/service_request_details", type="std_srvs/SetBool"))["typedefs"]
        response = (await program.call("/rosapi/service_response_details", type="std_srvs/SetBool"))["typedefs"]
    assert [typedef["type"] for typedef in typedefs] == ["geometry_msgs/Twist", "geometry_msgs/Vector3"]
    assert typedefs[0]["fieldnames"] == ["linear", "angular"]
    assert typedefs[1]["fieldtypes"] == ["float64"] * 3
    assert typedefs[1]["fieldarraylen"] == [-1] * 3
    assert request[0]["fieldnames"] == ["data"]
    assert response[0]["fieldnames"] == ["success", "message"]


async def test_services_nodes_and_who_does_what() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()), client(host) as program:
        assert "/rosapi/topics" in (await program.call("/rosapi/services"))["services"]
        assert await program.call("/rosapi/service_type", service="/rosapi/topics") == {"type": "rosapi/Topics"}
        assert "/robot_0" in (await program.call("/rosapi/nodes"))["nodes"]
        details = await program.call("/rosapi/node_details", node="/robot_0")
        publishers = await program.call("/rosapi/publishers", topic="/robot_0/odometry")
    assert details["publishing"] == ["/robot_0/odometry"]
    assert details["subscribing"] == ["/robot_0/reset_odometry", "/robot_0/velocity_commands"]
    assert publishers == {"publishers": ["/robot_0"]}


async def test_every_answer_fits_the_type_of_its_service() -> None:
    """The definitions are rosapi's own; an answer that encodes has no field more and none of another kind."""
    args = {
        "type": "std_msgs/Header", "topic": "/rosout", "service": "/rosapi/topics", "node": "/hostlink",
        "name": "/gain", "value": "1",
    }  # fmt: skip
    async with daemon(Config(parameters={"gain": 7})) as host:
        names = [name for name, _ in host.hub.services.all() if name.startswith("/rosapi/")]
        assert len(names) == 26
        for name in sorted(names, key=lambda name: "delete" in name):
            type_ = host.hub.services.type_of(name)
            assert type_ is not None, name
            wanted = {field.name for field in type_.request.fields}
            if "service_re" in name:
                request = {"type": "rosapi/NodeDetails"}
            else:
                request = {key: value for key, value in args.items() if key in wanted}
            answer = await host.hub.services.call(name, request)
            assert answer.keys() == {field.name for field in type_.response.fields}
            assert type_.response.encode(answer)[:0] == b"", name


async def test_services_are_known_by_node_host_and_type() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()), client(host) as program:
        await program.send(op="advertise_service", service="/mine", type="std_srvs/Empty")
        await expect(lambda: host.hub.services.provider("/mine"))
        assert await program.call("/rosapi/service_node", service="/mine") == {"node": "/client_1"}
        assert await program.call("/rosapi/service_node", service="/none") == {"node": ""}
        assert (await program.call("/rosapi/service_host", service="/mine"))["host"]
        assert await program.call("/rosapi/service_host", service="/none") == {"host": ""}
        for wanted in ("/mine", "std_srvs/Empty"):
            assert await program.call("/rosapi/service_providers", service=wanted) == {"providers": ["/client_1"]}
        assert await program.call("/rosapi/services_for_type", type="std_srvs/srv/Empty") == {"services": ["/mine"]}
        assert await program.call("/rosapi/subscribers", topic="/robot_0/cmd_vel") == {"subscribers": ["/hostlink"]}
        assert (await program.call("/rosapi/get_ros_version"))["version"] == 1
        assert await program.call("/rosapi/search_param", name="gain") == {"global_name": ""}


async def test_parameters_are_those_that_devices_get() -> None:
    async with (
        daemon(Config(parameters={"gain": 7})) as host,
        fake_device(host.tcp, []) as device,
        client(host) as program,
    ):
        assert await program.call("/rosapi/get_param", name="/gain") == {"value": "7"}
        assert await program.call("/rosapi/get_param", name="/nope", default='"d"') == {"value": '"d"'}
        await program.call("/rosapi/set_param", name="/pid", value="[1.5, 2.0]")
        assert await program.call("/rosapi/get_param_names") == {"names": ["/gain", "/pid"]}
        await device.send(encode(Id.PARAMETER, encode_parameter_request("/pid")))
        assert decode_parameter(await device.frame(Id.PARAMETER)) == Parameter(floats=(1.5, 2.0))
        await program.call("/rosapi/delete_param", name="/pid")
        assert await program.call("/rosapi/has_param", name="/pid") == {"exists": False}
        assert abs((await program.call("/rosapi/get_time"))["time"]["secs"] - 1_700_000_000) > 0


@pytest.mark.parametrize(
    ("service", "arguments", "reason"),
    [
        ("/rosapi/message_details", {"type": "my_msgs/None"}, "no message type named my_msgs/None"),
        ("/rosapi/topic_type", {}, "topic must be a text"),
        ("/rosapi/set_param", {"name": "x", "value": "{"}, "value must be JSON"),
        ("/rosapi/delete_param", {"name": "x"}, "no parameter named x"),
        ("/rosapi/nothing", {}, "no service named /rosapi/nothing"),
    ],
)
async def test_call_that_cannot_be_answered_fails_with_a_reason(
    service: str, arguments: dict[str, str], reason: str
) -> None:
    async with daemon() as host, client(host) as program:
        await program.send(op="call_service", service=service, args=arguments)
        answer = await program.receive()
    assert answer["result"] is False
    assert reason in answer["values"]


async def test_cbor_raw_is_the_payload_as_it_came() -> None:
    async with daemon() as host, fake_device(host.tcp, robot_topics()) as device, client(host) as program:
        await program.send(op="subscribe", topic="/robot_0/odometry", compression="cbor-raw")
        await expect(lambda: len(host.hub.topics.find("/robot_0/odometry").subscribers) == 2)
        await device.send(pose(1.0, 2.0, 0.5))
        heard = await program.receive_binary()
    assert (heard["op"], heard["topic"]) == ("publish", "/robot_0/odometry")
    reader = get_typestore(Stores.ROS1_NOETIC)
    read = reader.deserialize_ros1(heard["msg"]["bytes"], "geometry_msgs/msg/Pose2D")
    assert (read.x, read.y, read.theta) == (1.0, 2.0, 0.5)


async def test_cbor_has_typed_arrays() -> None:
    topics = [topic(Id.PUBLISHER, 125, "/array", "std_msgs/Float32MultiArray")]
    async with daemon() as host, fake_device(host.tcp, topics) as device, client(host) as program:
        await program.send(op="subscribe", topic="/array", compression="cbor")
        await expect(lambda: host.hub.topics.find("/array").subscribers)
        await device.send(encode(125, bytes(8) + struct.pack("<I2f", 2, 1.5, -2.0)))
        data = (await program.receive_binary())["msg"]["data"]
    assert isinstance(data, cbor2.CBORTag)
    assert (data.tag, struct.unpack("<2f", data.value)) == (85, (1.5, -2.0))


async def test_a_program_offers_a_service_that_a_device_calls() -> None:
    async with daemon() as host, fake_device(host.tcp, TOGGLE) as device, client(host) as program:
        await program.send(op="advertise_service", service="/toggle", type="std_srvs/SetBool")
        await expect(lambda: host.hub.services.provider("/toggle"))
        await device.send(encode(125, b"\x01"))
        call = await program.receive()
        assert (call["op"], call["service"], call["args"]) == ("call_service", "/toggle", {"data": True})
        values = {"success": True, "message": "ok"}
        await program.send(op="service_response", id=call["id"], service="/toggle", values=values, result=True)
        assert await device.frame(100) == b"\x01\x02\x00\x00\x00ok"


async def test_a_program_that_leaves_fails_the_calls_that_wait_for_it() -> None:
    async with daemon() as host, client(host) as caller:
        async with client(host) as program:
            await program.send(op="advertise_service", service="/slow", type="std_srvs/Trigger")
            await expect(lambda: host.hub.services.provider("/slow"))
            await caller.send(op="call_service", id="1", service="/slow", timeout=60)
            assert (await program.receive())["op"] == "call_service"
        answer = await caller.receive()
    assert (answer["id"], answer["result"], answer["values"]) == ("1", False, "no service named /slow")


async def test_a_failure_of_a_program_s_service_is_passed_on_and_an_unasked_answer_is_harmless() -> None:
    async with daemon() as host, client(host) as caller, client(host) as program:
        await program.send(op="service_response", id="nobody", service="/odd", values={}, result=True)
        await program.send(op="advertise_service", service="/odd", type="std_srvs/Trigger")
        await expect(lambda: host.hub.services.provider("/odd"))
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(caller.send(op="call_service", service="/odd"))
            call = await program.receive()
        await program.send(op="service_response", id=call["id"], service="/odd", values="out of order", result=False)
        answer = await caller.receive()
        assert (answer["result"], answer["values"]) == (False, "/odd: out of order")
        await program.send(op="unadvertise_service", service="/odd")
        await expect(lambda: host.hub.services.provider("/odd") is None)


async def test_device_logs_are_on_rosout() -> None:
    async with daemon() as host, fake_device(host.tcp, []) as device, client(host) as program:
        await program.send(op="subscribe", topic="/rosout")
        await expect(lambda: host.hub.topics.find("/rosout").subscribers)
        await device.send(encode(Id.LOG, encode_log(Log(2, "warm"))))
        message = (await program.receive())["msg"]
    assert (message["level"], message["msg"]) == (4, "warm")
    assert message["header"]["stamp"]["secs"] > 1_700_000_000


async def test_an_action_is_refused_instead_of_waited_for() -> None:
    async with daemon() as host, client(host) as program:
        await program.send(op="send_action_goal", id="g", action="/dock", action_type="x")
        assert await program.receive() == {
            "op": "action_result", "id": "g", "action": "/dock", "values": "actions are unsupported", "status": 6,
            "result": False,
        }  # fmt: skip
