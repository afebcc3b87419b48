"""Routes: one coroutine for each route of the plan, which runs as long as the plan has the route."""

import asyncio
import contextlib
import functools
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Mapping
from typing import TYPE_CHECKING, Any, assert_never

from hostlink.client import Host
from hostlink.components.graphs.ros2_qos import COMMANDS
from hostlink.components.graphs.wire_layout import ros1_layout, ros2_layout
from hostlink.components.ros2.conversion import (
    Conversion,
    Echoes,
    Fields,
    added_bytes,
    fill,
    load_type,
    nested_types,
    ros1_fields,
    ros2_fields,
    stamped,
    to_json,
)
from hostlink.components.ros2.plan import (
    TWIST_STAMPED,
    Caller,
    Feed,
    PublicationRoute,
    Reception,
    Route,
    Server,
    VelocityInput,
    publisher_qos,
)
from hostlink.components.ros2.velocity import Sent, VelocityDriver
from hostlink.core.messages.ros2_names import ros1_type, ros2_type
from hostlink.core.messages.serialisation import CDR
from hostlink.core.mirror.inbox import ThreadInbox
from hostlink.core.robot.velocity import Twist
from hostlink.core.runtime.log_budget import Budget
from hostlink.core.runtime.units import NS_PER_S
from hostlink.errors import BadPayload, HostlinkError

if TYPE_CHECKING:
    from hostlink.components.ros2.node import Ros2Node

INBOX_DEPTH = 64  # messages of a topic from ROS 2 that wait to be sent
COMMAND_INBOX_DEPTH = 8  # of all publishers of a velocity topic
CALL_TIMEOUT_S = 60.0  # of a service of ROS 2; as the daemon's for a program's


def definitions(type_name: str) -> dict[str, Fields]:
    """The fields of a message type and of all types in it, as the installed classes have them.

    Raises:
        HostlinkError: one is not installed, or ROS 1 has nothing like one of its fields.
    """
    found: dict[str, Fields] = {}
    wanted = [type_name]
    while wanted:
        name = wanted.pop()
        if name not in found:
            found[name] = ros2_fields(load_type(name).get_fields_and_field_types())
            wanted += nested_types(found[name])
    return found


