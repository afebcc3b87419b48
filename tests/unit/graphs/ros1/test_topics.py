"""Topics of the hub for ROS nodes, and their velocities for robots, without sockets."""

import asyncio
import math

import pytest

from hostlink.errors import BadPayload
from hostlink.graphs.ros1 import topics
from hostlink.graphs.ros1.local_node import Ros1Counts
from hostlink.graphs.ros1.tcpros import BadHeader, encode_header, encode_message
from hostlink.graphs.ros1.topics import RosPublication, RosPublisher
from hostlink.graphs.ros1.xml_rpc import Unreachable
from hostlink.hub.graph_view import GraphTopic
from hostlink.robot.velocity import TWIST_TYPE, PlanarVelocity
from tests.support.fake_device import message_type
from tests.support.participants import ROBOT, TEXT, TEXT_TYPE, Scene, play, text
from tests.support.ros1.wireless import FakeWire, local_node
from tests.support.virtual_loop import inside

STRING, TWIST = message_type(TEXT_TYPE), message_type(TWIST_TYPE)
HEADER = {"callerid": "/listener", "md5sum": STRING.md5, "type": TEXT_TYPE, "topic": TEXT}


def publication(scene: Scene, *, is_latched: bool = False) -> tuple[RosPublication, Ros1Counts]:
    node, _ = local_node(scene.hub, scene.tasks)
    return RosPublication(node, TEXT, "/ros_text", STRING, is_latched=is_latched), node.counts


@inside(play)
async def test_publication_sends_messages_to_each_subscriber_and_counts_them(scene: Scene) -> None:
    (made, counts), first, second = publication(scene), FakeWire(), FakeWire()
    made.accept(first.wire, HEADER)
    made.accept(second.wire, HEADER | {"callerid": "/other"})
    scene.neighbour.publish(TEXT, text("one"))
    assert first.sent == second.sent == [encode_message(text("one"))]
    assert counts.messages_to_ros == 2
    assert sorted(made.subscribers.values()) == ["/listener", "/other"]
    assert first.headers[0]["md5sum"] == HEADER["md5sum"]
    assert first.headers[0]["message_definition"] == STRING.full_definition
    assert (first.headers[0]["latching"], first.headers[0]["topic"]) == ("0", "/ros_text")
    made.close()


@inside(play)
async def test_publication_leaves_the_hub_with_its_last_subscriber(scene: Scene) -> None:
    (made, counts), first, second = publication(scene), FakeWire(), FakeWire()
    made.accept(first.wire, HEADER)
    made.accept(second.wire, HEADER)
    first.outgoing.dropped = 3
    first.close()
    assert counts.dropped_to_slow_subscribers == 3
    scene.neighbour.publish(TEXT, text("one"))
    assert (len(first.sent), len(second.sent)) == (0, 1)
    second.close()
    assert not [each for each in scene.hub.topics.find(TEXT).subscribers if "ros1" in str(each.key)]


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ({"callerid": "/listener"}, "missing field md5sum"),
        (HEADER | {"md5sum": "0"}, "not 0"),
    ],
)
@inside(play)
async def test_subscriber_with_wrong_header_is_refused(scene: Scene, header: dict[str, str], reason: str) -> None:
    (made, _), wire = publication(scene), FakeWire()
    with pytest.raises(BadHeader, match=reason):
        made.accept(wire.wire, header)
    assert (wire.headers, made.subscribers) == ([], {})


@inside(play)
async def test_subscribers_over_the_bound_are_refused(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topics, "MAX_SUBSCRIBERS", 1)
    (made, _), first, second = publication(scene), FakeWire(), FakeWire()
    made.accept(first.wire, HEADER)
    with pytest.raises(BadHeader, match="more than 1 subscribers of /ros_text"):
        made.accept(second.wire, HEADER)
    assert list(made.subscribers) == [first.wire]
    made.close()


