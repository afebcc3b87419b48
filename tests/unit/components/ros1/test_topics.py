"""Topics of the hub for ROS nodes, and their velocities for robots, without sockets."""

import asyncio
import math

import pytest

from hostlink.components.ros1 import topics
from hostlink.components.ros1.tcpros import BadHeader, encode_header, encode_message
from hostlink.components.ros1.topics import RosPublication, RosPublisher
from hostlink.components.ros1.xml_rpc import Unreachable
from hostlink.core.hub.graph_view import GraphTopic
from hostlink.core.robot.velocity import TWIST_TYPE, PlanarVelocity
from hostlink.errors import BadPayload
from tests.support.fake_device import CATALOG
from tests.support.participants import ROBOT, TEXT, TEXT_TYPE, Scene, play
from tests.support.ros1.wireless import FakeWire, local_node

STRING, TWIST = CATALOG.message(TEXT_TYPE), CATALOG.message(TWIST_TYPE)
assert STRING is not None
assert TWIST is not None
HEADER = {"callerid": "/listener", "md5sum": STRING.md5, "type": TEXT_TYPE, "topic": TEXT}


def text(value: str) -> bytes:
    assert STRING is not None
    return STRING.encode({"data": value})


def publication(scene: Scene, *, is_latched: bool = False) -> RosPublication:
    assert STRING is not None
    node, _ = local_node(scene.hub, scene.tasks)
    return RosPublication(node, TEXT, "/ros_text", STRING, is_latched=is_latched)


def test_publication_sends_messages_to_each_subscriber_and_counts_them() -> None:
    async def test(scene: Scene) -> None:
        made, first, second = publication(scene), FakeWire(), FakeWire()
        made.accept(first.wire, HEADER)
        made.accept(second.wire, HEADER | {"callerid": "/other"})
        scene.neighbour.publish(TEXT, text("one"))
        assert first.sent == second.sent == [encode_message(text("one"))]
        assert made._node.counts.messages_to_ros == 2
        assert sorted(made.subscribers.values()) == ["/listener", "/other"]
        assert STRING is not None
        assert first.headers[0]["md5sum"] == HEADER["md5sum"]
        assert first.headers[0]["message_definition"] == STRING.full_definition
        assert (first.headers[0]["latching"], first.headers[0]["topic"]) == ("0", "/ros_text")
        made.close()

    play(test)


def test_publication_leaves_the_hub_with_its_last_subscriber() -> None:
    async def test(scene: Scene) -> None:
        made, first, second = publication(scene), FakeWire(), FakeWire()
        made.accept(first.wire, HEADER)
        made.accept(second.wire, HEADER)
        first.outgoing.dropped = 3
        first.close()
        assert made._node.counts.dropped_to_slow_subscribers == 3
        scene.neighbour.publish(TEXT, text("one"))
        assert (len(first.sent), len(second.sent)) == (0, 1)
        second.close()
        assert not [each for each in scene.hub.topics.find(TEXT).subscribers if "ros1" in str(each.key)]

    play(test)


@pytest.mark.parametrize(
    ("header", "reason"),
    [
        ({"callerid": "/listener"}, "missing field md5sum"),
        (HEADER | {"md5sum": "0"}, "not 0"),
    ],
)
def test_subscriber_with_wrong_header_is_refused(header: dict[str, str], reason: str) -> None:
    async def test(scene: Scene) -> None:
        made, wire = publication(scene), FakeWire()
        with pytest.raises(BadHeader, match=reason):
            made.accept(wire.wire, header)
        assert (wire.headers, made.subscribers) == ([], {})

    play(test)


def test_subscribers_over_the_bound_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topics, "MAX_SUBSCRIBERS", 1)

    async def test(scene: Scene) -> None:
        made, first, second = publication(scene), FakeWire(), FakeWire()
        made.accept(first.wire, HEADER)
        with pytest.raises(BadHeader, match="more than 1 subscribers of /ros_text"):
            made.accept(second.wire, HEADER)
        assert list(made.subscribers) == [first.wire]
        made.close()

    play(test)


