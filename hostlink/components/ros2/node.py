"""Ros2Node: an rclpy node whose executor runs in a thread of its own. Nodes' ends are made and ended in that thread."""

import asyncio
import contextlib
import struct
import threading
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, TypeVar

import rclpy
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions

from hostlink.components.graphs.ros2_qos import Qos
from hostlink.components.ros2.plan import Ros2Graph, Ros2Publisher, ros2_name
from hostlink.errors import ConfigError

NODE_NAME = "hostlink"
END_TIMEOUT_S = 2.0  # of the executor's thread
_STAMP = struct.Struct("<iI")
Result = TypeVar("Result")
_Made = contextlib.AbstractAsyncContextManager[Any]


class Ros2Node:
    """Node of rclpy, made by `ros2_node`. Publishers, subscriptions, services and clients are made in its thread."""

    def __init__(self, node: Any, executor: Any) -> None:
        self.node = node
        self._own = (node.get_name(), node.get_namespace())
        self._executor = executor
        self._loop = asyncio.get_running_loop()
        self._published: dict[str, Any] = {}  # rclpy's publishers by the daemon's topic
        self._is_sim_time = False
        self._is_setting = False  # in rclpy's thread: `set_parameters` sets, and no other node

    async def run(self, function: Callable[[], Result]) -> Result:
        """Call a function in rclpy's thread; what it raises is raised here."""
        done: asyncio.Future[Result] = self._loop.create_future()

        def call() -> None:
            try:
                result = function()
            except Exception as error:  # noqa: BLE001 - it is the caller's, in the other thread
                self.post(_settle, done, None, error)
            else:
                self.post(_settle, done, result, None)

        self._executor.create_task(call)
        return await done

    def post(self, function: Callable[..., None], *arguments: object) -> None:
        """Call a function in the event loop, from rclpy's thread; nothing happens when the loop has ended."""
        with contextlib.suppress(RuntimeError):  # it is closed
            self._loop.call_soon_threadsafe(function, *arguments)

    def warn(self, text: str) -> None:
        """A warning in ROS 2's log: on the terminal and on /rosout."""
        self.node.get_logger().warning(text)

    def stamp(self) -> bytes:
        """The time of /clock, as CDR has it; empty without `use_sim_time`: then the daemon's time is the node's."""
        if not self._is_sim_time:
            return b""
        now = self.node.get_clock().now().to_msg()
        return _STAMP.pack(now.sec, now.nanosec)

    # -- the node's ends ----------------------------------------------------------------------------------------------

    @contextlib.asynccontextmanager
    async def publisher(self, topic: str, cls: Any, qos: Qos) -> AsyncIterator[Any]:
        """A publisher for the length of the block; `publish` may be called in any thread."""
        async with self._made("publisher", cls, ros2_name(topic), profile(qos)) as made:
            self._published[topic] = made
            try:
                yield made
            finally:
                del self._published[topic]

    def subscription(self, topic: str, cls: Any, qos: Qos, receive: Callable[..., None], *, is_raw: bool) -> _Made:
        """A subscription for the length of the block; `receive` is called in rclpy's thread."""
        return self._made("subscription", cls, ros2_name(topic), receive, profile(qos), raw=is_raw)

    def service(self, name: str, cls: Any, answer: Callable[[Any, Any], Any]) -> _Made:
        """A service for the length of the block; `answer` is a coroutine function of rclpy."""
        return self._made("service", cls, ros2_name(name), answer)

    def client(self, name: str, cls: Any) -> _Made:
        """A client of a service for the length of the block."""
        return self._made("client", cls, ros2_name(name))

    @contextlib.asynccontextmanager
    async def _made(self, kind: str, *arguments: Any, **options: Any) -> AsyncIterator[Any]:
        """An end of the node for the length of the block, made and destroyed in rclpy's thread."""
        create, destroy = getattr(self.node, f"create_{kind}"), getattr(self.node, f"destroy_{kind}")
        made = await self.run(lambda: create(*arguments, **options))
        try:
            yield made
        finally:
            self._executor.create_task(lambda: destroy(made))

    async def call(self, client: Any, request: Any) -> Any:
        """Call a service; cancel it, and its answer is forgotten."""
        done: asyncio.Future[Any] = self._loop.create_future()
        pending = await self.run(lambda: client.call_async(request))
        pending.add_done_callback(lambda future: self.post(_settle, done, future.result(), None))
        try:
            return await done
        finally:
            self._executor.create_task(lambda: client.remove_pending_request(pending))

    def pending(self) -> Any:
        """A future of rclpy, which a coroutine in its thread awaits and the event loop completes."""
        return rclpy.task.Future(executor=self._executor)

    # -- its parameters -----------------------------------------------------------------------------------------------

    async def watch_parameters(self, accept: Callable[[dict[str, Any]], str]) -> None:
        """Call `accept` in rclpy's thread for each change by another node, without parameters that every node has.

        `accept` gets values by name, None for a deleted one, and returns the reason of a refusal, else an empty text.
        """
        await self.run(lambda: self._watch_parameters(accept))

    def _watch_parameters(self, accept: Callable[[dict[str, Any]], str]) -> None:
        own = frozenset(self.node.list_parameters([], 0).names)  # as use_sim_time

        def decide(parameters: list[Any]) -> Any:
            values = {} if self._is_setting else {each.name: _plain(each.value) for each in parameters}
            changed = {name: value for name, value in values.items() if name not in own}
            reason = accept(changed) if changed else ""
            return SetParametersResult(successful=not reason, reason=reason)

        self.node.add_on_set_parameters_callback(decide)
        self.node.add_post_set_parameters_callback(self._describe)

    def _describe(self, parameters: list[Any]) -> None:
        """Give what was not declared before it was set a descriptor, which `ros2 param` shows."""
        for each in parameters:
            if self.node.has_parameter(each.name) and not self.node.describe_parameter(each.name).name:
                self.node.set_descriptor(each.name, ParameterDescriptor(dynamic_typing=True))

    async def set_parameters(self, changed: Mapping[str, Any], gone: Collection[str]) -> None:
        """Set and delete parameters of the node; `accept` of `watch_parameters` is not called for them."""
        await self.run(lambda: self._set_parameters(changed, gone))

    def _set_parameters(self, changed: Mapping[str, Any], gone: Collection[str]) -> None:
        self._is_setting = True
        try:
            for name in filter(self.node.has_parameter, gone):
                self.node.undeclare_parameter(name)
            for name, value in changed.items():
                if self.node.has_parameter(name):
                    self.node.set_parameters([Parameter(name, value=value)])
                else:
                    self.node.declare_parameter(name, value, ParameterDescriptor(dynamic_typing=True))
        finally:
            self._is_setting = False

    # -- the graph ----------------------------------------------------------------------------------------------------

    async def graph(self, topics: Iterable[str]) -> Ros2Graph:
        """Return the graph of the other nodes, with publishers only of the given topics."""
        wanted = tuple(topics)
        return await self.run(lambda: self._graph(wanted))

    def _graph(self, topics: Iterable[str]) -> Ros2Graph:
        self._is_sim_time = bool(self.node.get_parameter("use_sim_time").value)
        readers = {topic for topic, made in self._published.items() if made.get_subscription_count()}
        return Ros2Graph(
            publishers={topic: tuple(self._publishers(topic)) for topic in topics},
            readers=frozenset(readers),
            services=self._services(),
        )

    def _publishers(self, topic: str) -> Iterator[Ros2Publisher]:
        for end in self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(ros2_name(topic))):
            if (end.node_name, end.node_namespace) != self._own:
                yield Ros2Publisher(end.topic_type, _offered(end.qos_profile), bytes(end.endpoint_gid))

    def _services(self) -> dict[str, str]:
        """Return the services in the node's namespace by their names in the daemon.

        The nodes are listed one by one, because the list of the whole graph includes services that only have clients.
        """
        prefix = self.node.get_namespace().rstrip("/") + "/"
        return {
            f"/{name.removeprefix(prefix)}": types[0]
            for node in self.node.get_node_names_and_namespaces()
            if node != self._own
            for name, types in self._services_of(*node)
            if name.startswith(prefix)
        }

    def _services_of(self, name: str, namespace: str) -> list[tuple[str, list[str]]]:
        try:
            return list(self.node.get_service_names_and_types_by_node(name, namespace))
        except NodeNameNonExistentError:  # it has just left
            return []


