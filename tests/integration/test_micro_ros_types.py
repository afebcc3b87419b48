"""Types of micro-ROS boards between their CDR, the hub and ROS 2; definitions of the user's for both protocols."""

import struct
from pathlib import Path
from random import Random

import pytest

from hostlink.components.graphs.ros2_types import Ros2Types
from hostlink.core.messages.catalog import Catalog
from hostlink.core.messages.cdr import ENCAPSULATION, cdr_of
from hostlink.core.protocol import events
from hostlink.core.protocol.endpoint import DeviceEndpoint, EndpointKind
from hostlink.core.protocol.rosserial.control import encode_topic_info
from hostlink.core.protocol.rosserial.frame import encode
from hostlink.core.protocol.rosserial.protocol import ROSSERIAL
from hostlink.core.protocol.session import DeviceSession
from hostlink.core.protocol.xrce.payloads import Payloads
from hostlink.core.protocol.xrce.protocol import MICRO_ROS_UDP
from tests.support import xrce_board as board
from tests.support.xrce_board import Client, Link, Program, World, sub

NODE, TOPIC, PUBLISHER, WRITER, REPLIER = 0x01, 0x02, 0x03, 0x05, 0x08
OWN = "int32 count\nstring text\nfloat64[] values\n"
ASK = "int32 a\n---\nstring answer\nint64 sum\n"
EQUAL = {
    "geometry_msgs/Twist": {"linear": {"x": 0.25}, "angular": {"z": -1.5}},
    "geometry_msgs/Pose2D": {"x": 1.0, "y": 2.0, "theta": 0.5},
    "std_msgs/Float64": {"data": 0.125},
    "std_msgs/ColorRGBA": {"r": 0.5, "g": 0.25, "b": 1.0, "a": 1.0},
    "geometry_msgs/PoseWithCovariance": {"pose": {"orientation": {"w": 1.0}}},
}
OTHERS = {
    "nav_msgs/Odometry": {"header": {"frame_id": "odom"}, "child_frame_id": "base_link"},
    "sensor_msgs/Imu": {"header": {"frame_id": "imu_link"}, "orientation": {"w": 1.0}},
    "std_msgs/String": {"data": "words"},
    "sensor_msgs/JointState": {"name": ["left", "right"], "position": [0.5, 1.0]},
}


@pytest.fixture(scope="module")
def types() -> Ros2Types:
    return Ros2Types(Catalog(), "jazzy")


@pytest.mark.parametrize("name", EQUAL)
def test_payload_of_an_equal_layout_passes_to_ros_2_as_the_board_sent_it(types: Ros2Types, name: str) -> None:
    endpoint = DeviceEndpoint(EndpointKind.PUBLISHER, 1, "/a", name)
    catalog = Catalog()
    type_ = catalog.message(name)
    assert type_ is not None
    assert cdr_of(type_).is_copy
    payloads, sent = Payloads(catalog), type_.encode(EQUAL[name])
    payloads.check(endpoint)
    carried = payloads.from_device(endpoint, sent)
    assert carried is sent  # nothing is made of it
    known = types.message(name)
    assert known is not None
    assert known.to_cdr(carried) == ENCAPSULATION + sent


@pytest.mark.parametrize("name", OTHERS)
def test_payload_of_another_layout_is_the_same_in_ros_2(types: Ros2Types, name: str) -> None:
    type_, known = Catalog().message(name), types.message(name)
    assert type_ is not None
    assert known is not None
    sent = cdr_of(type_).from_ros1(type_.encode(OTHERS[name]))
    assert not cdr_of(type_).is_copy
    assert known.to_cdr(cdr_of(type_).to_ros1(sent))[: 4 + len(sent)] == ENCAPSULATION + sent


# -- definitions of the user's ----------------------------------------------------------------------------------------


@pytest.fixture
def catalog(tmp_path: Path) -> Catalog:
    for kind, name, text in (("msg", "Own.msg", OWN), ("srv", "Ask.srv", ASK)):
        folder = tmp_path / "my_msgs" / kind
        folder.mkdir(parents=True)
        (folder / name).write_text(text)
    return Catalog((tmp_path,))


