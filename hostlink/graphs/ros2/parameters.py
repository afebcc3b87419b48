"""ParameterMirror: the daemon's parameters, which devices request, as parameters of the bridge's node; both ways."""

import asyncio
import json
from collections.abc import Iterator, Mapping
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.parameter import Parameter

from hostlink.client import Host
from hostlink.errors import HostlinkError
from hostlink.graphs.ros2.names import parameter_name
from hostlink.graphs.ros2.node import Ros2Node
from hostlink.graphs.ros2.velocity import Report

INTERVAL_S = 2.0  # the daemon has no event for a parameter
MAX_PARAMETERS = 1024  # as the daemon


class ParameterMirror:
    """`/robot_0/gain` of the daemon is `robot_0.gain` of the node."""

    def __init__(self, node: Ros2Node, host: Host, report: Report) -> None:
        self._node, self._host, self._report = node, host, report
        self._known: dict[str, Any] = {}  # values by the node's names
        self._names: dict[str, str] = {}  # the daemon's names by the node's
        self._changes: asyncio.Queue[tuple[str, Any]] = asyncio.Queue(MAX_PARAMETERS)

    async def run(self) -> None:
        """Until cancelled."""
        await self._node.run(lambda: self._node.node.add_on_set_parameters_callback(self._accept))
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow_node())
            while True:
                if self._host.is_connected:
                    await self._follow_daemon()
                await asyncio.sleep(INTERVAL_S)

    async def _follow_daemon(self) -> None:
        try:
            answer = await self._host.call("/rosapi/get_param", {"name": "/", "default": "{}"})
        except HostlinkError:  # the connection is lost, as it reports itself
            return
        found = {}
        for name, value in leaves(json.loads(answer["value"])):
            self._names[parameter_name(name)] = name
            found[parameter_name(name)] = value
        changed = {name: value for name, value in found.items() if self._known.get(name) != value}
        gone = self._known.keys() - found.keys()
        self._known = found
        if changed or gone:
            await self._node.run(lambda: self._set(changed, gone))

    def _set(self, changed: Mapping[str, Any], gone: set[str]) -> None:
        node = self._node.node
        for name in gone:
            if node.has_parameter(name):
                node.undeclare_parameter(name)
        for name, value in changed.items():
            if node.has_parameter(name):
                node.set_parameters([Parameter(name, value=value)])
            else:
                node.declare_parameter(name, value, ParameterDescriptor(dynamic_typing=True))

    def _accept(self, parameters: list[Any]) -> Any:
        """In rclpy's thread: somebody sets parameters of the node."""
        for parameter in parameters:
            value = parameter.value
            plain = list(value) if hasattr(value, "tolist") or isinstance(value, tuple) else value
            if parameter.name in self._known and self._known[parameter.name] != plain:
                self._node.post(self._put, parameter.name, plain)
        return SetParametersResult(successful=True)

    def _put(self, name: str, value: Any) -> None:
        if self._changes.full():
            self._changes.get_nowait()
        self._changes.put_nowait((name, value))

    async def _follow_node(self) -> None:
        while True:
            name, value = await self._changes.get()
            try:
                await self._host.call("/rosapi/set_param", {"name": self._names[name], "value": json.dumps(value)})
            except HostlinkError as error:
                self._report(f"parameter {name}: {error}")
            else:
                self._known[name] = value


def leaves(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """The parameters of a tree, with their full names; what ROS 2 has no type for is left out."""
    if isinstance(tree, dict):
        for key, inner in tree.items():
            yield from leaves(inner, f"{name}/{key}")
    elif (value := ros2_value(tree)) is not None:
        yield name, value


def ros2_value(value: Any) -> Any:
    """A value as ROS 2 can have it: a list is of one type, whole numbers among others are floats; None: it cannot."""
    if not isinstance(value, list):
        return value
    kinds = {type(item) for item in value}
    if kinds == {int, float}:
        return [float(item) for item in value]
    return value if len(kinds) == 1 else None
