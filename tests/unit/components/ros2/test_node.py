"""Ros2Node with a fake rclpy: what is made and destroyed in its thread, parameters, the graph, and the node's end."""

import asyncio
import importlib
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.ros2.plan import Ros2Publisher
from hostlink.errors import ConfigError
from tests.support.waiting import expect


class Record(SimpleNamespace):
    """Message or setting of rclpy: fields by keyword."""


class Parameter(SimpleNamespace):
    def __init__(self, name: str, *, value: Any) -> None:
        super().__init__(name=name, value=value)


class LostNode(Exception):
    """A node has left."""


class FakeFuture:
    """Future of rclpy. A callback that is added to one with a result is called at once."""

    def __init__(self, **_: Any) -> None:
        self.done: list[Callable[[FakeFuture], None]] = []
        self.value: Any = None
        self.has_result = False

    def add_done_callback(self, callback: Callable[["FakeFuture"], None]) -> None:
        if self.has_result:
            callback(self)
        else:
            self.done.append(callback)

    def result(self) -> Any:
        return self.value

    def set_result(self, value: Any) -> None:
        self.value, self.has_result = value, True
        for callback in self.done:
            callback(self)


class FakeExecutor:
    """Executor that runs each task at once. `spin` lasts until `shutdown` or `crash`."""

    def __init__(self, **_: Any) -> None:
        self.nodes: list[Any] = []
        self.tasks = 0
        self._end = threading.Event()
        self._crash: Exception | None = None

    def create_task(self, task: Callable[[], None]) -> None:
        self.tasks += 1
        task()

    def add_node(self, node: Any) -> None:
        self.nodes.append(node)

    def spin(self) -> None:
        assert self._end.wait(30.0)
        if self._crash is not None:
            raise self._crash

    def crash(self, error: Exception) -> None:
        self._crash = error
        self._end.set()

    def shutdown(self, **_: Any) -> None:
        self._end.set()


class FakeNode:
    """Node of rclpy in the namespace /lab. The graph has another node, `other`."""

    def __init__(self) -> None:
        self.ends: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        self.parameters: dict[str, Any] = {"use_sim_time": False}
        self.descriptors: dict[str, str] = {}
        self.on_set: Callable[[list[Any]], Any] = lambda _: None
        self.after_set: Callable[[list[Any]], None] = lambda _: None
        self.publishers: list[Any] = []
        self.services: dict[str, list[tuple[str, list[str]]]] = {}
        self.warnings: list[str] = []
        self.is_destroyed = False

    def get_name(self) -> str:
        return "hostlink"

    def get_namespace(self) -> str:
        return "/lab"

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.warnings.append)

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: Record(sec=7, nanosec=8)))

    def __getattr__(self, name: str) -> Callable[..., Any]:
        action, _, kind = name.partition("_")
        assert action in ("create", "destroy"), name

        def create(*arguments: Any, **options: Any) -> Any:
            made = SimpleNamespace(kind=kind, readers=0)
            made.get_subscription_count = lambda: made.readers
            self.ends.append((kind, arguments, options))
            return made

        def destroy(made: Any) -> None:
            assert made.kind == kind
            del self.ends[[each[0] for each in self.ends].index(kind)]

        return create if action == "create" else destroy

    def destroy_node(self) -> None:
        self.is_destroyed = True

    # -- parameters

    def list_parameters(self, *_: Any) -> Any:
        return SimpleNamespace(names=list(self.parameters))

    def add_on_set_parameters_callback(self, callback: Callable[[list[Any]], Any]) -> None:
        self.on_set = callback

    def add_post_set_parameters_callback(self, callback: Callable[[list[Any]], None]) -> None:
        self.after_set = callback

    def has_parameter(self, name: str) -> bool:
        return name in self.parameters

    def get_parameter(self, name: str) -> Any:
        return Parameter(name, value=self.parameters[name])

    def describe_parameter(self, name: str) -> Any:
        return Record(name=self.descriptors.get(name, ""))

    def set_descriptor(self, name: str, descriptor: Any) -> None:
        assert descriptor.dynamic_typing
        self.descriptors[name] = name

    def set_parameters(self, parameters: list[Any]) -> Any:
        result = self.on_set(parameters)
        if result is None or result.successful:
            self.parameters |= {each.name: each.value for each in parameters}
            self.after_set(parameters)
        return result

    def declare_parameter(self, name: str, value: Any, descriptor: Any) -> None:
        assert name not in self.parameters
        self.set_descriptor(name, descriptor)
        self.set_parameters([Parameter(name, value=value)])

    def undeclare_parameter(self, name: str) -> None:
        del self.parameters[name]

    # -- the graph

    def resolve_topic_name(self, name: str) -> str:
        return f"/lab/{name}" if not name.startswith("/") else name

    def get_publishers_info_by_topic(self, name: str) -> list[Any]:
        return [each for each in self.publishers if each.topic == name]

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [("hostlink", "/lab"), ("other", "/"), ("gone", "/lab")]

    def get_service_names_and_types_by_node(self, name: str, _namespace: str) -> list[tuple[str, list[str]]]:
        if name not in self.services:
            raise LostNode
        return self.services[name]