@pytest.mark.parametrize("is_latched", [True, False])
@inside(play)
async def test_later_subscriber_receives_the_latched_message_alone(scene: Scene, is_latched: bool) -> None:
    scene.neighbour.unadvertise(TEXT)
    scene.neighbour.advertise(TEXT, TEXT_TYPE, is_latched=is_latched)
    (made, _), first, second = publication(scene, is_latched=is_latched), FakeWire(), FakeWire()
    made.accept(first.wire, HEADER)
    scene.neighbour.publish(TEXT, text("one"))
    made.accept(second.wire, HEADER)
    assert first.sent == [encode_message(text("one"))]
    assert second.sent == first.sent * is_latched
    made.close()
    assert first.is_closed
    assert second.is_closed


# -- publishers -------------------------------------------------------------------------------------------------------


def velocity_topic(scene: Scene) -> GraphTopic:
    name = scene.hub.robots.find(ROBOT).shown.velocity
    return next(each for each in scene.neighbour.graph().topics if each.name == name)


class Driver:
    """Connection to a node that publishes the velocity of a robot."""

    def __init__(self, scene: Scene, *, is_new: bool) -> None:
        self.node, _ = local_node(scene.hub, scene.tasks)
        self.topic = velocity_topic(scene)
        self.connection = topics._PublisherConnection(self.node, self.topic, topics.Budget(), is_new=is_new)

    def begin(self, *payloads: bytes, **fields: str) -> None:
        header = {"callerid": "/joystick", "type": TWIST_TYPE, "md5sum": TWIST.md5} | fields
        self.connection._begin([encode_header(header)[4:], *payloads])

    def drive(self, *speeds_m_s: float) -> None:
        self.connection.wire.receive([PlanarVelocity(speed).encode() for speed in speeds_m_s])


@inside(play)
async def test_new_publisher_drives_and_only_its_newest_velocity_counts(scene: Scene) -> None:
    driver = Driver(scene, is_new=True)
    driver.begin()
    assert driver.connection.is_accepted
    driver.drive(0.1, 0.2, 0.3)
    await asyncio.sleep(0.05)
    assert [speed for speed in scene.speeds() if speed] == [0.3]
    counts = driver.node.counts
    assert (counts.messages_from_ros, counts.superseded_velocities, counts.refused_messages) == (3, 2, 0)
    driver.connection.wire.close()
    await asyncio.sleep(0.05)
    assert scene.speeds()[-1] == 0.0
    assert not driver.connection.is_accepted


@pytest.mark.parametrize("newest", [PlanarVelocity(math.nan).encode(), b"short"], ids=["not finite", "malformed"])
@inside(play)
async def test_zero_before_a_newer_velocity_is_obeyed_although_that_one_is_refused(scene: Scene, newest: bytes) -> None:
    driver = Driver(scene, is_new=True)
    driver.begin()
    driver.drive(0.3)
    await asyncio.sleep(0.05)
    moving, zero = PlanarVelocity(0.3).encode(), PlanarVelocity(-0.0).encode()
    driver.connection.wire.receive([moving, zero, zero, moving, newest])
    await asyncio.sleep(0.05)
    assert scene.speeds()[-1] == 0.0
    assert driver.node.counts.superseded_velocities == 3
    driver.connection.wire.close()


@inside(play)
async def test_publisher_of_before_whose_zero_is_in_the_same_piece_drives(scene: Scene) -> None:
    scene.hub.robots.find(ROBOT).stop()
    driver = Driver(scene, is_new=False)
    driver.begin()
    driver.drive(0.1, 0.0, 0.2)
    await asyncio.sleep(0.05)
    assert [speed for speed in scene.speeds() if speed] == [0.2]
    driver.connection.wire.close()


@inside(play)
async def test_messages_read_together_with_the_header_are_published(scene: Scene) -> None:
    driver = Driver(scene, is_new=True)
    driver.begin(PlanarVelocity(0.1).encode(), PlanarVelocity(0.2).encode())
    await asyncio.sleep(0.05)
    assert [speed for speed in scene.speeds() if speed] == [0.2]
    assert driver.node.counts.messages_from_ros == 2
    driver.connection.wire.close()


