"""Messages that a newer one may replace: velocities for gated topics and robots, but no zero."""

import base64
import json
from typing import Any

import pytest

from hostlink.api.clients import VelocityOf, velocity_of_payload
from hostlink.api.rosbridge import Request, velocity_of_request
from hostlink.hub.topic import DeviceSubscription
from hostlink.hub.topic_graph import TopicGraph
from hostlink.robot.velocity import TWIST_TYPE, ZERO, PlanarVelocity
from tests.support.fake_device import CATALOG

TOPIC = "/robot_0/cmd_vel"
MOVING = PlanarVelocity(x_m_s=0.2).encode()


def read(fields: dict[str, Any]) -> Request:
    return Request(json.dumps(fields))


def topics() -> TopicGraph:
    graph = TopicGraph(CATALOG)
    for name, is_gate in ((TOPIC, True), ("/plan", False)):
        graph.subscribe_device(name, "key", DeviceSubscription(lambda _: None, is_gate=is_gate), type_name=TWIST_TYPE)
    return graph


@pytest.mark.parametrize(
    ("fields", "is_zero"),
    [
        ({"msg": {"linear": {"x": 0.2}}}, False),
        ({"msg": {"linear": {"x": 0}, "angular": {"z": -0.0}}}, True),
        ({"msg": {}}, True),
        ({"msg": {"header": {}, "twist": {"angular": {"z": 1}}}}, False),
        ({"msg": {"header": {}, "twist": {}}}, True),
        ({"raw": base64.b64encode(MOVING).decode()}, False),
        ({"raw": base64.b64encode(bytes(20) + ZERO.encode()).decode()}, True),
    ],
)
def test_message_on_a_velocity_topic_is_a_velocity(fields: dict[str, Any], is_zero: bool) -> None:
    request = read({"op": "publish", "topic": TOPIC[1:], "priority": 60} | fields)
    assert velocity_of_request(request, topics()) == (VelocityOf("publish", TOPIC, (60, None, False)), is_zero)


@pytest.mark.parametrize(
    "fields",
    [
        {"op": "publish", "topic": "/plan", "msg": {}},
        {"op": "publish", "topic": "/unknown", "msg": {}},
        {"op": "publish", "topic": TOPIC, "msg": 3},
        {"op": "publish", "topic": TOPIC, "msg": {"linear": [1]}},
        {"op": "publish", "topic": TOPIC, "msg": {"linear": {"x": "fast"}}},
        {"op": "publish", "topic": TOPIC, "msg": {"linear": {"x": True}}},
        {"op": "publish", "topic": TOPIC, "msg": {"twist": 1}},
        {"op": "publish", "topic": TOPIC, "raw": "?"},
        {"op": "publish", "topic": TOPIC, "raw": "AAAA"},
        {"op": "publish", "topic": TOPIC, "msg": {}, "priority": [1]},
        {"op": "publish", "topic": TOPIC, "msg": {}, "priority": True},
        {"op": "publish", "topic": TOPIC, "msg": {}, "type": [1]},
        {"op": "drive", "robot": 7, "linear": 1, "angular": 1},
        {"op": "drive", "robot": "robot_0", "linear": "1", "angular": 1},
        {"op": "drive", "robot": "robot_0", "linear": 1, "angular": 1, "priority": True},
        {"op": "drive", "robot": "robot_0", "linear": 1, "angular": 1, "sent_s": "now"},
        {"op": "drive", "robot": "robot_0", "linear": 1, "angular": 1, "speed": 1},
        {"op": "subscribe", "topic": TOPIC},
    ],
)
def test_invalid_velocity_is_never_replaced(fields: dict[str, Any]) -> None:
    assert velocity_of_request(read(fields), topics()) == (None, False)


def test_drive_is_a_velocity_of_its_robot() -> None:
    drive = {"op": "drive", "robot": "/robot_0", "linear": 0, "angular": 0.0}
    of = VelocityOf("drive", "robot_0", (50, None, None, None, False))
    assert velocity_of_request(read(drive), topics()) == (of, True)
    assert velocity_of_request(read(drive | {"linear_y": 0.1}), topics()) == (of, False)


@pytest.mark.parametrize("terms", [{"priority": 60}, {"epoch": 1}, {"stops": 1}, {"link": 1}, {"sent_s": 0.0}])
def test_drive_with_other_terms_is_another_velocity(terms: dict[str, Any]) -> None:
    drive = {"op": "drive", "robot": "robot_0", "linear": 0.1, "angular": 0.0}
    assert velocity_of_request(read(drive | terms), topics()) != velocity_of_request(read(drive), topics())


@pytest.mark.parametrize("terms", [{"priority": 60}, {"type": TWIST_TYPE}, {"latch": True}])
def test_message_with_other_terms_is_another_velocity(terms: dict[str, Any]) -> None:
    message: dict[str, Any] = {"op": "publish", "topic": TOPIC, "msg": {}}
    assert velocity_of_request(read(message | terms), topics()) != velocity_of_request(read(message), topics())


def test_serialised_velocity_counts_only_on_a_velocity_topic() -> None:
    assert velocity_of_payload(TOPIC, MOVING, topics()) == (VelocityOf("publish", TOPIC), False)
    assert velocity_of_payload(TOPIC, ZERO.encode(), topics()) == (VelocityOf("publish", TOPIC), True)
    assert velocity_of_payload(TOPIC, b"short", topics()) == (None, False)
    assert velocity_of_payload("/plan", MOVING, topics()) == (None, False)
