"""Sketches written for ros_lib, the field's usual tutorials, unchanged with this library and a real daemon."""

import asyncio
import itertools
import math
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from typing import Any, NamedTuple

import pytest

from hostlink import client
from hostlink.core.config import Config
from tests.firmware.sketches import MOVED, Board, build, running
from tests.support.client_topics import publish_until, received
from tests.support.daemon import daemon

Message = dict[str, Any]
EMPTY, BOOL, STRING = "std_msgs/Empty", "std_msgs/Bool", "std_msgs/String"
SERVICE = "rosserial_arduino/Test"


class Host(NamedTuple):
    """Client of the daemon, and a function that runs a sketch on it."""

    client: client.Host
    run: Callable[[str], AbstractAsyncContextManager[Board]]


@pytest.fixture(scope="module", autouse=True)
def _built() -> None:
    """Before the time limit of the first test starts."""
    build("ros_lib/pubsub")


@pytest.fixture
async def host() -> AsyncIterator[Host]:
    parameters = {"/pid": [1.0, 2.0, 3.0]}
    async with daemon(Config(parameters=parameters)) as started, client.connect(started.url) as connected:
        yield Host(connected, lambda name: running(f"ros_lib/{name}", started.tcp))


class Said(NamedTuple):
    """A sketch's messages for given inputs."""

    name: str
    topic: str
    type_name: str
    inputs: list[str]
    is_so: Callable[[Message], object]


def near(value: Any, wanted: float) -> bool:
    return value is not None and math.isclose(value, wanted, abs_tol=1e-3)


def now(stamp: Message) -> bool:
    return abs(stamp["secs"] + stamp["nsecs"] * 1e-9 - time.time()) < 5.0


def transform(child: str, is_so: Callable[[Message], object]) -> Callable[[Message], object]:
    def check(message: Message) -> bool:
        (only,) = message["transforms"]
        return only["child_frame_id"] == child and now(only["header"]["stamp"]) and bool(is_so(only["transform"]))

    return check


SAID = [
    Said("hello_world", "/chatter", STRING, [], lambda sent: sent["data"] == "hello world!"),
    Said("tcp_hello_world", "/chatter", STRING, [], lambda sent: sent["data"] == "hello world!"),
    Said("odom", "/tf", "tf/tfMessage", [], transform("/base_link", lambda to: to["translation"]["y"] > 0.1)),
    Said("time_tf", "/tf", "tf/tfMessage", [], transform("/base_link", lambda to: to["rotation"]["w"] == 1.0)),
    Said("time", "/my_time", "std_msgs/Time", [], lambda sent: now(sent["data"])),
    Said(
        "joint_states",
        "/joint_states",
        "sensor_msgs/JointState",
        [],
        lambda sent: (
            (sent["name"], sent["position"], sent["velocity"]) == (["shoulder", "elbow"], [0.5, 1.5], [0, 0.25])
        ),
    ),
    Said("logging", "/rosout", "rosgraph_msgs/Log", [], lambda sent: sent["msg"] == "fatalities"),
    Said("parameters", "/gain", "std_msgs/Float32", [], lambda sent: sent["data"] == 3.0),
    Said("button", "/pushed", BOOL, ["digital 7 0"], lambda sent: sent["data"]),
    Said("adc", "/adc", "rosserial_arduino/Adc", ["analog 3 77"], lambda sent: sent["adc3"] == 77),
    Said("ultrasound", "/ultrasound", "sensor_msgs/Range", ["analog 0 100"], lambda sent: near(sent["range"], 1.2402)),
    Said("ir_ranger", "/range_data", "sensor_msgs/Range", ["analog 0 400"], lambda sent: near(sent["range"], 0.13495)),
    Said(
        "temperature",
        "/temperature",
        "std_msgs/Float32",
        [f"register {number} 25" for number in range(0, 256, 2)],
        lambda sent: sent["data"] == 25.0,
    ),
    Said("clapper", "/clap", EMPTY, ["analog 0 900"], lambda _: True),
]