@contextlib.asynccontextmanager
async def ros2_node(arguments: list[str], fail: Callable[[BaseException], None]) -> AsyncIterator[Ros2Node]:
    """A node for the length of the block. `arguments`: those behind `--ros-args`; `fail` is called when it crashes.

    Raises:
        ConfigError: the arguments are wrong.
    """
    context = Context()
    try:
        rclpy.init(args=arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
        node = rclpy.create_node(NODE_NAME, context=context, allow_undeclared_parameters=True)  # the daemon decides
    except Exception as error:  # its errors have no common class that all releases export
        raise ConfigError("--ros-args", str(error).splitlines()[0]) from error
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    made = Ros2Node(node, executor)
    thread = threading.Thread(target=_spin, args=(executor, made, fail), name="rclpy", daemon=True)
    thread.start()
    try:
        yield made
    finally:
        executor.shutdown(timeout_sec=END_TIMEOUT_S)
        await asyncio.to_thread(thread.join, END_TIMEOUT_S)
        node.destroy_node()
        rclpy.shutdown(context=context)


def _spin(executor: Any, node: Ros2Node, fail: Callable[[BaseException], None]) -> None:
    try:
        executor.spin()
    except Exception as error:  # noqa: BLE001 - the end of the thread is the end of the bridge
        node.post(fail, error)


def profile(qos: Qos) -> Any:
    """Convert to rclpy's class."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.is_latched else DurabilityPolicy.VOLATILE,
    )


def _offered(found: Any) -> Qos:
    return Qos(found.reliability == ReliabilityPolicy.RELIABLE, found.durability == DurabilityPolicy.TRANSIENT_LOCAL)


def _plain(value: Any) -> Any:
    """Convert a parameter's value to JSON."""
    return list(value) if hasattr(value, "tolist") or isinstance(value, tuple) else value


def _settle(done: "asyncio.Future[Any]", result: object, error: Exception | None) -> None:
    if done.done():
        return
    if error is None:
        done.set_result(result)
    else:
        done.set_exception(error)