@inside(play)
async def test_publisher_that_disconnects_before_its_header_is_not_waited_for(scene: Scene) -> None:
    driver = Driver(scene, is_new=True)
    driver.connection.wire.close()
    with pytest.raises(ConnectionResetError, match="closed before its header"):
        await driver.connection.accepted
    await driver.connection.ended
    driver.begin()  # read too late
    assert not driver.connection.is_accepted


@inside(play)
async def test_message_over_the_largest_size_is_counted(scene: Scene) -> None:
    driver = Driver(scene, is_new=True)
    driver.begin()
    assert driver.connection.wire.stream.max_bytes == driver.node.config.max_message_bytes
    driver.connection.wire.stream.too_large = 2
    driver.drive(0.1)
    driver.drive(0.1)
    assert driver.node.counts.too_large_messages == 2
    driver.connection.wire.close()


@pytest.mark.parametrize("latching", ["0", "1"])
@inside(play)
async def test_publisher_that_was_there_before_is_refused_in_the_middle_of_a_motion(
    scene: Scene, latching: str
) -> None:
    scene.hub.robots.find(ROBOT).stop()
    driver = Driver(scene, is_new=False)
    driver.begin(latching=latching)
    driver.drive(0.2)
    await asyncio.sleep(0.05)
    assert 0.2 not in scene.speeds()
    assert driver.node.counts.refused_messages == 1
    driver.connection.wire.close()


@inside(play)
async def test_malformed_message_is_counted_and_not_sent_to_the_robot(scene: Scene) -> None:
    driver = Driver(scene, is_new=True)
    driver.begin()
    driver.connection.wire.receive([bytes(47)])
    driver.connection.wire.receive([bytes(49)])
    assert driver.node.counts.malformed_messages == 2
    assert not any(scene.speeds())
    driver.connection.wire.close()


@pytest.mark.parametrize(("type_name", "payload"), [("std_msgs/Bool", bytes(2)), (TEXT_TYPE, text("a") + b"b")])
def test_payload_of_another_size_than_one_message_is_refused(type_name: str, payload: bytes) -> None:
    with pytest.raises(BadPayload):
        topics._check(payload, message_type(type_name))


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"error": "no such topic"}, "no such topic"),
        ({"type": "lab_msgs/Unknown"}, "unknown type lab_msgs/Unknown"),
        ({"md5sum": "0"}, "publishes geometry_msgs/Twist with md5 0"),
    ],
)
@inside(play)
async def test_publisher_with_wrong_header_is_refused(scene: Scene, fields: dict[str, str], reason: str) -> None:
    driver = Driver(scene, is_new=True)
    driver.begin(**fields)
    with pytest.raises(topics.BadHeader, match=reason):
        await driver.connection.accepted
    assert driver.connection.participant is None
    driver.connection.wire.close()


@pytest.mark.parametrize("found", [["UDPROS", "there", 1], ["TCPROS", "there", 0], ["TCPROS", "there", 65536], 5])
@inside(play)
async def test_publisher_without_tcpros_address_is_refused(scene: Scene, found: object) -> None:
    node, rpc = local_node(scene.hub, scene.tasks)
    rpc.answer = lambda _uri, _method: found
    publisher = RosPublisher(node, velocity_topic(scene), "/cmd_vel", "http://there:2/", is_new=True)
    with pytest.raises(topics.BadHeader, match="TCPROS"):
        await publisher.receive()
    assert not publisher.is_connected


@inside(play)
async def test_first_attempt_of_a_new_publisher_is_new_and_later_ones_are_not(scene: Scene) -> None:
    node, rpc = local_node(scene.hub, scene.tasks)
    publisher = RosPublisher(node, velocity_topic(scene), "/cmd_vel", "http://there:2/", is_new=True)
    assert publisher._new_until_s > asyncio.get_running_loop().time()
    with pytest.raises(Unreachable):
        await publisher.receive()
    assert publisher._new_until_s == 0.0
    assert [method for _, method, _ in rpc.calls] == ["requestTopic"]