class FakeRclpy:
    """The modules of rclpy that the node imports."""

    def __init__(self) -> None:
        self.node, self.executors = FakeNode(), list[FakeExecutor]()
        self.calls: list[tuple[str, dict[str, Any]]] = []
        self.error: Exception | None = None

    def init(self, **options: Any) -> None:
        if self.error is not None:
            raise self.error
        self.calls.append(("init", options))

    def create_node(self, name: str, **options: Any) -> FakeNode:
        self.calls.append((name, options))
        return self.node

    def shutdown(self, **options: Any) -> None:
        self.calls.append(("shutdown", options))

    def make_executor(self, **options: Any) -> FakeExecutor:
        self.executors.append(FakeExecutor(**options))
        return self.executors[-1]

    def modules(self) -> dict[str, Any]:
        return {
            "rclpy": {
                "init": self.init,
                "create_node": self.create_node,
                "shutdown": self.shutdown,
                "task": SimpleNamespace(Future=FakeFuture),
            },
            "rcl_interfaces": {},
            "rcl_interfaces.msg": {"ParameterDescriptor": Record, "SetParametersResult": Record},
            "rclpy.context": {"Context": lambda: "context"},
            "rclpy.executors": {"SingleThreadedExecutor": self.make_executor},
            "rclpy.node": {"NodeNameNonExistentError": LostNode},
            "rclpy.parameter": {"Parameter": Parameter},
            "rclpy.qos": {
                "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="kept", VOLATILE="volatile"),
                "HistoryPolicy": SimpleNamespace(KEEP_LAST="last"),
                "ReliabilityPolicy": SimpleNamespace(RELIABLE="reliable", BEST_EFFORT="best effort"),
                "QoSProfile": Record,
            },
            "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="no")},
        }


Scene = tuple[FakeRclpy, Any]


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    """The fake, and the module of the node that uses it."""
    fake = FakeRclpy()
    for name, content in fake.modules().items():
        made = ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)
    monkeypatch.delitem(sys.modules, "hostlink.components.ros2.node", raising=False)
    module = importlib.import_module("hostlink.components.ros2.node")
    yield fake, module
    sys.modules.pop("hostlink.components.ros2.node", None)


def node_of(scene: Scene) -> tuple[Any, FakeNode, FakeExecutor]:
    fake, module = scene
    executor = FakeExecutor()
    return module.Ros2Node(fake.node, executor), fake.node, executor


