"""Host: a running hostlink as its users see it; and `connect`, which opens a connection to it."""

import asyncio
import base64
import concurrent.futures
import contextlib
import ssl
import weakref
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Generator, Mapping
from types import TracebackType
from typing import Any, NoReturn, cast

from hostlink.client.callers import own_context
from hostlink.client.cells import Names, watch_cells, watched
from hostlink.client.connection import HostConnection
from hostlink.client.driver import IDLE_TIMEOUT_S, Repeated, VelocitySender
from hostlink.client.http_client import (
    CLOSE_TIMEOUT_S,
    DEFAULT_PORT,
    REQUEST_TIMEOUT_S,
    HttpClient,
    endpoints,
    measured,
)
from hostlink.client.mailbox import Mailbox
from hostlink.client.robot import PRIORITY, WAIT_S, Robot
from hostlink.client.services import Answer, ProvidedServices
from hostlink.client.topics import RAW, Graphs, GraphWatch, RawSubscription, Subscription, Topics, read_raw
from hostlink.client.type_names import TypeName, type_name_of
from hostlink.client.views import ConnectionChange, Event, RobotState, Stopped, TopicState
from hostlink.core.robot.standstill import Standstill
from hostlink.core.runtime.cancellation import raise_if_cancelled
from hostlink.errors import BadRequest, HostlinkError, Refused, StopFailed

DEFAULT_URL = f"http://127.0.0.1:{DEFAULT_PORT}"

# -- host -------------------------------------------------------------------------------------------------------------


