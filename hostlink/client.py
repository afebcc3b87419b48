"""The Python API for people who drive robots: what a script needs of a running hostlink, over its WebSocket and REST.

async with hostlink.client.connect() as host:
    robot = host.robot("robot_0")
    await robot.drive(0.2, 0.5)              # m/s, rad/s; holds until the next drive, stop, or the end of the block
    async for pose in robot.odometry():
        print(pose["pose"]["x_m"])
"""

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Mapping
from typing import Any

import aiohttp
import msgspec

from hostlink.errors import HostlinkError

DEFAULT_URL = "http://127.0.0.1:9090"
REPEAT_INTERVAL_S = 0.1  # a fifth of the lease that a command has
ODOMETRY_INTERVAL_S = 0.1
CLOSE_TIMEOUT_S = 1.0
REQUEST_TIMEOUT_S = 5.0
QUEUE_MESSAGES = 256  # of one subscription; a reader that is slower loses the oldest
PRIORITY = 50


@contextlib.asynccontextmanager
async def connect(url: str = DEFAULT_URL) -> AsyncIterator["Host"]:
    """A connection to hostlink for the length of the block. Leaving it stops every robot that it drives.

    Raises HostlinkError when there is no hostlink at `url`.
    """
    timeout = aiohttp.ClientTimeout(total=REQUEST_TIMEOUT_S)
    async with aiohttp.ClientSession(timeout=timeout) as session:
        try:
            socket = await session.ws_connect(url, heartbeat=REQUEST_TIMEOUT_S)
        except (aiohttp.ClientError, OSError, ValueError) as error:
            raise HostlinkError(f"no hostlink at {url}: is `hostlink serve` running there? ({error})") from error
        host = Host(url, session, socket)
        try:
            async with asyncio.TaskGroup() as tasks:
                reader = tasks.create_task(host.read(), name="reader")
                repeater = tasks.create_task(host.repeat(), name="repeater")
                try:
                    await host.send({"op": "set_level", "level": "error"})
                    yield host
                finally:
                    repeater.cancel()
                    with contextlib.suppress(HostlinkError):  # a connection that is gone has stopped the robots already
                        await host.stop_all()
                    reader.cancel()
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(CLOSE_TIMEOUT_S):
                            await socket.close()
        except BaseExceptionGroup as group:  # what went wrong in the caller's block is the caller's own error
            raise group.exceptions[0] from None


class Subscription:
    """The messages of a topic, as an asynchronous iterator; `dropped` counts what this reader was too slow for."""

    def __init__(self) -> None:
        self.dropped = 0
        self._queue: asyncio.Queue[dict[str, Any] | HostlinkError] = asyncio.Queue(QUEUE_MESSAGES)

    def put(self, item: dict[str, Any] | HostlinkError) -> None:
        """Add a message, or the error that ends the iteration."""
        if self._queue.full():
            self._queue.get_nowait()
            self.dropped += 1
        self._queue.put_nowait(item)

    def __aiter__(self) -> "Subscription":
        return self

    async def __anext__(self) -> dict[str, Any]:
        item = await self._queue.get()
        if isinstance(item, HostlinkError):
            raise item
        return item


