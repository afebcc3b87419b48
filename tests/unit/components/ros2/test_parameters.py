"""Parameters of the daemon as parameters of the bridge's node, in both directions, without rclpy."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Collection, Mapping
from typing import Any

import pytest

from hostlink.components.ros2.parameters import ANSWER_TIMEOUT_S, INTERVAL_S, ParameterMirror, leaves, ros2_value
from hostlink.errors import HostlinkError
from tests.support.virtual_loop import run_virtual


class FakeNode:
    """Node of ROS 2: notes what is set, and lets a test set parameters as another node does."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}
        self.is_set = asyncio.Event()
        self.accept: Callable[[dict[str, Any]], str] = lambda _: "nobody accepts"
        self._loop = asyncio.get_running_loop()

    async def watch_parameters(self, accept: Callable[[dict[str, Any]], str]) -> None:
        self.accept = accept

    async def set_parameters(self, changed: Mapping[str, Any], gone: Collection[str]) -> None:
        assert changed or gone
        for name in gone:
            del self.values[name]
        self.values |= changed
        self.is_set.set()

    def post(self, function: Callable[..., None], *arguments: object) -> None:
        self._loop.call_soon_threadsafe(function, *arguments)

    async def set(self, **values: Any) -> str:
        """Set parameters; dots are written as double underscores. Return the reason of a refusal."""
        return await asyncio.to_thread(self.accept, {name.replace("__", "."): each for name, each in values.items()})


class FakeHost:
    """Daemon with parameters by their full names."""

    def __init__(self) -> None:
        self.tree: dict[str, Any] = {}
        self.is_connected = True
        self.refused: set[str] = set()
        self.calls: list[tuple[str, str]] = []
        self.is_hanging = False

    async def call(self, service: str, request: Mapping[str, str]) -> Mapping[str, Any]:
        name = request["name"]
        self.calls.append((service, name))
        if self.is_hanging:
            await asyncio.Event().wait()
        if service == "/rosapi/get_param":
            return {"value": json.dumps(self.tree)}
        if name in self.refused:
            raise HostlinkError(f"{name} is refused")
        group, key = name.strip("/").split("/")
        if service == "/rosapi/delete_param":
            del self.tree[group][key]
        else:
            assert service == "/rosapi/set_param"
            self.tree.setdefault(group, {})[key] = json.loads(request["value"])
        return {}


Test = Callable[[FakeNode, FakeHost], Awaitable[None]]


async def mirrored(test: Test) -> None:
    node, host = FakeNode(), FakeHost()
    host.tree = {"robot_0": {"gain": 2, "name": "red"}}
    untyped: Any = (node, host)
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(ParameterMirror(*untyped).run())
        await node.is_set.wait()
        try:
            await test(node, host)
        finally:
            running.cancel()


def test_parameters_of_the_daemon_are_followed() -> None:
    async def test(node: FakeNode, host: FakeHost) -> None:
        assert node.values == {"robot_0.gain": 2, "robot_0.name": "red"}
        host.tree = {"robot_0": {"gain": 3, "name": "red"}, "robot_1": {"mixed": [1, "a"], "gains": [1, 0.5]}}
        await asyncio.sleep(INTERVAL_S - 0.1)
        assert node.values["robot_0.gain"] == 2
        await asyncio.sleep(0.2)
        assert node.values == {"robot_0.gain": 3, "robot_0.name": "red", "robot_1.gains": [1.0, 0.5]}
        host.tree = {"robot_0": {"gain": 3}}
        await asyncio.sleep(INTERVAL_S)
        assert node.values == {"robot_0.gain": 3}

    run_virtual(mirrored(test))


def test_daemon_is_not_asked_while_it_is_not_connected() -> None:
    async def test(node: FakeNode, host: FakeHost) -> None:
        host.is_connected, host.tree = False, {}
        await asyncio.sleep(3 * INTERVAL_S)
        assert len(host.calls) == 1
        host.is_connected = True
        await asyncio.sleep(INTERVAL_S)
        assert node.values == {}

    run_virtual(mirrored(test))


def test_parameter_set_in_ros_2_is_set_at_the_daemon() -> None:
    async def test(node: FakeNode, host: FakeHost) -> None:
        assert await node.set(robot_0__gain=5, robot_1__limit=0.5) == ""
        assert host.tree == {"robot_0": {"gain": 5, "name": "red"}, "robot_1": {"limit": 0.5}}
        assert await node.set(robot_0__gain=None) == ""
        assert host.tree["robot_0"] == {"name": "red"}

    asyncio.run(mirrored(test))


def test_refusal_by_the_daemon_restores_the_parameters_that_were_set_with_it() -> None:
    async def test(node: FakeNode, host: FakeHost) -> None:
        host.refused = {"/robot_0/name"}
        assert await node.set(robot_0__gain=5, robot_0__name="blue") == "/robot_0/name is refused"
        assert host.tree == {"robot_0": {"gain": 2, "name": "red"}}

    asyncio.run(mirrored(test))


@pytest.mark.parametrize("name", ["robot_0/gain", "robot_0..gain", ".gain", "gain."])
def test_name_that_is_not_parted_by_single_dots_is_refused(name: str) -> None:
    async def test(node: FakeNode, host: FakeHost) -> None:
        reason = await asyncio.to_thread(node.accept, {name: 1})
        assert reason.startswith(f"{name}: the parts of a parameter's name")
        assert len(host.calls) == 1

    asyncio.run(mirrored(test))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), b"\0"])
def test_value_that_no_device_can_receive_is_refused(value: object) -> None:
    async def test(node: FakeNode, host: FakeHost) -> None:
        assert (await node.set(robot_0__gain=value)).startswith("robot_0.gain: a device is answered with numbers")
        assert host.tree["robot_0"]["gain"] == 2

    asyncio.run(mirrored(test))


def test_daemon_that_does_not_answer_refuses() -> None:
    async def test(node: FakeNode, host: FakeHost) -> None:
        host.is_hanging = True
        assert await node.set(robot_0__gain=5) == f"the daemon has not answered within {ANSWER_TIMEOUT_S:g} s"

    asyncio.run(mirrored(test))


def test_parameters_of_a_tree_have_full_names_and_types_of_ros_2() -> None:
    tree = {"a": {"b": 1, "c": {}}, "d": [], "e": [True, False], "f": None}
    assert list(leaves(tree)) == [("/a/b", 1), ("/e", [True, False])]
    assert ros2_value([1, 2.5]) == [1.0, 2.5]
    assert ros2_value([True, 1]) is None