def micro_ros(catalog: Catalog) -> World:
    """A board with a topic and a service of the user's types."""
    client = Client(key=b"\1\2\3\4")

    def program() -> Program:
        assert (yield from client.connect())
        for id_, content, parent in (
            (NODE, board.participant("base"), 0),
            (TOPIC, board.topic("rt/own", "my_msgs::msg::dds_::Own_"), NODE),
            (PUBLISHER, b"\0\0", NODE),
            (WRITER, board.endpoint(TOPIC, is_reader=False), PUBLISHER),
            (REPLIER, board.service("ask", "my_msgs::srv::dds_::Ask"), NODE),
        ):
            assert (yield from client.create(id_, content, parent)) in {0, 1}
        client.read_data(REPLIER)
        yield from client.confirm(1.0)

    session = MICRO_ROS_UDP.session(catalog)
    here = World(session, client.listen(0.0), client, Link(Random(1)))
    here.do(program())
    here.run(here.now_s + 0.5)
    return here


def rosserial(catalog: Catalog) -> DeviceSession:
    """A device with the same topic and service that speaks rosserial."""
    session = ROSSERIAL.session(catalog)
    session.open(now_s=0.0)
    type_, service = catalog.message("my_msgs/Own"), catalog.service("my_msgs/Ask")
    assert type_ is not None
    assert service is not None
    for kind, id_, name, type_name, md5 in (
        (EndpointKind.PUBLISHER, 125, "own", type_.name, type_.md5),
        (EndpointKind.SERVICE_SERVER_PUBLISHER, 126, "ask", service.name, service.response.md5),
        (EndpointKind.SERVICE_SERVER_SUBSCRIBER, 127, "ask", service.name, service.request.md5),
    ):
        info = DeviceEndpoint(kind, id_, name, type_name, md5, 512)
        session.receive(encode(kind, encode_topic_info(info)), now_s=0.1)
    session.tick(now_s=1.0)
    return session


def test_message_of_the_users_type_is_the_same_from_both_protocols(catalog: Catalog) -> None:
    type_ = catalog.message("my_msgs/Own")
    assert type_ is not None
    message = {"count": 7, "text": "seven", "values": [0.5, 1.5]}
    here = micro_ros(catalog)
    assert here.session.raw_endpoints == ()
    here.do(here.client.publish(WRITER, struct.pack("<iI6s2xI4x2d", 7, 6, b"seven\0", 2, 0.5, 1.5)))
    (found,) = [each for _, each in here.found if isinstance(each, events.MessageReceived)]
    assert (found.topic.type, type_.decode(found.payload)) == ("my_msgs/Own", message)
    received = rosserial(catalog).receive(encode(125, type_.encode(message)), now_s=1.1)
    assert [each.payload for each in received if isinstance(each, events.MessageReceived)] == [found.payload]


def test_service_of_the_users_type_is_called_on_both_protocols(catalog: Catalog) -> None:
    service = catalog.service("my_msgs/Ask")
    assert service is not None
    request, response = service.request.encode({"a": 3}), service.response.encode({"answer": "yes", "sum": 5})
    here = micro_ros(catalog)
    here.session.call("/ask", request)
    here.write()
    here.do(here.client.listen(1.0))
    (asked,) = [payload for _, object_, _, payload in here.client.taken if object_ == REPLIER]
    assert asked[24:] == struct.pack("<i", 3)
    answer = struct.pack("<I4sq", 4, b"yes\0", 5)
    here.client.put(sub(board.WRITE, struct.pack(">HH", here.client.request(), REPLIER) + asked[:24] + answer))
    here.do(here.client.confirm(1.0))
    (found,) = [each for _, each in here.found if isinstance(each, events.ServiceResponded)]
    assert found.payload == response
    wired = rosserial(catalog)
    wired.call("ask", request)
    received = wired.receive(encode(126, response), now_s=1.2)
    assert [each.payload for each in received if isinstance(each, events.ServiceResponded)] == [response]