class Routes:
    """Coroutines of the routes, with the node, the connection and the types that they share."""

    def __init__(self, node: "Ros2Node", host: Host, velocity: VelocityDriver) -> None:
        self._malformed = Budget()
        self._node, self._host, self._velocity = node, host, velocity
        self._conversion = Conversion()
        self._classes: dict[tuple[str, str], Any] = {}  # of rclpy's messages, by the daemon's type and ROS 2's
        self._echoes: defaultdict[str, Echoes] = defaultdict(Echoes)
        self._publishers: dict[PublicationRoute, asyncio.Future[Any]] = {}
        self._tasks: asyncio.TaskGroup | None = None

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Calls of services are answered for the length of the block."""
        async with asyncio.TaskGroup() as self._tasks:
            yield

    async def run(self, route: Route) -> None:
        """Run a route until it is cancelled.

        Raises:
            HostlinkError: a type is not installed or differs, or the daemon refuses.
        """
        match route:
            case PublicationRoute():
                await self._publish(route)
            case Feed():
                await self._feed(route.publication)
            case Reception():
                await self._receive(route)
            case VelocityInput():
                await self._drive(route)
            case Server():
                await self._serve(route)
            case Caller():
                await self._offer(route)
            case _:
                assert_never(route)

    async def _message_class(self, type_name: str, ros2: str) -> Any:
        """Return rclpy's class for a message type of the daemon, which `_conversion` knows from now on.

        Raises:
            HostlinkError: it is not installed, or another message has this name in ROS 2.
        """
        key = (type_name, ros2)
        if key not in self._classes:
            cls, types = load_type(ros2), definitions(ros2)
            answer = await self._host.call("/rosapi/message_details", {"type": type_name})
            here = ros1_layout(ros1_fields(answer["typedefs"]).get, type_name)
            added = added_bytes(here, ros2_layout(types.__getitem__, ros2))
            if added is None:
                raise HostlinkError(f"{ros2} has other fields in ROS 2 than {type_name} here: it is not converted")
            self._conversion.add(types, ros2, added_bytes=added)
            self._classes[key] = cls
        return self._classes[key]

    async def _publish(self, route: PublicationRoute) -> None:
        name = ros2_type(route.type_name)
        cls = load_type(name) if route.is_cdr else await self._message_class(route.type_name, name)
        qos = publisher_qos(route.topic, is_latched=route.is_latched)
        async with self._node.publisher(route.topic, cls, qos) as publisher:
            self._publisher_of(route).set_result(publisher)
            try:
                await asyncio.Event().wait()
            finally:
                del self._publishers[route]

    def _publisher_of(self, route: PublicationRoute) -> "asyncio.Future[Any]":
        """Both routes of a topic begin together: the publisher may not be there yet."""
        return self._publishers.setdefault(route, asyncio.get_running_loop().create_future())

    async def _feed(self, route: PublicationRoute) -> None:
        """Bytes of the daemon to ROS 2. Those that are CDR pass as they are."""
        publisher = await asyncio.shield(self._publisher_of(route))
        type_name, conversion = ros2_type(route.type_name), self._conversion
        has_header = not route.is_cdr and conversion.begins_with_header(type_name)
        echoes = self._echoes[route.topic]
        async with self._host.subscribe_raw(route.topic, type_name=route.type_name) as messages:
            async for message in messages:
                if (message.encoding == CDR) != route.is_cdr:  # the graph reports the change soon
                    continue
                try:
                    data = message.payload if route.is_cdr else conversion.to_cdr(message.payload, type_name)
                except BadPayload:
                    self._note_malformed(route.topic)
                    continue
                if has_header and (stamp := self._node.stamp()):
                    data = stamped(data, stamp)
                echoes.publish(data)
                publisher.publish(data)

    async def _receive(self, route: Reception) -> None:
        cls = await self._message_class(route.type_name, route.ros2_type)
        inbox: ThreadInbox[bytes] = ThreadInbox(max_waiting=INBOX_DEPTH)
        echoes = self._echoes[route.topic]
        async with (
            self._host.advertise(route.topic, route.type_name, is_latched=route.qos.is_latched),
            self._node.subscription(route.topic, cls, route.qos, functools.partial(inbox.put, ""), is_raw=True),
        ):
            async for data in inbox:
                if not echoes.is_echo(data):
                    await self._send(route, data)

    async def _send(self, route: Reception, data: bytes) -> None:
        try:
            payload = self._conversion.to_ros1(data, route.ros2_type)
        except BadPayload:
            self._note_malformed(route.topic)
            return
        await self._host.publish_raw(route.topic, payload, type_name=route.type_name)

    def _note_malformed(self, topic: str) -> None:
        if counts := self._malformed.due(topic, asyncio.get_running_loop().time()):
            self._node.warn(f"{topic}: messages that are not of the topic's type are left out: {counts.total()}")

    async def _drive(self, route: VelocityInput) -> None:
        cls, is_stamped = load_type(route.ros2_type), route.ros2_type == TWIST_STAMPED
        inbox: ThreadInbox[tuple[Any, Mapping[str, Any], float]] = ThreadInbox(max_waiting=COMMAND_INBOX_DEPTH)
        loop = asyncio.get_running_loop()

        def receive(message: Any, info: Mapping[str, Any]) -> None:
            """Note a velocity and its arrival. Called in rclpy's thread."""
            inbox.put("", (message, info, loop.time() - waited_s(info, time.time_ns())))

        with self._velocity.driving(route):
            async with self._node.subscription(route.topic, cls, COMMANDS, receive, is_raw=False):
                async for message, info, came_s in inbox:
                    twist = _twist(message.twist if is_stamped else message)
                    self._velocity.receive(route, twist, sender(route, info), came_s=came_s, sent=sent(info))

    async def _serve(self, route: Server) -> None:
        cls = load_type(ros2_type(route.type_name, "srv"))

        async def answer(request: Any, response: Any) -> Any:
            """Answer a request. Called in rclpy's thread."""
            pending = self._node.pending()
            self._node.post(self._call_daemon, route.service, to_json(request), pending)
            values = await pending
            _fill_response(response, values)
            return response

        async with self._node.service(route.service, cls, answer):
            await asyncio.Event().wait()

    def _call_daemon(self, service: str, request: Mapping[str, Any], pending: Any) -> None:
        assert self._tasks is not None  # noqa: S101 - in `running`
        self._tasks.create_task(self._finish_call(service, request, pending))

    async def _finish_call(self, service: str, request: Mapping[str, Any], pending: Any) -> None:
        values: Mapping[str, Any]
        try:
            values = await self._host.call(service, request, timeout_s=CALL_TIMEOUT_S)
        except HostlinkError as error:  # ROS 2 has no word for a call that failed
            values = {"success": False, "message": str(error)}
        pending.set_result(values)

    async def _offer(self, route: Caller) -> None:
        cls = load_type(route.ros2_type)
        async with self._node.client(route.service, cls) as client:
            answer = functools.partial(self._call_ros2, route, cls, client)
            async with self._host.serve(route.service, ros1_type(route.ros2_type), answer):
                await asyncio.Event().wait()

    async def _call_ros2(self, route: Caller, cls: Any, client: Any, values: Mapping[str, Any]) -> Mapping[str, Any]:
        request = cls.Request()
        fill(request, values)
        try:
            async with asyncio.timeout(CALL_TIMEOUT_S):
                return to_json(await self._node.call(client, request))
        except TimeoutError:
            raise HostlinkError(f"{route.service}: no answer from ROS 2 within {CALL_TIMEOUT_S:g} s") from None


def waited_s(info: Mapping[str, Any], now_ns: int) -> float:
    """Return how long a message waited until rclpy took it; 0 where the middleware does not tell when it came."""
    received_ns = int(info.get("received_timestamp") or 0)
    return max(now_ns - received_ns, 0) / NS_PER_S if received_ns > 0 else 0.0


def sent(info: Mapping[str, Any]) -> Sent:
    """Return what the middleware tells of a message's publication."""
    at_ns = int(info.get("source_timestamp") or 0)
    return Sent(at_ns / NS_PER_S if at_ns > 0 else None, info.get("publication_sequence_number"))


def sender(route: VelocityInput, info: Mapping[str, Any]) -> bytes | str:
    """Return the publisher of a message: its gid where rclpy knows it (since Kilted), else the topic."""
    gid = info.get("publisher_gid")
    return route.topic if gid is None else bytes(gid["data"])


def _twist(message: Any) -> Twist:
    linear, angular = message.linear, message.angular
    return Twist(*map(float, (linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)))


def _fill_response(response: Any, values: Mapping[str, Any]) -> None:
    """Fill a response without the values that do not fit: an error here would end rclpy's thread."""
    with contextlib.suppress(HostlinkError):
        fill(response, values)
