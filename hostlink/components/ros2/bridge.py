"""Bridge between the daemon and ROS 2: the adapter that runs a route for each topic and service to mirror."""

import asyncio
import contextlib
import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hostlink.client import Host, connect
from hostlink.client.connection import waits
from hostlink.components.ros2.parameters import ParameterMirror
from hostlink.components.ros2.plan import Feed, Route, planned, publisher_keys, watched_topics
from hostlink.components.ros2.routes import Routes
from hostlink.components.ros2.velocity import Report, VelocityDriver
from hostlink.core.mirror.log_once import LogOnce
from hostlink.core.mirror.mirror import Mirror, Served
from hostlink.errors import HostlinkError

if TYPE_CHECKING:
    from hostlink.components.ros2.node import Ros2Node

GROUP = "ros2"
TICK_S = 0.2  # ROS 2's own discovery takes half a second and more
FIRST_RETRY_S, LONGEST_RETRY_S = 1.0, 60.0  # of a route that failed; its type may be installed in the meantime
ROSOUT = "/rosout"
_INFO, _WARN, _ERROR, _FATAL = 2, 4, 8, 16  # of rosgraph_msgs/Log


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeConfig:
    """Settings of the bridge."""

    url: str
    token: str | None
    priority: int  # of the velocities
    ros_arguments: list[str]  # from `--ros-args` on


OpenNode = Callable[[list[str], Callable[[BaseException], None]], contextlib.AbstractAsyncContextManager["Ros2Node"]]


async def run_bridge(config: BridgeConfig, open_node: OpenNode, report: Report) -> None:
    """Bridge until cancelled. `open_node`: `ros2_node`, which needs rclpy; `report` gets lines for the user.

    Raises:
        ConfigError: the arguments for ROS 2 are wrong.
        HostlinkError: rclpy has failed.
    """
    crash: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    fail = functools.partial(_fail, crash)
    async with open_node(config.ros_arguments, fail) as node, asyncio.TaskGroup() as tasks:
        bridging = tasks.create_task(_bridge(config, node, report))
        try:
            await crash
        finally:
            bridging.cancel()


async def _bridge(config: BridgeConfig, node: "Ros2Node", report: Report) -> None:
    async with contextlib.AsyncExitStack() as stack:
        host = await _connected(stack, config, report)
        report(f"connected to hostlink at {host.url}")
        velocity = VelocityDriver(functools.partial(_connect, config), config.priority, report, node.warn)
        await Bridge(host, node, velocity, report).run()


def _connect(config: BridgeConfig) -> contextlib.AbstractAsyncContextManager[Host]:
    return connect(config.url, token=config.token, group=GROUP, name="ROS 2 bridge")


async def _connected(stack: contextlib.AsyncExitStack, config: BridgeConfig, report: Report) -> Host:
    """Return the first connection. The client restores it by itself."""
    reported = ""
    for wait_s in waits():
        try:
            return await stack.enter_async_context(_connect(config))
        except HostlinkError as error:
            if str(error) != reported:
                reported = str(error)
                report(f"{reported}; trying again")
        await asyncio.sleep(wait_s)
    raise AssertionError("the waits have no end")


class Bridge:
    """Bridge of one daemon and one ROS 2 graph."""

    def __init__(self, host: Host, node: "Ros2Node", velocity: VelocityDriver, report: Report) -> None:
        self._host, self._node, self._velocity, self._report = host, node, velocity, report
        self._routes = Routes(node, host, velocity)
        self._log_once = LogOnce()

    async def run(self) -> None:
        """Bridge until cancelled."""
        async with self._velocity.running(), self._routes.running(), asyncio.TaskGroup() as tasks:
            mirror: Mirror[Route, Route, Served[Route]] = Mirror.of_tasks(
                lambda _, route: self._routes.run(route),
                tasks.create_task,
                self._fail,
                retry_s=FIRST_RETRY_S,
                longest_s=LONGEST_RETRY_S,
            )
            tasks.create_task(self._follow_connection(mirror))
            tasks.create_task(relay_log_lines(self._host, self._node))
            tasks.create_task(ParameterMirror(self._node, self._host).run())
            graphs = await self._host.watch_graph()
            graph = await anext(graphs)
            while True:
                graph = (graphs.pop_all() or [graph])[-1]
                mirror.want(await self._routes_of(graph))
                await asyncio.sleep(TICK_S)

    async def _routes_of(self, graph: Mapping[str, Any]) -> dict[Route, Route]:
        """Return the routes that both graphs need, publications before their feeds."""
        ros2 = await self._node.graph(watched_topics(graph))
        self._velocity.update((robot["name"] for robot in graph["robots"]), publisher_keys(ros2))
        plan = planned(graph, ros2)
        for problem in plan.problems:
            self._report_once(problem)
        return {route: route for route in sorted(plan.routes, key=lambda route: isinstance(route, Feed))}

    def _fail(self, route: Route, error: Exception) -> None:
        if not isinstance(error, HostlinkError):  # rclpy's errors have no common class
            self._report_once(f"{route}: {type(error).__name__}: {error}")
        elif self._host.is_connected:
            self._report_once(str(error))

    async def _follow_connection(self, mirror: Mirror[Route, Route, Served[Route]]) -> None:
        """Retry failed routes after each new connection."""
        async for change in self._host.connection():
            self._report(change.reason or f"connected to hostlink at {self._host.url} again")
            if not change.reason:
                mirror.retry()

    def _report_once(self, text: str) -> None:
        if self._log_once.is_new(text):
            self._report(text)


def _fail(crash: "asyncio.Future[None]", error: BaseException) -> None:
    if not crash.done():
        crash.set_exception(HostlinkError(f"rclpy has failed: {type(error).__name__}: {error}"))


async def relay_log_lines(host: Host, node: "Ros2Node") -> None:
    """Show log lines of devices in ROS 2's log, on /rosout and on the terminal, until cancelled.

    Raises:
        HostlinkError: there is no connection.
    """
    async with host.subscribe(ROSOUT, type_name="rosgraph_msgs/Log") as lines:
        async for line in lines:
            write_line(node.node.get_logger(), line)


def write_line(logger: Any, line: Mapping[str, Any]) -> None:
    """One line, at its level; rclpy allows a place in the code one level only."""
    level, text = line["level"], f"{line['name']}: {line['msg']}"
    if level >= _FATAL:
        logger.fatal(text)
    elif level >= _ERROR:
        logger.error(text)
    elif level >= _WARN:
        logger.warning(text)
    elif level >= _INFO:
        logger.info(text)
    else:
        logger.debug(text)