class Host:
    """Connection to a running hostlink, from `connect`."""

    def __init__(
        self,
        http: HttpClient,
        *,
        reconnect: bool,
        group: str = "",
        idle_timeout_s: float = IDLE_TIMEOUT_S,
        name: str = "",
    ) -> None:
        self.url = http.url
        self._http = http
        self._connection = HostConnection(http, reconnects=reconnect, group=group, name=name)
        self._connection.on_lost.append(self._lose)
        self._topics = Topics(self._connection)
        self._services = ProvidedServices(self._connection)
        self._graph = GraphWatch(self._connection)
        self._driver = VelocitySender(self._connection, http.callers, idle_timeout_s=idle_timeout_s)
        self._connection.on_open.append(self._report_return)
        self._ends_when_lost = not reconnect
        self._tasks: asyncio.TaskGroup | None = None  # while `running`
        self._loop: asyncio.AbstractEventLoop | None = None
        self._lost: HostlinkError | None = None
        self._watchers: weakref.WeakSet[Mailbox[ConnectionChange]] = weakref.WeakSet()

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Connect for the length of the block. `connect` uses it."""
        await self._connection.open()
        try:
            async with asyncio.TaskGroup() as tasks:
                self._services.begin(tasks)
                self._tasks, self._loop = tasks, asyncio.get_running_loop()
                watch_cells(self)
                own = own_context()
                reader = tasks.create_task(self._connection.run(), name="reader", context=own)
                repeater = tasks.create_task(self._driver.repeat(), name="repeater", context=own)
                try:
                    yield
                finally:
                    watched.discard(self)
                    self._tasks = None
                    repeater.cancel()
                    self._services.end()
                    await self._leave()
                    reader.cancel()
        except BaseExceptionGroup as group:  # what went wrong in the caller's block is the caller's own error
            raise_if_cancelled()  # TaskGroup drops a cancellation if there is an error, too
            raise group.exceptions[0] from None
        self._topics.raise_refusals()

    def __repr__(self) -> str:
        return f"<Host {self.url}: {'connected' if self.is_connected else 'not connected'}>"

    # -- reading -------------------------------------------------------------------------------------------------------

    async def robots(self) -> list[RobotState]:
        """Return the state of each robot: name, connected, holder, velocity (m/s, rad/s), odometry (m, rad)."""
        return cast(list[RobotState], (await self.get("/api/robots"))["robots"])

    async def topics(self) -> list[TopicState]:
        """Return each topic: name, type, publishers, subscribers, messages."""
        return cast(list[TopicState], (await self.get("/api/topics"))["topics"])

    async def links(self) -> list[dict[str, Any]]:
        """Return each live connection of a device, with its counters."""
        return cast(list[dict[str, Any]], (await self.get("/api/links"))["links"])

    def watch(self) -> AsyncGenerator[Event, None]:
        """Iterate over the state of the daemon: robots, links, clients, and the devices' log lines.

        The first values are the newest of each. Then follow `robots` when one changes, at most ten times a second,
        `links` and `clients` once a second, and each `log` line. The iteration pauses while the connection is lost;
        afterwards it has the newest 64 lines of the pause. A slow reader gets fewer states, always the newest.

        Raises:
            HostlinkError: in the iteration, hostlink refuses or was not reached; with `reconnect=False` also when the
                connection is lost.
        """
        return self._connection.events("/api/events")

    def robot(self, name: str, *, priority: int = PRIORITY) -> Robot:
        """Return a handle of the robot of that name. The first use tells whether the robot exists.

        `priority`, 0 to 100: a command of a higher priority takes the robot over, one of a lower priority is refused.
        Programs have 50, teleop has 60.
        """
        return Robot(name, priority, http=self._http, driver=self._driver, connection=self._connection)

    async def stop_all(self, *, wait_s: float = WAIT_S) -> Stopped:
        """Stop every robot, also those that other sources drive. Arguments and result are as for `Robot.stop`.

        Boards that are not robots are sent zeros, too. `endpoints` of the result has their topics, also those for
        which no zero exists.

        Raises:
            StopFailed: a robot could not be sent a zero, or another daemon of the fleet has not answered; its `stopped`
                says what became of each robot.
            HostlinkError: hostlink was not reached.
        """
        driven = self._driver.stop_repeating_all()
        try:
            return await self._halt_all("/api/stop", None, wait_s)
        finally:
            for name in driven:
                await self._driver.send_zero(name, PRIORITY)

    async def lock_all(self, reason: str, *, wait_s: float = WAIT_S) -> Stopped:
        """Lock every robot, and boards that are not robots, also those that connect later, until `unlock_all`.

        Each is stopped at once, without deceleration. Arguments and result are as for `stop_all`.

        Raises:
            StopFailed: as for `stop_all`. All that is reached is locked.
            HostlinkError: hostlink was not reached.
        """
        self._driver.stop_repeating_all()
        return await self._halt_all("/api/lock", {"reason": reason}, wait_s)

    async def _halt_all(self, path: str, body: Mapping[str, Any] | None, wait_s: float) -> Stopped:
        failure: StopFailed | None = None
        try:
            answer: Mapping[str, Any] = await self._http.request("POST", f"{path}?wait_s=0", body)
        except Refused as refused:
            if "robots" not in refused.answer:
                raise
            answer, failure = refused.answer, StopFailed(refused.kind, refused.reason, refused.answer)
        measured = await self.standstill(wait_s=wait_s) if wait_s > 0 else _measured(answer)
        stopped = Stopped(measured, endpoints(answer))
        if failure is None:
            return stopped
        failure.stopped = stopped
        raise failure

    async def unlock_all(self) -> list[RobotState]:
        """Admit commands to every robot and board again. No robot moves by this.

        Raises:
            HostlinkError: hostlink was not reached, or robots of several daemons have one name.
        """
        answer = await self._http.request("POST", "/api/unlock")
        for robot in answer["robots"]:
            self._driver.note_own_unlock(robot["name"], robot)
        return cast(list[RobotState], answer["robots"])

    async def standstill(self, *, wait_s: float = WAIT_S) -> dict[str, Standstill]:
        """Measure by new odometry, for at most `wait_s` seconds, whether each robot has stopped.

        Raises:
            HostlinkError: hostlink was not reached.
        """
        path = f"/api/standstill?wait_s={wait_s:g}"
        return _measured(await self._http.request("GET", path, timeout_s=wait_s + REQUEST_TIMEOUT_S))

    # -- topics and services ------------------------------------------------------------------------------------------

    async def publish(
        self, topic: str, message: Mapping[str, Any], *, type_name: TypeName = "", priority: int = PRIORITY
    ) -> None:
        """Publish one message. Missing fields are zero; numbers and arrays of numpy are accepted.

        `type_name` may be omitted when the topic is known. In all calls it is a name, such as "std_msgs/String", or a
        message class of genpy, rclpy or rosbags.

        Raises:
            HostlinkError: there is no connection, or an earlier message on this topic was refused. The refusal of the
                last one is raised by `settle`, and at the end of the connection's block.
        """
        await self._topics.publish(topic, {"msg": message}, type_name_of(type_name), priority)

    async def publish_raw(
        self, topic: str, payload: bytes, *, type_name: TypeName = "", priority: int = PRIORITY
    ) -> None:
        """Publish one message in the serialisation of ROS 1.

        Raises:
            HostlinkError: there is no connection, or an earlier message on this topic was refused.
        """
        raw = base64.b64encode(payload).decode()
        await self._topics.publish(topic, {"raw": raw}, type_name_of(type_name), priority)

    def pop_refusal(self, topic: str) -> str:
        """Return the reason for which a message on the topic was refused since the last call; empty if none was."""
        return self._topics.pop_refusal(topic)

    def advertise(
        self, topic: str, type_name: TypeName, *, is_latched: bool = False
    ) -> contextlib.AbstractAsyncContextManager[None]:
        """Advertise a topic for the length of the block. It is advertised again after a lost connection.

        With `is_latched` programs that subscribe later get the last message.

        Raises:
            HostlinkError: at the begin of the block, there is no connection. The next `publish` raises for an
                unknown type.
        """
        return self._topics.advertise(topic, type_name_of(type_name), is_latched=is_latched)

    def subscribe(
        self,
        topic: str,
        *,
        type_name: TypeName = "",
        throttle_rate_ms: int = 0,
        queue_length: int = 0,
        timeout_s: float | None = None,
    ) -> contextlib.AbstractAsyncContextManager[Subscription]:
        """Subscribe to a topic for the length of the block. It is subscribed to again after a lost connection.

        Args:
            topic: name of the topic.
            type_name: its type; may be omitted when the topic is known.
            throttle_rate_ms: shortest time between two messages, in milliseconds.
            queue_length: number of newest messages that wait meanwhile.
            timeout_s: longest wait for one message, in seconds; None: no limit.

        Returns:
            A block whose value iterates over the messages, as dicts (docs/api.md). Its newest 256 messages wait for
            the block; `dropped` counts the others.

        Raises:
            HostlinkError: at the begin of the block, there is no connection; in the iteration, the subscription was
                refused.
            NothingArrived: in the iteration, no message arrived within `timeout_s`. The iteration may go on.
        """
        options = {"throttle_rate": throttle_rate_ms, "queue_length": queue_length}
        return self._topics.subscribe(topic, type_name_of(type_name), options, lambda message: message, timeout_s)

    def subscribe_raw(
        self, topic: str, *, type_name: TypeName = "", timeout_s: float | None = None
    ) -> contextlib.AbstractAsyncContextManager[RawSubscription]:
        """Subscribe to a topic's messages as bytes, with the time at which each reached the daemon; as `subscribe`.

        Do not combine it with a `subscribe` to the same topic on one connection: the daemon sends each message once,
        in one form.

        Raises:
            HostlinkError: at the begin of the block, there is no connection; in the iteration, the subscription was
                refused.
        """
        return self._topics.subscribe(topic, type_name_of(type_name), RAW, read_raw, timeout_s)

    async def watch_graph(self) -> Graphs:
        """Return an iteration over the topics, services and robots outside of this connection's group.

        The first value is the present graph; another one follows after each change (docs/api.md has the fields). The
        iteration lasts as long as the reader keeps it, and continues after a lost connection.

        Raises:
            HostlinkError: at the begin, there is no connection.
        """
        return await self._graph.watch()

    def serve(self, service: str, type_name: TypeName, answer: Answer) -> contextlib.AbstractAsyncContextManager[None]:
        """Provide a service for the length of the block. It is provided again after a lost connection.

        `answer`, a function or a coroutine function, receives the request and returns the response, both as dicts.
        None is an empty response. A HostlinkError that it raises fails the call.

        Raises:
            HostlinkError: at the begin of the block, there is no connection.
        """
        return self._services.serve(service, type_name_of(type_name), answer)

    async def call(
        self, service: str, arguments: Mapping[str, Any] | None = None, *, timeout_s: float = REQUEST_TIMEOUT_S
    ) -> Any:
        """Call a service and return its response. Missing fields of the request are zero.

        Raises:
            Refused: the service does not exist, failed, or did not answer within `timeout_s` seconds. Its `kind` is
                UnknownTopic, ServiceFailed, DeviceBusy, DeviceGone, BadRequest ...
            HostlinkError: the connection was lost meanwhile. It is unknown whether the service ran; it is not called
                again.
        """
        request = {"op": "call_service", "service": service, "args": arguments or {}, "timeout": timeout_s}
        answer = await self._connection.request(request, timeout_s=timeout_s + CLOSE_TIMEOUT_S)
        if not answer["result"]:
            raise Refused(str(answer.get("kind", Refused.kind)), str(answer["values"]))  # an older daemon sends no kind
        return answer["values"]

    # -- the connection -----------------------------------------------------------------------------------------------

    @property
    def is_connected(self) -> bool:
        """Whether the connection is open. A cut is noticed within a second."""
        return self._connection.is_connected

    def connection(self) -> Mailbox[ConnectionChange]:
        """Return an iteration over losses and returns of the connection, with the robots whose drive ended."""
        watcher: Mailbox[ConnectionChange] = Mailbox("changes of the connection", self._connection.callers.note)
        self._watchers.add(watcher)
        return watcher

    async def get(self, path: str) -> dict[str, Any]:
        """Send a GET request to the REST API, and return the answer.

        Raises:
            HostlinkError: the daemon refuses, with its reason; or it was not reached.
        """
        return await self._http.request("GET", path)

    async def post(self, path: str, body: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Send a POST request to the REST API, and return the answer.

        Raises:
            HostlinkError: the daemon refuses, with its reason; or it was not reached.
        """
        return await self._http.request("POST", path, body)

    def download(self, path: str) -> AsyncIterator[bytes]:
        """Iterate over the pieces of a file, for example of a recording. There is no time limit.

        Raises:
            HostlinkError: the daemon refuses, with its reason; it was not reached, or the connection is lost.
        """
        return self._http.download(path)

    async def send(self, request: Mapping[str, Any]) -> None:
        """Send one operation of rosbridge.

        Raises:
            HostlinkError: there is no connection.
        """
        await self._connection.send(request)

    async def settle(self) -> None:
        """Wait until the daemon has read everything that was sent so far.

        Raises:
            HostlinkError: a published message was refused, and the refusal was not reported yet; there is no
                connection, or it is lost meanwhile.
        """
        await self._round_trip()
        self._topics.raise_refusals()

    async def stop_driven(self, is_meant: Callable[[Repeated], bool] | None = None) -> tuple[str, ...]:
        """Let go of the robots that this connection drives, and return their names. They stop.

        The call takes at most a second. Then nothing is repeated, and the daemon stops the rest. `is_meant` selects
        some of the velocities.
        """
        names = self._driver.give_up(is_meant)
        await self._driver.let_go(names, PRIORITY)
        return names

    def end_cell(self, *, has_failed: bool) -> Names | None:
        """Stop the robots that ended tasks of a notebook's cell drove without `keep`; after an error, all of them.

        A loop that does not run between cells, such as IPython's in a terminal, repeats nothing: the daemon stops its
        robots. The connection of a LoopThread has its own loop.
        """
        if self._tasks is None or asyncio.events._get_running_loop() is not self._loop:  # noqa: SLF001 - None, no error
            return None
        names = self._driver.give_up(None if has_failed else Repeated.is_of_ended_task)
        self._tasks.create_task(self._driver.let_go(names, PRIORITY), name="end of a cell")
        stopped: Names = concurrent.futures.Future()
        stopped.set_result(names)
        return stopped

    async def _round_trip(self) -> None:
        self._topics.is_settled = True  # nothing that is published from now on
        await self._connection.request({"op": "call_service", "service": "/rosapi/get_time", "args": {}})

    async def _report_return(self) -> None:
        if self._lost is not None:
            self._lost = None
            self._report(ConnectionChange(is_connected=True, reason=""))

    def _lose(self, lost: HostlinkError) -> None:
        self._lost = lost
        self._http.cut_streams()
        dropped = self._driver.break_all(str(lost))
        if self._ends_when_lost:
            self._topics.end(lost)
        self._report(ConnectionChange(is_connected=False, reason=str(lost), dropped=dropped))

    def _report(self, change: ConnectionChange) -> None:
        for watcher in self._watchers:
            watcher.put(change)

    async def _leave(self) -> None:
        """Stop the robots that are driven, and wait for refusals. After a lost connection they have stopped already."""
        await self.stop_driven()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                if not self._topics.is_settled:
                    with contextlib.suppress(HostlinkError):  # the connection is gone
                        await self._round_trip()
                await self._connection.aclose()