@pytest.mark.parametrize("said", SAID, ids=lambda said: said.name)
async def test_sketch_publishes_its_messages(host: Host, said: Said) -> None:
    async with host.run(said.name) as board, asyncio.TaskGroup() as tasks:
        received_one = tasks.create_task(received(host.client, said.topic, said.type_name, said.is_so))
        for lines in itertools.cycle([said.inputs, [released(line) for line in said.inputs]]):
            for line in lines:
                board.set(line)
            await asyncio.wait([received_one], timeout=0.2)
            if received_one.done():
                break


def released(line: str) -> str:
    """A button and a clap are published once each time."""
    return f"{line.rpartition(' ')[0]} {1 if line.startswith('digital') else 0}"


class Told(NamedTuple):
    """Reaction of a sketch to a message."""

    name: str
    topic: str
    type_name: str
    message: Message
    output: str


TOLD = [
    Told("blink", "/toggle_led", EMPTY, {}, "digital 13 1"),
    Told("class_blink", "/set_led", BOOL, {"data": True}, "digital 12 1"),
    Told("pubsub", "/toggle_led", EMPTY, {}, "digital 13 1"),
    Told("servo", "/servo", "std_msgs/UInt16", {"data": 45}, "servo 9 45"),
]


@pytest.mark.parametrize("told", TOLD, ids=lambda told: told.name)
async def test_sketch_reacts_to_a_message(host: Host, told: Told) -> None:
    async with host.run(told.name) as board:
        await publish_until(host.client, told.topic, told.message, told.type_name, board.expect(told.output))


@pytest.mark.parametrize(
    ("name", "topic", "type_name", "message", "answer", "is_so"),
    [
        (
            "array_test",
            "/poses",
            "geometry_msgs/PoseArray",
            {"poses": [{"position": {"x": 1.5}}, {"position": {"x": 2.0}}]},
            ("/sum", "geometry_msgs/Pose"),
            lambda sent: sent["position"]["x"] == 3.5,
        ),
        (
            "float64_test",
            "/your_topic",
            "std_msgs/Float64",
            {"data": 3.5},
            ("/my_topic", "std_msgs/Float64"),
            lambda sent: sent["data"] == 2.5,
        ),
        (
            "trajectory",
            "/numbers",
            "std_msgs/Float64MultiArray",
            {"data": [0.5, 1.5, -4.0]},
            ("/answer", "std_msgs/Float32MultiArray"),
            lambda sent: sent["data"] == [1.0, -2.0] and sent["layout"]["dim"][0]["label"] == "height",
        ),
    ],
    ids=["array_test", "float64_test", "trajectory"],
)
async def test_sketch_answers_a_call(
    host: Host,
    name: str,
    topic: str,
    type_name: str,
    message: Message,
    answer: tuple[str, str],
    is_so: Callable[[Message], object],
) -> None:
    async with host.run(name):
        await publish_until(host.client, topic, message, type_name, received(host.client, *answer, is_so))


async def test_a_service_of_a_sketch(host: Host) -> None:
    async with host.run("service_server"):
        await received(host.client, "/chatter", STRING)
        answers = [await host.client.call("/test_srv", {"input": "x"}) for _ in range(2)]
        assert answers == [{"output": "world"}, {"output": "hello"}]


async def test_a_sketch_that_waits_for_a_service(host: Host) -> None:
    async def answer(request: Message) -> Message:
        return {"output": request["input"].upper()}

    async with host.client.serve("/test_srv", SERVICE, answer), host.run("service_client"):
        await received(host.client, "/chatter", STRING, lambda sent: sent["data"] == "HELLO WORLD!")


def test_every_sketch_is_run() -> None:
    run = {each.name for each in SAID} | {each.name for each in TOLD}
    others = {"array_test", "float64_test", "trajectory", "service_server", "service_client"}
    assert {path.stem for path in MOVED.glob("*.ino")} == run | others
