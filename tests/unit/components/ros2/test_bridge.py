"""Bridge between the daemon and ROS 2 without rclpy: which routes run, and what they carry."""

import asyncio
import contextlib
import struct
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from hostlink.client import RawMessage
from hostlink.components.gateway.rosapi import describe
from hostlink.components.graphs.ros2_qos import COMMANDS, Qos
from hostlink.components.ros2.bridge import FIRST_RETRY_S, Bridge, write_line
from hostlink.components.ros2.plan import Ros2Graph, Ros2Publisher, publisher_qos
from hostlink.components.ros2.velocity import Sent
from hostlink.errors import HostlinkError
from tests.support.fake_device import CATALOG
from tests.support.virtual_loop import run_virtual

NOTE = "/robot_0/note"
MISSING = "nobody_srvs/Missing"  # a type that is not installed
ROBOT = {"name": "robot_0", "velocity_topics": {"/robot_0/cmd_vel": "geometry_msgs/Twist"}}
TRIGGER = {"name": "/robot_0/reset", "type": "std_srvs/Trigger"}


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> SimpleNamespace:
    return SimpleNamespace(x=x, y=y, z=z)


class Trigger:
    """Service type as rclpy has it."""

    class Request:
        def get_fields_and_field_types(self) -> dict[str, str]:
            return {}

    class Response:
        def __init__(self) -> None:
            self.success, self.message = False, ""

        def get_fields_and_field_types(self) -> dict[str, str]:
            return {"success": "boolean", "message": "string"}


class Text:
    """std_msgs/String as rclpy has it."""

    @staticmethod
    def get_fields_and_field_types() -> dict[str, str]:
        return {"data": "string"}


def text(data: bytes) -> bytes:
    """Payload of a std_msgs/String in ROS 1."""
    return struct.pack("<I", len(data)) + data


def text_cdr(data: bytes) -> bytes:
    """Payload of a std_msgs/String in CDR, where a string ends with a zero."""
    return b"\0\1\0\0" + struct.pack("<I", len(data) + 1) + data + b"\0"


class Stream:
    """Stream of the client: the newest values, which a test sends."""

    def __init__(self, *values: Any) -> None:
        self._queue: asyncio.Queue[Any] = asyncio.Queue()
        for value in values:
            self.send(value)

    def send(self, value: Any) -> None:
        self._queue.put_nowait(value)

    def pop_all(self) -> list[Any]:
        return [self._queue.get_nowait() for _ in range(self._queue.qsize())]

    def __aiter__(self) -> "Stream":
        return self

    async def __anext__(self) -> Any:
        return await self._queue.get()


class FakeHost:
    """Connection to a daemon."""

    url = "http://robots:9090"

    def __init__(self) -> None:
        self.is_connected = True
        self.graphs, self.changes, self.lines = Stream(), Stream(), Stream()
        self.served: dict[str, Callable[[Mapping[str, Any]], Awaitable[Mapping[str, Any]]]] = {}
        self.calls: list[tuple[str, Mapping[str, Any]]] = []
        self.raw: dict[str, Stream] = {}
        self.advertised: dict[str, bool] = {}
        self.published: list[tuple[str, bytes, str]] = []

    async def watch_graph(self) -> Stream:
        return self.graphs

    def connection(self) -> Stream:
        return self.changes

    async def call(self, service: str, request: Mapping[str, Any], **_: Any) -> Mapping[str, Any]:
        if service == "/rosapi/get_param":
            return {"value": "{}"}
        if service == "/rosapi/message_details":
            found = CATALOG.message(request["type"])
            return {"typedefs": [] if found is None else describe(found)}
        self.calls.append((service, request))
        if service == "/robot_0/fail":
            raise HostlinkError("the robot is locked")
        return {"success": True, "message": "reset"}

    @contextlib.asynccontextmanager
    async def subscribe(self, _topic: str, **_: Any) -> AsyncIterator[Stream]:
        yield self.lines

    @contextlib.asynccontextmanager
    async def subscribe_raw(self, topic: str, **_: Any) -> AsyncIterator[Stream]:
        self.raw[topic] = Stream()
        try:
            yield self.raw[topic]
        finally:
            del self.raw[topic]

    @contextlib.asynccontextmanager
    async def advertise(self, topic: str, _type: str, *, is_latched: bool) -> AsyncIterator[None]:
        self.advertised[topic] = is_latched
        try:
            yield
        finally:
            del self.advertised[topic]

    async def publish_raw(self, topic: str, payload: bytes, *, type_name: str) -> None:
        self.published.append((topic, payload, type_name))

    @contextlib.asynccontextmanager
    async def serve(self, service: str, _type: str, answer: Any) -> AsyncIterator[None]:
        self.served[service] = answer
        try:
            yield
        finally:
            del self.served[service]