def _measured(answer: Mapping[str, Any]) -> dict[str, Standstill]:
    return {robot["name"]: measured(robot) for robot in answer["robots"]}


# -- connecting -------------------------------------------------------------------------------------------------------

_ADVICE = (
    "is not open yet: write `async with hostlink.client.connect() as host:`; "
    "without asyncio `with hostlink.client.connect_blocking() as host:`"
)


def connect(
    url: str = DEFAULT_URL,
    *,
    token: str | None = None,
    ssl: ssl.SSLContext | None = None,
    reconnect: bool = True,
    group: str = "",
    idle_timeout_s: float = IDLE_TIMEOUT_S,
    name: str = "",
) -> "Connecting":
    """Connect to hostlink for the length of the block. At its end every robot that it drives stops.

    Args:
        url: http, https, ws or wss.
        token: one of the daemon's configuration; also as `?token=` in the URL.
        ssl: context that trusts a certificate of your own.
        reconnect: connect again after a lost connection, with all subscriptions and advertisements. Velocities are
            never resumed. False: every wait for a message raises.
        group: name of a bridge to another graph, such as ROS 2. Connections of one group do not receive each other's
            messages.
        idle_timeout_s: a robot that is driven stops when the thread (with asyncio: the task) that drives it has made
            no call for so many seconds; `math.inf`: no limit.
        name: name of this program, which is shown as the holder of a robot.

    Raises:
        HostlinkError: at the begin of the block, there is no hostlink at `url`, or it refuses; at its end, a message
            that was published in it was refused.
    """
    connected = _connected(url, token, ssl, reconnect=reconnect, group=group, idle_timeout_s=idle_timeout_s, name=name)
    return Connecting(url, connected)


