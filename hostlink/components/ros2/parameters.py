"""ParameterMirror: the daemon's parameters, which devices request, as parameters of the bridge's node; both ways."""

import asyncio
import concurrent.futures
import contextlib
import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from hostlink.client import Host
from hostlink.components.ros2.plan import parameter_name
from hostlink.errors import HostlinkError

if TYPE_CHECKING:
    from hostlink.components.ros2.node import Ros2Node

INTERVAL_S = 2.0  # the daemon has no event for a parameter
ANSWER_TIMEOUT_S = 0.4  # of the daemon; rclpy's thread waits for it, and a lease is 0.5 s
MAX_WAITING = 16  # changes


class _ParameterChange(NamedTuple):
    """Change by a node of ROS 2: values by the node's names, None deletes; `reason`: of a refusal, else empty."""

    values: dict[str, Any]
    reason: "concurrent.futures.Future[str]"


class ParameterMirror:
    """`/robot_0/gain` of the daemon is `robot_0.gain` of the node. What is set there, the daemon accepts or refuses."""

    def __init__(self, node: "Ros2Node", host: Host) -> None:
        self._node, self._host = node, host
        self._known: dict[str, Any] = {}  # values by the node's names
        self._names: dict[str, str] = {}  # the daemon's names by the node's
        self._changes: asyncio.Queue[_ParameterChange] = asyncio.Queue(MAX_WAITING)
        self._changed = 0  # how often the daemon's were changed from here

    async def run(self) -> None:
        """Mirror until cancelled."""
        await self._node.watch_parameters(self._request)
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow_node())
            while True:
                if self._host.is_connected:
                    await self._follow_daemon()
                await asyncio.sleep(INTERVAL_S)

    async def _follow_daemon(self) -> None:
        changed_before = self._changed
        try:
            answer = await self._host.call("/rosapi/get_param", {"name": "/", "default": "{}"})
        except HostlinkError:  # the connection is lost, as it reports itself
            return
        if self._changed != changed_before:  # the answer may be older than that
            return
        found = {}
        for name, value in leaves(json.loads(answer["value"])):
            self._names[parameter_name(name)] = name
            found[parameter_name(name)] = value
        changed = {name: value for name, value in found.items() if self._known.get(name) != value}
        gone = self._known.keys() - found.keys()
        self._known = found
        if changed or gone:
            await self._node.set_parameters(changed, gone)

    def _request(self, values: dict[str, Any]) -> str:
        """Have the daemon set these. Return the reason of a refusal, else an empty text. Called in rclpy's thread."""
        change = _ParameterChange(values, concurrent.futures.Future())
        self._node.post(self._put, change)
        try:
            return change.reason.result(ANSWER_TIMEOUT_S)
        except TimeoutError:
            change.reason.cancel()
            return f"the daemon has not answered within {ANSWER_TIMEOUT_S:g} s"

    def _put(self, change: _ParameterChange) -> None:
        if self._changes.full():
            change.reason.set_result("too many parameters are being set")
        else:
            self._changes.put_nowait(change)

    async def _follow_node(self) -> None:
        while True:
            change = await self._changes.get()
            if not change.reason.set_running_or_notify_cancel():  # the caller no longer waits
                continue
            before = {name: self._known.get(name) for name in change.values}
            done: list[str] = []
            try:
                for name, value in change.values.items():
                    await self._apply(name, value)
                    done.append(name)
            except HostlinkError as error:
                for name in done:  # all or none
                    with contextlib.suppress(HostlinkError):
                        await self._apply(name, before[name])
                change.reason.set_result(str(error))
            else:
                change.reason.set_result("")

    async def _apply(self, name: str, value: Any) -> None:
        """Set or delete a parameter of the daemon.

        Raises:
            HostlinkError: the daemon refuses it, or ROS 2 has no such name.
        """
        if "/" in name or not all(name.split(".")):
            raise HostlinkError(
                f"{name}: the parts of a parameter's name are parted by single dots here, as robot_0.gain"
            )
        own = self._names.get(name, f"/{name.replace('.', '/')}")
        self._changed += 1
        if value is None:
            await self._host.call("/rosapi/delete_param", {"name": own})
            self._known.pop(name, None)
            return
        try:
            text = json.dumps(value, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise HostlinkError(f"{name}: a device is answered with numbers, truths and texts: {error}") from error
        await self._host.call("/rosapi/set_param", {"name": own, "value": text})
        self._names[name], self._known[name] = own, value


def leaves(tree: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the parameters of a tree with their full names, without those that ROS 2 has no type for."""
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