class FakeNode:
    """Node of ROS 2, with the ends that the bridge has made."""

    def __init__(self) -> None:
        self.ros2 = Ros2Graph()
        self.lines: list[tuple[str, str]] = []
        self.publishers: dict[str, tuple[Qos, list[bytes]]] = {}
        self.subscriptions: dict[str, Callable[..., None]] = {}
        self.qos: dict[str, tuple[Qos, bool]] = {}  # of subscriptions, and whether their messages are bytes
        self.time = b""
        self.services: dict[str, Callable[[Any, Any], Awaitable[Any]]] = {}
        self.clients: set[str] = set()
        self.answer: Any = None  # of a service of ROS 2; None: it does not answer
        levels = ("fatal", "error", "warning", "info", "debug")
        logger = SimpleNamespace(
            **{level: lambda text, level=level: self.lines.append((level, text)) for level in levels}
        )
        self.node = SimpleNamespace(get_logger=lambda: logger)

    def warn(self, text: str) -> None:
        self.lines.append(("warning", text))

    async def graph(self, _topics: Iterable[str]) -> Ros2Graph:
        return self.ros2

    async def watch_parameters(self, accept: Any) -> None:
        del accept

    def post(self, function: Callable[..., None], *arguments: object) -> None:
        function(*arguments)

    def pending(self) -> "asyncio.Future[Any]":
        return asyncio.get_running_loop().create_future()

    def stamp(self) -> bytes:
        return self.time

    @contextlib.asynccontextmanager
    async def publisher(self, topic: str, _cls: Any, qos: Qos) -> AsyncIterator[Any]:
        sent: list[bytes] = []
        self.publishers[topic] = qos, sent
        try:
            yield SimpleNamespace(publish=sent.append)
        finally:
            del self.publishers[topic]

    @contextlib.asynccontextmanager
    async def subscription(
        self, topic: str, _cls: Any, qos: Qos, receive: Callable[..., None], *, is_raw: bool
    ) -> AsyncIterator[None]:
        self.subscriptions[topic], self.qos[topic] = receive, (qos, is_raw)
        try:
            yield
        finally:
            del self.subscriptions[topic]

    @contextlib.asynccontextmanager
    async def service(self, name: str, _cls: Any, answer: Any) -> AsyncIterator[None]:
        self.services[name] = answer
        try:
            yield
        finally:
            del self.services[name]

    @contextlib.asynccontextmanager
    async def client(self, name: str, _cls: Any) -> AsyncIterator[str]:
        self.clients.add(name)
        yield name

    async def call(self, client: str, request: Any) -> Any:
        assert client in self.clients
        assert isinstance(request, Trigger.Request)
        if self.answer is None:
            await asyncio.Event().wait()
        return self.answer


class FakeDriver:
    """Velocities that routes pass on."""

    def __init__(self) -> None:
        self.robots: list[str] = []
        self.received: list[tuple[str, tuple[float, ...], object, Sent]] = []
        self.came_s: list[float] = []

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        yield

    def driving(self, _route: Any) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def update(self, robots: Iterable[str], _keys: object) -> None:
        self.robots = list(robots)

    def receive(self, route: Any, twist: Any, key: object, *, came_s: float, sent: Sent) -> None:
        self.came_s.append(came_s)
        self.received.append((route.robot, tuple(twist), key, sent))


class World:
    """A bridge whose daemon and ROS 2 are those of a test."""

    def __init__(self) -> None:
        self.host, self.node, self.driver, self.reports = FakeHost(), FakeNode(), FakeDriver(), list[str]()
        untyped: Any = (self.host, self.node, self.driver, self.reports.append)
        self.bridge = Bridge(*untyped)

    async def show(
        self, *, services: Iterable[Any] = (), robots: Iterable[Any] = (), topics: Iterable[Any] = ()
    ) -> None:
        self.host.graphs.send({"topics": list(topics), "services": list(services), "robots": list(robots)})
        await asyncio.sleep(0.5)


def bridged(test: Callable[[World], Awaitable[None]]) -> None:
    async def run() -> None:
        world = World()
        async with asyncio.TaskGroup() as tasks:
            running = tasks.create_task(world.bridge.run())
            await asyncio.sleep(0.1)
            try:
                await test(world)
            finally:
                running.cancel()
        assert (world.node.subscriptions, world.node.services, world.host.served) == ({}, {}, {})

    run_virtual(run())