@pytest.mark.parametrize("is_latched", [True, False])
def test_later_subscriber_receives_the_latched_message_alone(is_latched: bool) -> None:
    async def test(scene: Scene) -> None:
        scene.neighbour.unadvertise(TEXT)
        scene.neighbour.advertise(TEXT, TEXT_TYPE, is_latched=is_latched)
        made, first, second = publication(scene, is_latched=is_latched), FakeWire(), FakeWire()
        made.accept(first.wire, HEADER)
        scene.neighbour.publish(TEXT, text("one"))
        made.accept(second.wire, HEADER)
        assert first.sent == [encode_message(text("one"))]
        assert second.sent == first.sent * is_latched
        made.close()
        assert first.is_closed
        assert second.is_closed

    play(test)


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
        assert TWIST is not None
        header = {"callerid": "/joystick", "type": TWIST_TYPE, "md5sum": TWIST.md5} | fields
        self.connection._begin([encode_header(header)[4:], *payloads])

    def drive(self, *speeds_m_s: float) -> None:
        self.connection.wire.receive([PlanarVelocity(speed).encode() for speed in speeds_m_s])


def test_new_publisher_drives_and_only_its_newest_velocity_counts() -> None:
    async def test(scene: Scene) -> None:
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

    play(test)


def test_velocities_that_come_together_after_a_stop_and_a_gap_of_the_network_move_no_robot() -> None:
    async def test(scene: Scene) -> None:
        driver = Driver(scene, is_new=True)
        driver.begin()
        driver.drive(0.1)
        await asyncio.sleep(0.1)
        scene.hub.robots.find(ROBOT).stop()
        await asyncio.sleep(0.6)
        driver.connection.wire._reader.came_s = asyncio.get_running_loop().time()
        driver.drive(0.1, 0.2, 0.3)
        await asyncio.sleep(0.05)
        assert scene.speeds()[-1] == 0.0
        assert driver.node.counts.superseded_velocities == 1
        assert driver.node.counts.refused_messages == 1
        driver.connection.wire.close()

    play(test)


@pytest.mark.parametrize("newest", [PlanarVelocity(math.nan).encode(), b"short"], ids=["not finite", "malformed"])
def test_zero_before_a_newer_velocity_is_obeyed_although_that_one_is_refused(newest: bytes) -> None:
    async def test(scene: Scene) -> None:
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

    play(test)


def test_publisher_of_before_whose_zero_is_in_the_same_piece_drives() -> None:
    async def test(scene: Scene) -> None:
        scene.hub.robots.find(ROBOT).stop()
        driver = Driver(scene, is_new=False)
        driver.begin()
        driver.drive(0.1, 0.0, 0.2)
        await asyncio.sleep(0.05)
        assert [speed for speed in scene.speeds() if speed] == [0.2]
        driver.connection.wire.close()

    play(test)


def test_messages_read_together_with_the_header_are_published() -> None:
    async def test(scene: Scene) -> None:
        driver = Driver(scene, is_new=True)
        driver.begin(PlanarVelocity(0.1).encode(), PlanarVelocity(0.2).encode())
        await asyncio.sleep(0.05)
        assert [speed for speed in scene.speeds() if speed] == [0.2]
        assert driver.node.counts.messages_from_ros == 2
        driver.connection.wire.close()

    play(test)


def test_publisher_that_disconnects_before_its_header_is_not_waited_for() -> None:
    async def test(scene: Scene) -> None:
        driver = Driver(scene, is_new=True)
        driver.connection.wire.close()
        with pytest.raises(ConnectionResetError, match="closed before its header"):
            await driver.connection.accepted
        await driver.connection.ended
        driver.begin()  # read too late
        assert not driver.connection.is_accepted

    play(test)


def test_message_over_the_largest_size_is_counted() -> None:
    async def test(scene: Scene) -> None:
        driver = Driver(scene, is_new=True)
        driver.begin()
        assert driver.connection.wire.stream.max_bytes == driver.node.config.max_message_bytes
        driver.connection.wire.stream.too_large = 2
        driver.drive(0.1)
        driver.drive(0.1)
        assert driver.node.counts.too_large_messages == 2
        driver.connection.wire.close()

    play(test)


