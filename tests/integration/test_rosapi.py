"""Graph queries of rosbridge clients, binary messages, and services that programs offer."""

from rosbags.typesys import Stores, get_typestore

from hostlink.config import Config
from hostlink.protocol.control import Log, Parameter, decode_parameter
from hostlink.protocol.frame import Id, encode
from tests.support.daemon import daemon
from tests.support.device_codec import encode_log, encode_parameter_request
from tests.support.fake_device import fake_device, pose, robot_topics, service_client
from tests.support.rosbridge import client
from tests.support.waiting import expect

TOGGLE = service_client("/toggle", "std_srvs/SetBool")


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


async def test_device_logs_are_on_rosout() -> None:
    async with daemon() as host, fake_device(host.tcp, []) as device, client(host) as program:
        await program.send(op="subscribe", topic="/rosout")
        await expect(lambda: host.hub.topics.find("/rosout").subscribers)
        await device.send(encode(Id.LOG, encode_log(Log(2, "warm"))))
        message = (await program.receive())["msg"]
    assert (message["level"], message["msg"]) == (4, "warm")
    assert message["header"]["stamp"]["secs"] > 1_700_000_000