class Host:
    """A running hostlink. Get one from `connect`."""

    def __init__(self, url: str, session: aiohttp.ClientSession, socket: aiohttp.ClientWebSocketResponse) -> None:
        self.url = url
        self._session, self._socket = session, socket
        self._numbers = itertools.count(1)
        self._subscriptions: dict[str, set[Subscription]] = {}
        self._answers: dict[str, asyncio.Future[dict[str, Any]]] = {}
        self._refusals: dict[str, str] = {}
        self._held: dict[str, Robot] = {}
        self._lost: HostlinkError | None = None

    # -- asking -------------------------------------------------------------------------------------------------------

    async def robots(self) -> list[dict[str, Any]]:
        """Every robot: name, connected, holder, velocity, odometry."""
        found: list[dict[str, Any]] = (await self.get("/api/robots"))["robots"]
        return found

    async def topics(self) -> list[dict[str, Any]]:
        """Every topic: name, type, publishers, subscribers, messages."""
        found: list[dict[str, Any]] = (await self.get("/api/topics"))["topics"]
        return found

    async def links(self) -> list[dict[str, Any]]:
        """Every live connection of a device, with its counters."""
        found: list[dict[str, Any]] = (await self.get("/api/links"))["links"]
        return found

    def robot(self, name: str) -> "Robot":
        """The robot of that name; that it exists is found out by the first use."""
        return Robot(self, name)

    # -- topics and services ------------------------------------------------------------------------------------------

    async def publish(
        self, topic: str, message: Mapping[str, Any], *, type_name: str = "", priority: int = PRIORITY
    ) -> None:
        """Send one message. A refusal of an earlier one on this topic is raised here."""
        refusal = self.take_refusal(topic)
        if refusal:
            raise HostlinkError(refusal)
        request = {"op": "publish", "id": f"publish:{topic}", "topic": topic, "msg": message, "priority": priority}
        await self.send(request | ({"type": type_name} if type_name else {}))

    def take_refusal(self, topic: str) -> str:
        """Why a message that was published on the topic was refused since the last call; empty if none was."""
        return self._refusals.pop(topic, "")

    @contextlib.asynccontextmanager
    async def subscribe(
        self, topic: str, *, type_name: str = "", throttle_rate_ms: int = 0, queue_length: int = 0
    ) -> AsyncIterator[Subscription]:
        """The messages of a topic, from now on, for the length of the block."""
        subscription = Subscription()
        self._subscriptions.setdefault(topic, set()).add(subscription)
        request = {"op": "subscribe", "topic": topic, "throttle_rate": throttle_rate_ms, "queue_length": queue_length}
        await self.send(request | ({"type": type_name} if type_name else {}))
        try:
            yield subscription
        finally:
            self._subscriptions[topic].discard(subscription)
            if not self._subscriptions[topic] and self._lost is None:
                await self.send({"op": "unsubscribe", "topic": topic})

    async def call(self, service: str, arguments: Mapping[str, Any], *, timeout_s: float = REQUEST_TIMEOUT_S) -> Any:
        """Call a service; returns its response, raises HostlinkError with the reason when it failed."""
        key = f"call:{next(self._numbers)}"
        answer = self._answers[key] = asyncio.get_running_loop().create_future()
        try:
            request = {"op": "call_service", "id": key, "service": service, "args": arguments, "timeout": timeout_s}
            await self.send(request)
            async with asyncio.timeout(timeout_s + CLOSE_TIMEOUT_S):
                found = await answer
        except TimeoutError:
            raise HostlinkError(f"{service}: hostlink did not answer within {timeout_s:g} s") from None
        finally:
            del self._answers[key]
        if not found["result"]:
            raise HostlinkError(str(found["values"]))
        return found["values"]

    # -- the connection -----------------------------------------------------------------------------------------------

    async def get(self, path: str) -> dict[str, Any]:
        """A GET of the REST door."""
        return await self._request("GET", path)

    async def post(self, path: str) -> dict[str, Any]:
        """A POST of the REST door."""
        return await self._request("POST", path)

    async def send(self, request: Mapping[str, Any]) -> None:
        """Send one rosbridge operation."""
        if self._lost is not None:
            raise self._lost
        try:
            await self._socket.send_str(msgspec.json.encode(request).decode())
        except (aiohttp.ClientError, OSError) as error:
            raise self._lose() from error

    async def read(self) -> None:
        """Hand out what the host says, until the connection ends."""
        async for message in self._socket:
            if message.type is aiohttp.WSMsgType.TEXT:
                self._take(msgspec.json.decode(message.data))
        self._lose()

    async def repeat(self) -> None:
        """Keep the commands of the robots that are driven alive."""
        while self._lost is None:
            for robot in list(self._held.values()):
                with contextlib.suppress(HostlinkError):  # the next `drive` tells its caller
                    await robot.repeat()
            await asyncio.sleep(REPEAT_INTERVAL_S)

    def hold(self, robot: "Robot") -> None:
        """Repeat this robot's command from now on."""
        self._held[robot.name] = robot

    def let_go(self, robot: "Robot") -> None:
        """Repeat it no more."""
        self._held.pop(robot.name, None)

    async def stop_all(self) -> None:
        """Stop every robot that this connection drives."""
        for robot in list(self._held.values()):
            await robot.stop()

    def _take(self, message: dict[str, Any]) -> None:
        match message.get("op"):
            case "publish":
                for subscription in self._subscriptions.get(message["topic"], ()):
                    subscription.put(message["msg"])
            case "service_response" if (answer := self._answers.get(message.get("id", ""))) and not answer.done():
                answer.set_result(message)
            case "status":
                self._refusals[str(message.get("id", "")).removeprefix("publish:")] = message["msg"]

    def _lose(self) -> HostlinkError:
        """The connection is gone: everybody who waits for it is told."""
        if self._lost is None:
            self._lost = HostlinkError(f"the connection to hostlink at {self.url} is lost")
            for subscription in itertools.chain.from_iterable(self._subscriptions.values()):
                subscription.put(self._lost)
            for answer in self._answers.values():
                if not answer.done():
                    answer.set_exception(self._lost)
        return self._lost

    async def _request(self, method: str, path: str) -> dict[str, Any]:
        try:
            async with self._session.request(method, self.url + path) as response:
                body: dict[str, Any] = msgspec.json.decode(await response.read())
        except (aiohttp.ClientError, OSError, msgspec.DecodeError) as error:
            raise HostlinkError(f"no answer from hostlink at {self.url}: {error}") from error
        if "error" in body:
            raise HostlinkError(body["error"]["reason"])
        return body


class Robot:
    """One robot of a host."""

    def __init__(self, host: Host, name: str) -> None:
        self.name = name
        self._host = host
        self._topic: str | None = None
        self._command: dict[str, Any] = {}

    async def state(self) -> dict[str, Any]:
        """Connected, holder, velocity, odometry, as they are now."""
        return await self._host.get(f"/api/robots/{self.name}")

    async def drive(self, linear_m_s: float, angular_rad_s: float) -> None:
        """Drive until the next `drive` or `stop`, or until the connection's block is left.

        The command is repeated ten times a second. HostlinkError when an earlier command was refused.
        """
        self._command = {"linear": {"x": linear_m_s}, "angular": {"z": angular_rad_s}}
        await self.repeat()
        self._host.hold(self)

    async def repeat(self) -> None:
        """Send the command once more."""
        if self._topic is None:
            self._topic = (await self.state())["velocity_topic"]
        await self._host.publish(self._topic, self._command, type_name="geometry_msgs/Twist")

    async def stop(self) -> None:
        """Stop, whoever drives."""
        self._host.let_go(self)
        await self._host.post(f"/api/robots/{self.name}/stop")

    async def reset_odometry(self) -> None:
        """Make the present place the origin."""
        await self._host.post(f"/api/robots/{self.name}/odometry/reset")

    async def odometry(self) -> AsyncIterator[dict[str, Any]]:
        """Pose (m, rad), twist, wall stamp, age and rate, each time that the robot has told a new pose."""
        count = -1
        while True:
            state = (await self.state())["odometry"]
            if state is not None and state["count"] != count:
                count = state["count"]
                yield state
            await asyncio.sleep(ODOMETRY_INTERVAL_S)
