"""The bridge: compares both graphs, and runs a route for whatever one has and the other is to have."""

import asyncio
import contextlib
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from hostlink.client import Host, connect
from hostlink.client.connection import waits
from hostlink.errors import HostlinkError
from hostlink.graphs.ros2.log_lines import relay_log_lines
from hostlink.graphs.ros2.node import Ros2Node, ros2_node
from hostlink.graphs.ros2.parameters import ParameterMirror
from hostlink.graphs.ros2.plan import Feed, Plan, Route, planned, publisher_keys, watched_topics
from hostlink.graphs.ros2.routes import Routes
from hostlink.graphs.ros2.sim_time import SimTime
from hostlink.graphs.ros2.velocity import Report, VelocityDriver

GROUP = "ros2"
TICK_S = 0.2  # ROS 2's own discovery takes half a second and more


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeConfig:
    """What the user chose."""

    url: str
    token: str | None
    priority: int  # of the velocities
    ros_arguments: list[str]  # from `--ros-args` on


async def run_bridge(config: BridgeConfig, report: Report) -> None:
    """Bridge until cancelled; `report` is called with one line for whatever a user should know.

    Raises:
        ConfigError: the arguments for ROS 2 are wrong.
        HostlinkError: rclpy has failed.
    """
    crash: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    fail = functools.partial(_fail, crash)
    async with ros2_node(config.ros_arguments, fail) as node, asyncio.TaskGroup() as tasks:
        bridging = tasks.create_task(_bridge(config, node, report))
        try:
            await crash
        finally:
            bridging.cancel()


async def _bridge(config: BridgeConfig, node: Ros2Node, report: Report) -> None:
    async with contextlib.AsyncExitStack() as stack:
        host = await _connected(stack, config, report)
        report(f"connected to hostlink at {host.url}")
        velocity = VelocityDriver(functools.partial(_connect, config), config.priority, report, node.warn)
        await Bridge(host, node, velocity, report).run()


def _connect(config: BridgeConfig) -> contextlib.AbstractAsyncContextManager[Host]:
    return connect(config.url, token=config.token, group=GROUP)


async def _connected(stack: contextlib.AsyncExitStack, config: BridgeConfig, report: Report) -> Host:
    """The first connection; the client makes later ones by itself."""
    reported = ""
    for wait_s in waits():
        try:
            return await stack.enter_async_context(_connect(config))
        except HostlinkError as error:
            if str(error) != reported:
                reported = str(error)
                report(f"{reported}; it is tried again")
        await asyncio.sleep(wait_s)
    raise AssertionError("the waits have no end")


class Bridge:
    """One daemon and one ROS 2 graph. `run` it."""

    def __init__(self, host: Host, node: Ros2Node, velocity: VelocityDriver, report: Report) -> None:
        self._host, self._node, self._velocity, self._report = host, node, velocity, report
        self._sim_time = SimTime(node)
        self._routes = Routes(node, host, velocity, stamp=self._sim_time.stamp)
        self._running: dict[Route, asyncio.Task[None]] = {}
        self._reported: set[str] = set()

    async def run(self) -> None:
        """Until cancelled."""
        async with self._velocity.running(), self._routes.running(), asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow_connection())
            tasks.create_task(relay_log_lines(self._host, self._node))
            tasks.create_task(ParameterMirror(self._node, self._host).run())
            graphs = await self._host.watch_graph()
            graph = await anext(graphs)
            while True:
                graph = (graphs.pop_all() or [graph])[-1]
                await self._update(graph, tasks)
                await asyncio.sleep(TICK_S)

    async def _update(self, graph: Mapping[str, Any], tasks: asyncio.TaskGroup) -> None:
        ros2 = await self._node.graph(watched_topics(graph))
        self._sim_time.update()
        self._velocity.update((robot["name"] for robot in graph["robots"]), publisher_keys(ros2))
        self._apply(planned(graph, ros2), tasks)

    def _apply(self, plan: Plan, tasks: asyncio.TaskGroup) -> None:
        for problem in plan.problems:
            self._report_once(problem)
        for route in self._running.keys() - plan.routes:
            self._running.pop(route).cancel()
        for route in sorted(plan.routes - self._running.keys(), key=lambda route: isinstance(route, Feed)):
            self._running[route] = tasks.create_task(self._run(route))

    async def _run(self, route: Route) -> None:
        """A route that cannot be is reported, and touches no other; one that lost its connection is made again."""
        try:
            await self._routes.run(route)
        except HostlinkError as error:
            if self._host.is_connected:
                self._report_once(str(error))
            else:
                self._running.pop(route, None)
        except Exception as error:  # noqa: BLE001 - rclpy's errors have no common class
            self._report_once(f"{route}: {type(error).__name__}: {error}")

    async def _follow_connection(self) -> None:
        async for change in self._host.connection():
            self._report(change.reason or f"connected to hostlink at {self._host.url} again")

    def _report_once(self, text: str) -> None:
        if text not in self._reported:
            self._reported.add(text)
            self._report(text)


def _fail(crash: "asyncio.Future[None]", error: BaseException) -> None:
    if not crash.done():
        crash.set_exception(HostlinkError(f"rclpy has failed: {type(error).__name__}: {error}"))