@pytest.mark.parametrize("latching", ["0", "1"])
def test_publisher_that_was_there_before_is_refused_in_the_middle_of_a_motion(latching: str) -> None:
    async def test(scene: Scene) -> None:
        scene.hub.robots.find(ROBOT).stop()
        driver = Driver(scene, is_new=False)
        driver.begin(latching=latching)
        driver.drive(0.2)
        await asyncio.sleep(0.05)
        assert 0.2 not in scene.speeds()
        assert driver.node.counts.refused_messages == 1
        driver.connection.wire.close()

    play(test)


def test_malformed_message_is_counted_and_not_sent_to_the_robot() -> None:
    async def test(scene: Scene) -> None:
        driver = Driver(scene, is_new=True)
        driver.begin()
        driver.connection.wire.receive([bytes(47)])
        driver.connection.wire.receive([bytes(49)])
        assert driver.node.counts.malformed_messages == 2
        assert not any(scene.speeds())
        driver.connection.wire.close()

    play(test)


@pytest.mark.parametrize(("type_name", "payload"), [("std_msgs/Bool", bytes(2)), (TEXT_TYPE, text("a") + b"b")])
def test_payload_of_another_size_than_one_message_is_refused(type_name: str, payload: bytes) -> None:
    type_ = CATALOG.message(type_name)
    assert type_ is not None
    with pytest.raises(BadPayload):
        topics._check(payload, type_)


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"error": "no such topic"}, "no such topic"),
        ({"type": "lab_msgs/Unknown"}, "unknown type lab_msgs/Unknown"),
        ({"md5sum": "0"}, "publishes geometry_msgs/Twist with md5 0"),
    ],
)
def test_publisher_with_wrong_header_is_refused(fields: dict[str, str], reason: str) -> None:
    async def test(scene: Scene) -> None:
        driver = Driver(scene, is_new=True)
        driver.begin(**fields)
        with pytest.raises(topics.BadHeader, match=reason):
            await driver.connection.accepted
        assert driver.connection.participant is None
        driver.connection.wire.close()

    play(test)


@pytest.mark.parametrize("found", [["UDPROS", "there", 1], ["TCPROS", "there", 0], ["TCPROS", "there", 65536], 5])
def test_publisher_without_tcpros_address_is_refused(found: object) -> None:
    async def test(scene: Scene) -> None:
        node, rpc = local_node(scene.hub, scene.tasks)
        rpc.answer = lambda _uri, _method: found
        publisher = RosPublisher(node, velocity_topic(scene), "/cmd_vel", "http://there:2/", is_new=True)
        with pytest.raises(topics.BadHeader, match="TCPROS"):
            await publisher.receive()
        assert not publisher.is_connected

    play(test)


def test_new_publisher_that_is_connected_late_is_not_new(monkeypatch: pytest.MonkeyPatch) -> None:
    """A publisher that waited for room may be in the middle of a motion."""
    made: list[bool] = []

    def refuse(*_: object, is_new: bool) -> None:
        made.append(is_new)
        raise ConnectionRefusedError

    async def test(scene: Scene) -> None:
        for wait_s in (0.0, topics.NEW_S):
            node, rpc = local_node(scene.hub, scene.tasks)
            rpc.answer = lambda *_: ["TCPROS", "there", 2]
            publisher = RosPublisher(node, velocity_topic(scene), "/cmd_vel", "http://there:2/", is_new=True)
            await asyncio.sleep(wait_s)
            with pytest.raises(ConnectionRefusedError):
                await publisher.receive()
        assert made == [True, False]

    monkeypatch.setattr(topics, "_PublisherConnection", refuse)
    play(test)


def test_first_attempt_of_a_new_publisher_is_new_and_later_ones_are_not() -> None:
    async def test(scene: Scene) -> None:
        node, rpc = local_node(scene.hub, scene.tasks)
        publisher = RosPublisher(node, velocity_topic(scene), "/cmd_vel", "http://there:2/", is_new=True)
        assert publisher._new_until_s > asyncio.get_running_loop().time()
        with pytest.raises(Unreachable):
            await publisher.receive()
        assert publisher._new_until_s == 0.0
        assert [method for _, method, _ in rpc.calls] == ["requestTopic"]

    play(test)