@pytest.fixture(autouse=True)
def _types(monkeypatch: pytest.MonkeyPatch) -> None:
    """The packages of ROS 2 that are installed."""
    twist = SimpleNamespace(Twist=object, TwistStamped=object)
    installed = {
        "geometry_msgs.msg": twist,
        "std_msgs.msg": SimpleNamespace(String=Text),
        "std_srvs.srv": SimpleNamespace(Trigger=Trigger),
    }
    for name, module in installed.items():
        monkeypatch.setitem(sys.modules, name.partition(".")[0], SimpleNamespace())
        monkeypatch.setitem(sys.modules, name, module)


def test_velocity_of_ros_2_reaches_the_driver_while_the_daemon_has_the_robot() -> None:
    async def test(world: World) -> None:
        await world.show(robots=[ROBOT])
        receive = world.node.subscriptions["/robot_0/cmd_vel"]
        assert world.node.qos["/robot_0/cmd_vel"] == (COMMANDS, False)
        receive(SimpleNamespace(linear=vector(0.2), angular=vector(z=-0.5)), {"publication_sequence_number": 1})
        info = {"publisher_gid": {"data": [7, 8]}, "received_timestamp": time.time_ns() - 2 * 10**9}
        info["source_timestamp"] = 5_500_000_000
        receive(SimpleNamespace(linear=vector(y=0.1), angular=vector()), info)
        await asyncio.sleep(0.1)
        fresh, old = world.driver.came_s
        assert 1.9 < fresh - old < 3.0
        assert world.driver.received == [
            ("robot_0", (0.2, 0.0, 0.0, 0.0, 0.0, -0.5), "/robot_0/cmd_vel", Sent(None, 1)),
            ("robot_0", (0.0, 0.1, 0.0, 0.0, 0.0, 0.0), b"\7\b", Sent(5.5, None)),
        ]
        assert world.driver.robots == ["robot_0"]
        await world.show()
        assert world.node.subscriptions == {}
        assert world.driver.robots == []

    bridged(test)


def topic(*, is_published: bool = False, is_subscribed: bool = False) -> dict[str, Any]:
    return {
        "name": NOTE, "type": "std_msgs/String", "velocity": False, "latched": False,
        "published": is_published, "subscribed": is_subscribed,
    }  # fmt: skip


def test_topic_of_the_daemon_is_requested_while_ros_2_has_a_subscriber() -> None:
    async def test(world: World) -> None:
        await world.show(topics=[topic(is_published=True)])
        qos, sent = world.node.publishers[NOTE]
        assert qos == publisher_qos(NOTE, is_latched=False)
        assert world.host.raw == {}
        world.node.ros2 = Ros2Graph(readers=frozenset({NOTE}))
        await asyncio.sleep(0.5)
        world.node.time = bytes(8)  # a message without a header has no stamp
        world.host.raw[NOTE].send(RawMessage(text(b"hello"), 0))
        world.host.raw[NOTE].send(RawMessage(b"\xff\xff", 0))
        world.host.raw[NOTE].send(RawMessage(text(b"again"), 0))
        await asyncio.sleep(0.1)
        assert sent == [text_cdr(b"hello"), text_cdr(b"again")]
        await world.show()
        assert (world.host.raw, world.node.publishers) == ({}, {})

    bridged(test)


def test_cdr_of_a_type_without_a_definition_passes_to_ros_2_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(world: World) -> None:
        own = {**topic(is_published=True), "type": "my_msgs/Own", "encoding": "cdr"}
        world.node.ros2 = Ros2Graph(readers=frozenset({NOTE}))
        await world.show(topics=[own])
        world.node.time = bytes(8)
        world.host.raw[NOTE].send(RawMessage(b"\0\1\0\0x", 0, "cdr"))
        world.host.raw[NOTE].send(RawMessage(b"of another type", 0))
        await asyncio.sleep(0.1)
        assert world.node.publishers[NOTE][1] == [b"\0\1\0\0x"]
        await world.show(topics=[{**own, "type": "other_msgs/Own"}])
        assert (world.host.raw, world.node.publishers) == ({}, {})
        assert "other_msgs/msg/Own is not installed here" in world.reports[-1]

    monkeypatch.setitem(sys.modules, "my_msgs", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "my_msgs.msg", SimpleNamespace(Own=object))
    bridged(test)


