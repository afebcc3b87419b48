"""Messages that a newer one may replace: velocities for gated topics and robots, but no zero."""

import base64
import json
from typing import Any

import pytest

from hostlink.components.gateway.clients import VelocityOf, velocity_of_payload
from hostlink.components.gateway.rosbridge import Request, velocity_of_request
from hostlink.core.config import Config
from hostlink.core.hub.hub import Hub
from hostlink.core.hub.node_graph import NodeGraph
from hostlink.core.hub.topic import DeviceSubscription
from hostlink.core.robot.velocity import TWIST_STAMPED_TYPE, TWIST_TYPE, ZERO, PlanarVelocity
from tests.support.fake_device import CATALOG

TOPIC, STAMPED = "/robot_0/cmd_vel", "/robot_0/cmd_vel_stamped"
MOVING = PlanarVelocity(x_m_s=0.2).encode()


def read(fields: dict[str, Any]) -> Request:
    return Request(json.dumps(fields))


def topics() -> NodeGraph:
    hub = Hub(Config(), CATALOG)
    for name, type_name in ((TOPIC, TWIST_TYPE), (STAMPED, TWIST_STAMPED_TYPE), ("/plan", TWIST_TYPE)):
        gate = DeviceSubscription(lambda _: None, is_gate=name != "/plan")
        hub.topics.subscribe_device(name, "key", gate, type_name=type_name)
    return NodeGraph(hub)


@pytest.mark.parametrize(
    ("topic", "fields", "is_zero"),
    [
        (TOPIC, {"msg": {"linear": {"x": 0.2}}}, False),
        (TOPIC, {"msg": {"linear": {"x": 0}, "angular": {"z": -0.0}}}, True),
        (TOPIC, {"msg": {}}, True),
        (STAMPED, {"msg": {"header": {}, "twist": {"angular": {"z": 1}}}}, False),
        (STAMPED, {"msg": {"header": {}, "twist": {}}}, True),
        (TOPIC, {"raw": base64.b64encode(MOVING).decode()}, False),
        (STAMPED, {"raw": base64.b64encode(bytes(16) + ZERO.encode()).decode()}, True),
    ],
)
def test_message_on_a_velocity_topic_is_a_velocity(topic: str, fields: dict[str, Any], is_zero: bool) -> None:
    request = read({"op": "publish", "topic": topic[1:], "priority": 60} | fields)
    terms = (60, None, False), (True, True, False)
    assert velocity_of_request(request, topics()) == (VelocityOf("publish", topic, terms), is_zero)


@pytest.mark.parametrize(
    "fields",
    [
        {"op": "publish", "topic": "/plan", "msg": {}},
        {"op": "publish", "topic": "/unknown", "msg": {}},
        {"op": "publish", "topic": TOPIC, "msg": 3},
        {"op": "publish", "topic": TOPIC, "msg": {"linear": [1]}},
        {"op": "publish", "topic": TOPIC, "msg": {"linear": {"x": "fast"}}},
        {"op": "publish", "topic": TOPIC, "msg": {"linear": {"x": True}}},
        {"op": "publish", "topic": TOPIC, "msg": {"twist": {}}},
        {"op": "publish", "topic": TOPIC, "msg": {"linear": {"speed": 0}}},
        {"op": "publish", "topic": STAMPED, "msg": {"linear": {}}},
        {"op": "publish", "topic": STAMPED, "raw": base64.b64encode(MOVING).decode()},
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
    of = VelocityOf("drive", "robot_0", (50, None, None, None, False, False, True, False))
    assert velocity_of_request(read(drive), topics()) == (of, True)
    assert velocity_of_request(read(drive | {"linear": 0.1}), topics()) == (of, False)
    assert not velocity_of_request(read(drive | {"is_planar": False}), topics())[1]


@pytest.mark.parametrize(
    "terms",
    [
        {"priority": 60},
        {"take_over": True},
        {"epoch": 1},
        {"stops": 1},
        {"link": 1},
        {"sent_s": 0.0},
        {"linear_y": 0.1},
        {"is_planar": False},
    ],
)
def test_drive_with_other_terms_is_another_velocity(terms: dict[str, Any]) -> None:
    drive = {"op": "drive", "robot": "robot_0", "linear": 0.1, "angular": 0.0}
    assert velocity_of_request(read(drive | terms), topics()) != velocity_of_request(read(drive), topics())


@pytest.mark.parametrize("terms", [{"priority": 60}, {"type": TWIST_TYPE}, {"latch": True}])
def test_message_with_other_terms_is_another_velocity(terms: dict[str, Any]) -> None:
    message: dict[str, Any] = {"op": "publish", "topic": TOPIC, "msg": {}}
    assert velocity_of_request(read(message | terms), topics()) != velocity_of_request(read(message), topics())


@pytest.mark.parametrize("linear", [{"y": 0.1}, {"z": 0.1}, {"x": None}])
def test_message_that_a_robot_may_refuse_is_another_velocity(linear: dict[str, Any]) -> None:
    usual, other = ({"op": "publish", "topic": TOPIC, "msg": {"linear": each}} for each in ({"x": 0.1}, linear))
    assert velocity_of_request(read(other), topics()) != velocity_of_request(read(usual), topics())


def test_serialised_velocity_counts_only_on_a_velocity_topic() -> None:
    graph, of = topics(), VelocityOf("publish", TOPIC, (None, (True, True, False)))
    assert velocity_of_payload(graph.velocity_topic(TOPIC), MOVING) == (of, False)
    assert velocity_of_payload(graph.velocity_topic(TOPIC), ZERO.encode()) == (of, True)
    assert velocity_of_payload(graph.velocity_topic(TOPIC), b"short") == (None, False)
    assert velocity_of_payload(graph.velocity_topic("/plan"), MOVING) == (None, False)
    assert velocity_of_payload(None, MOVING) == (None, False)