async def test_work_in_rclpys_thread_returns_or_raises_in_the_loop(scene: Scene) -> None:
    made, _, executor = node_of(scene)
    assert await made.run(lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        await made.run(lambda: 1 // 0)
    assert executor.tasks == 2


async def test_ends_are_made_with_their_quality_and_destroyed_at_the_end_of_the_block(scene: Scene) -> None:
    made, node, _ = node_of(scene)
    latched, lossy = Qos(is_reliable=True, is_latched=True), Qos(is_reliable=False, is_latched=False)
    async with made.publisher("/odom", "cls", latched), made.subscription("/cmd", "cls", lossy, print, is_raw=True):
        (publisher, subscription) = node.ends
        assert publisher[:2] == ("publisher", ("cls", "odom", profile(latched, "reliable", "kept")))
        assert subscription == (
            "subscription", ("cls", "cmd", print, profile(lossy, "best effort", "volatile")), {"raw": True},
        )  # fmt: skip
    async with made.service("/lock", "cls", print), made.client("/lock", "cls"):
        assert [each[:2] for each in node.ends] == [("service", ("cls", "lock", print)), ("client", ("cls", "lock"))]
    assert node.ends == []


def profile(qos: Qos, reliability: str, durability: str) -> Record:
    return Record(history="last", depth=qos.depth, reliability=reliability, durability=durability)


async def test_graph_has_publishers_of_other_nodes_read_topics_and_services_of_the_namespace(scene: Scene) -> None:
    made, node, _ = node_of(scene)
    node.services["other"] = [("/lab/lock", ["std_srvs/srv/Trigger", "x"]), ("/elsewhere/lock", ["x"])]
    for name, namespace, durability in (("hostlink", "/lab", "kept"), ("hostlink", "/", "kept"), ("other", "/lab", "")):
        node.publishers.append(
            Record(
                topic="/lab/cmd", node_name=name, node_namespace=namespace, topic_type="t", endpoint_gid=[1, 2],
                qos_profile=Record(reliability="reliable" if durability else "", durability=durability),
            )
        )  # fmt: skip
    async with (
        made.publisher("/odom", "cls", Qos(True, False)) as read,
        made.publisher("/text", "cls", Qos(True, False)),
    ):
        read.readers = 1
        graph = await made.graph(["/cmd", "/none"])
        assert graph.readers == {"/odom"}
    assert graph.services == {"/lock": "std_srvs/srv/Trigger"}
    assert graph.publishers == {
        "/cmd": (
            Ros2Publisher("t", Qos(is_reliable=True, is_latched=True), b"\1\2"),
            Ros2Publisher("t", Qos(is_reliable=False, is_latched=False), b"\1\2"),
        ),
        "/none": (),
    }
    assert (await made.graph([])).readers == frozenset()


async def test_stamp_is_the_time_of_clock_only_with_use_sim_time(scene: Scene) -> None:
    made, node, _ = node_of(scene)
    assert made.stamp() == b""
    node.parameters["use_sim_time"] = True
    await made.graph([])
    assert made.stamp() == struct.pack("<iI", 7, 8)
    made.warn("slow")
    assert node.warnings == ["slow"]


async def test_parameters_that_other_nodes_set_are_accepted_or_refused(scene: Scene) -> None:
    made, node, _ = node_of(scene)
    heard: list[dict[str, Any]] = []

    def accept(changed: dict[str, Any]) -> str:
        heard.append(changed)
        return "too fast" if changed.get("gain") == 9 else ""

    await made.watch_parameters(accept)
    assert node.set_parameters([Parameter("gain", value=7), Parameter("list", value=(1, 2))]).successful
    refused = node.set_parameters([Parameter("gain", value=9)])
    assert (refused.successful, refused.reason) == (False, "too fast")
    assert node.set_parameters([Parameter("use_sim_time", value=True)]).successful  # every node has it
    assert heard == [{"gain": 7, "list": [1, 2]}, {"gain": 9}]
    assert node.parameters == {"use_sim_time": True, "gain": 7, "list": (1, 2)}
    assert node.descriptors.keys() == {"use_sim_time", "gain", "list"}


async def test_parameters_of_the_daemon_are_set_without_asking(scene: Scene) -> None:
    made, node, _ = node_of(scene)
    heard: list[dict[str, Any]] = []

    def accept(changed: dict[str, Any]) -> str:
        heard.append(changed)
        return ""

    await made.watch_parameters(accept)
    await made.set_parameters({"gain": 7, "speed": 0.5}, ())
    await made.set_parameters({"gain": 8}, ("speed", "never"))
    assert (node.parameters, heard) == ({"use_sim_time": False, "gain": 8}, [])
    node.set_parameters([Parameter("gain", value=9)])
    assert heard == [{"gain": 9}]


async def test_call_of_a_service_returns_its_answer_and_forgets_it_when_cancelled(scene: Scene) -> None:
    made, _, _ = node_of(scene)
    pending, removed = FakeFuture(), list[Any]()
    client = SimpleNamespace(call_async=lambda _: pending, remove_pending_request=removed.append)
    async with asyncio.TaskGroup() as tasks:
        calling = tasks.create_task(made.call(client, "request"))
        await expect(lambda: pending.done)
        pending.set_result("answer")
    assert (calling.result(), removed) == ("answer", [pending])
    async with asyncio.TaskGroup() as tasks:
        pending.done, pending.has_result = [], False
        calling = tasks.create_task(made.call(client, "request"))
        await expect(lambda: pending.done)
        calling.cancel()
    assert removed == [pending, pending]
    assert isinstance(made.pending(), FakeFuture)


async def test_node_spins_in_a_thread_until_the_end_of_its_block(scene: Scene) -> None:
    fake, module = scene
    failures: list[BaseException] = []
    async with module.ros2_node(["--ros-args"], failures.append) as made:
        assert made.node is fake.node
        assert any(thread.name == "rclpy" for thread in threading.enumerate())
    assert not any(thread.name == "rclpy" for thread in threading.enumerate())
    assert (failures, fake.node.is_destroyed, fake.executors[0].nodes) == ([], True, [fake.node])
    init, create, shutdown = fake.calls
    assert (init[1]["args"], init[1]["signal_handler_options"]) == (["--ros-args"], "no")
    assert (create[0], create[1]["allow_undeclared_parameters"]) == ("hostlink", True)
    assert shutdown == ("shutdown", {"context": "context"})


async def test_crash_of_the_executor_is_reported_in_the_loop(scene: Scene) -> None:
    fake, module = scene
    failures: list[BaseException] = []
    async with module.ros2_node([], failures.append):
        error = RuntimeError("broken")
        fake.executors[0].crash(error)
        await expect(lambda: failures == [error])


async def test_wrong_arguments_are_an_error_in_one_line(scene: Scene) -> None:
    fake, module = scene
    fake.error = ValueError("unknown argument\nand a long text")
    with pytest.raises(ConfigError, match=r"unknown argument$"):
        async with module.ros2_node(["--odd"], print):
            pass