def test_topic_of_ros_2_reaches_the_daemon_without_echoes_and_malformed_messages() -> None:
    async def test(world: World) -> None:
        offered = Ros2Publisher("std_msgs/msg/String", Qos(is_reliable=True, is_latched=True))
        world.node.ros2 = Ros2Graph(publishers={NOTE: (offered,)}, readers=frozenset({NOTE}))
        await world.show(topics=[topic(is_published=True, is_subscribed=True)])
        assert world.host.advertised == {NOTE: True}
        assert world.node.qos[NOTE][1]
        world.host.raw[NOTE].send(RawMessage(text(b"mine"), 0))
        await asyncio.sleep(0.1)
        for data in (text_cdr(b"mine"), b"\0\1", text_cdr(b"theirs")):
            world.node.subscriptions[NOTE](data)
        await asyncio.sleep(0.1)
        assert world.host.published == [(NOTE, text(b"theirs"), "std_msgs/String")]
        warning = f"{NOTE}: messages that are not of the topic's type are left out: 1"
        assert ("warning", warning) in world.node.lines
        await world.show()
        assert (world.host.advertised, world.node.subscriptions) == ({}, {})

    bridged(test)


def test_service_of_the_daemon_answers_in_ros_2() -> None:
    async def test(world: World) -> None:
        await world.show(services=[TRIGGER, {"name": "/robot_0/fail", "type": "std_srvs/Trigger"}])
        done = await world.node.services["/robot_0/reset"](Trigger.Request(), Trigger.Response())
        assert (done.success, done.message) == (True, "reset")
        failed = await world.node.services["/robot_0/fail"](Trigger.Request(), Trigger.Response())
        assert (failed.success, failed.message) == (False, "the robot is locked")

    bridged(test)


def test_service_of_ros_2_answers_at_the_daemon_within_its_time() -> None:
    async def test(world: World) -> None:
        world.node.ros2 = Ros2Graph(services={"/dock": "std_srvs/srv/Trigger"})
        world.node.answer = Trigger.Response()
        await world.show()
        assert await world.host.served["/dock"]({}) == {"success": False, "message": ""}
        world.node.answer = None
        with pytest.raises(HostlinkError, match="/dock: no answer from ROS 2 within 60 s"):
            await world.host.served["/dock"]({})

    bridged(test)


def test_route_whose_type_is_missing_is_reported_once_and_tried_again_after_a_new_connection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def test(world: World) -> None:
        await world.show(services=[{"name": "/a", "type": MISSING}])
        await asyncio.sleep(FIRST_RETRY_S + 0.2)
        assert [text for text in world.reports if "nobody_srvs" in text] == [world.reports[0]]
        installed = SimpleNamespace(Missing=Trigger)
        monkeypatch.setitem(sys.modules, "nobody_srvs", SimpleNamespace())
        monkeypatch.setitem(sys.modules, "nobody_srvs.srv", installed)
        world.host.changes.send(SimpleNamespace(reason="the connection is lost"))
        await asyncio.sleep(0.1)
        assert world.node.services == {}
        world.host.changes.send(SimpleNamespace(reason=""))
        await asyncio.sleep(0.1)
        assert list(world.node.services) == ["/a"]
        assert world.reports[1:] == ["the connection is lost", "connected to hostlink at http://robots:9090 again"]

    bridged(test)


def test_topic_that_is_not_mirrored_is_reported_once() -> None:
    async def test(world: World) -> None:
        topic = {"name": "/2wheels/odom", "velocity": False, "subscribed": False, "published": True}
        for _ in range(3):
            await world.show(topics=[topic])
        assert world.reports == ["/2wheels/odom: ROS 2 allows no such name, so the topic stays out of it"]

    bridged(test)


@pytest.mark.parametrize(
    ("level", "expected"),
    [(1, "debug"), (2, "info"), (4, "warning"), (8, "error"), (16, "fatal"), (3, "info"), (0, "debug")],
)
def test_log_line_of_a_device_has_its_level_in_ros_2(level: int, expected: str) -> None:
    async def test(world: World) -> None:
        world.host.lines.send({"level": level, "name": "robot_0", "msg": "low battery"})
        await asyncio.sleep(0.1)
        assert world.node.lines == [(expected, "robot_0: low battery")]

    bridged(test)


class FakeLogger:
    """Logger of rclpy, which keeps the lines with their levels."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str]] = []

    def __getattr__(self, level: str) -> Callable[[str], None]:
        return lambda text: self.lines.append((level, text))


@pytest.mark.parametrize(
    ("level", "name"),
    [(1, "debug"), (2, "info"), (4, "warning"), (8, "error"), (16, "fatal"), (32, "fatal"), (0, "debug")],
)
def test_line_of_a_device_has_its_level_in_ros_2(level: int, name: str) -> None:
    logger = FakeLogger()
    write_line(logger, {"level": level, "name": "robot_0", "msg": "hot"})
    assert logger.lines == [(name, "robot_0: hot")]