class Connecting(contextlib.AbstractAsyncContextManager[Host]):
    """Connection that is not open yet. `async with` opens it; every other use raises an error that says so."""

    def __init__(self, url: str, connected: contextlib.AbstractAsyncContextManager[Host]) -> None:
        self._url, self._connected = url, connected

    async def __aenter__(self) -> Host:
        """Open the connection."""
        return await self._connected.__aenter__()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> bool | None:
        """Stop the robots that are driven, and close the connection."""
        return await self._connected.__aexit__(kind, error, traceback)

    def __enter__(self) -> NoReturn:
        """Refuse `with`, which is not `async with`."""
        raise HostlinkError(f"{self!r} {_ADVICE}")

    def __exit__(self, *_: object) -> None:
        """Do nothing: Python looks for this method before it enters."""

    def __await__(self) -> Generator[Any, Any, NoReturn]:
        """Refuse `await connect()`."""
        raise HostlinkError(f"{self!r} {_ADVICE}")

    def __getattr__(self, name: str) -> NoReturn:
        """Refuse calls such as `connect().robots()`."""
        raise AttributeError(f"{name!r}: {self!r} {_ADVICE}")

    def __repr__(self) -> str:
        return f"<connect to {self._url}>"


@contextlib.asynccontextmanager
async def _connected(
    url: str,
    token: str | None,
    context: ssl.SSLContext | None,
    *,
    reconnect: bool,
    group: str,
    idle_timeout_s: float,
    name: str,
) -> AsyncIterator[Host]:
    if not idle_timeout_s > 0.0:
        raise BadRequest(f"idle_timeout_s is {idle_timeout_s:g}; pass a positive number of seconds, or math.inf")
    http = HttpClient(url, token, context)
    try:
        host = Host(http, reconnect=reconnect, group=group, idle_timeout_s=idle_timeout_s, name=name)
        async with host.running():
            yield host
    finally:
        await http.aclose()
