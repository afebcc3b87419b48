"""The client for programs without asyncio, and for notebooks: Host and Robot, whose methods a LoopThread runs."""

import contextlib
import functools
import inspect
import ssl
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar

from hostlink.client.driver import IDLE_TIMEOUT_S
from hostlink.client.host import DEFAULT_URL, Host, connect
from hostlink.client.loop_thread import LoopThread, Messages, Opened, PlainAnswer, Stream, in_thread
from hostlink.client.mailbox import Mailbox
from hostlink.client.robot import PRIORITY, Robot
from hostlink.client.type_names import TypeName
from hostlink.client.views import ConnectionChange, Refusal
from hostlink.errors import HostlinkError

Inner = TypeVar("Inner")
Result = TypeVar("Result")
Item = TypeVar("Item")
P = ParamSpec("P")


class Blocking(Generic[Inner]):
    """Object with asynchronous methods, and the thread that runs them."""

    def __init__(self, loop: LoopThread, inner: Inner) -> None:
        self._loop, self._inner = loop, inner


# Each of these returns a method with the arguments and the docstring of an asynchronous one, which type checkers know.


def _blocking(
    method: Callable[Concatenate[Inner, P], Coroutine[Any, Any, Result]],
) -> Callable[Concatenate[Blocking[Inner], P], Result]:
    @functools.wraps(method)
    def call(self: Blocking[Inner], /, *args: P.args, **kwargs: P.kwargs) -> Result:
        return self._loop.run(method(self._inner, *args, **kwargs))

    return call


def _reporting(
    method: Callable[Concatenate[Inner, P], Coroutine[Any, Any, Result]],
) -> Callable[Concatenate[Blocking[Inner], P], Result]:
    """Return a method that calls `on_progress` in the calling thread."""

    @functools.wraps(method)
    def call(self: Blocking[Inner], /, *args: P.args, **kwargs: P.kwargs) -> Result:
        on_progress: Any = kwargs.pop("on_progress", None)
        begin: Callable[..., Coroutine[Any, Any, Result]] = functools.partial(method, self._inner, *args, **kwargs)
        return self._loop.run_reporting(lambda report: begin(on_progress=report), on_progress)

    return call


def _stream(
    method: Callable[Concatenate[Inner, P], AsyncIterator[Item]],
) -> Callable[Concatenate[Blocking[Inner], P], Stream[Item]]:
    @functools.wraps(method)
    def call(self: Blocking[Inner], /, *args: P.args, **kwargs: P.kwargs) -> Stream[Item]:
        return Stream(self._loop, method(self._inner, *args, **kwargs), method.__name__)

    return _returning(Stream, call)


def _messages(
    method: Callable[Concatenate[Inner, P], contextlib.AbstractAsyncContextManager[Mailbox[Item]]],
) -> Callable[Concatenate[Blocking[Inner], P], Messages[Item]]:
    @functools.wraps(method)
    def call(self: Blocking[Inner], /, *args: P.args, **kwargs: P.kwargs) -> Messages[Item]:
        return Messages(self._loop, method(self._inner, *args, **kwargs))

    return _returning(Messages, call)


def _returning(made: type, call: Callable[P, Result]) -> Callable[P, Result]:
    """Let `help()` name what the method returns, instead of what the asynchronous one does."""
    call.__signature__ = inspect.signature(call).replace(return_annotation=made)  # type: ignore[attr-defined]
    return call


class BlockingRobot(Blocking[Robot]):
    """Handle of one robot of a host, from `BlockingHost.robot`."""

    @property
    def name(self) -> str:
        """Name without a slash."""
        return self._inner.name

    @property
    def priority(self) -> int:
        """Priority of its commands, 0 to 100."""
        return self._inner.priority

    @property
    def is_driven(self) -> bool:
        """Whether this connection holds a velocity of the robot."""
        return self._inner.is_driven

    @property
    def client_name(self) -> str | None:
        """Name of this connection at the daemon, as `holder` of `state()` shows it; None before the first command."""
        return self._inner.client_name

    @property
    def refusal(self) -> Refusal | None:
        """Reason why the newest answered `command` was refused; None if it was accepted."""
        return self._inner.refusal

    state = _blocking(Robot.state)
    drive = _blocking(Robot.drive)
    move = _reporting(Robot.move)
    turn = _reporting(Robot.turn)
    command = _blocking(Robot.command)
    stop = _blocking(Robot.stop)
    lock = _blocking(Robot.lock)
    unlock = _blocking(Robot.unlock)
    reset_odometry = _blocking(Robot.reset_odometry)
    odometry = _stream(Robot.odometry)

    def __repr__(self) -> str:
        return repr(self._inner).replace("Robot", "BlockingRobot", 1)


class BlockingHost(Blocking[Host]):
    """Connection to a running hostlink, from `connect_blocking`. All threads may use it."""

    def __init__(self, loop: LoopThread) -> None:
        super().__init__(loop, loop.host)

    @property
    def url(self) -> str:
        """Address of the daemon."""
        return self._inner.url

    @property
    def is_connected(self) -> bool:
        """Whether the connection is open. A cut is noticed within a second."""
        return self._inner.is_connected

    robots = _blocking(Host.robots)
    topics = _blocking(Host.topics)
    links = _blocking(Host.links)
    watch = _stream(Host.watch)
    stop_all = _blocking(Host.stop_all)
    lock_all = _blocking(Host.lock_all)
    unlock_all = _blocking(Host.unlock_all)
    standstill = _blocking(Host.standstill)
    publish = _blocking(Host.publish)
    publish_raw = _blocking(Host.publish_raw)
    subscribe = _messages(Host.subscribe)
    subscribe_raw = _messages(Host.subscribe_raw)
    call = _blocking(Host.call)
    get = _blocking(Host.get)
    post = _blocking(Host.post)
    download = _stream(Host.download)
    send = _blocking(Host.send)
    settle = _blocking(Host.settle)

    def robot(self, name: str, *, priority: int = PRIORITY) -> BlockingRobot:
        """Return a handle of the robot of that name. The first use tells whether the robot exists.

        `priority`, 0 to 100: a command of a higher priority takes the robot over, one of a lower priority is refused.
        Programs have 50, teleop has 60.
        """
        return BlockingRobot(self._loop, self._inner.robot(name, priority=priority))

    def pop_refusal(self, topic: str) -> str:
        """Return the reason for which a message on the topic was refused since the last call; empty if none was."""
        return self._inner.pop_refusal(topic)

    def advertise(self, topic: str, type_name: TypeName, *, is_latched: bool = False) -> Opened:
        """Advertise a topic until the end of the block or `close`. It is advertised again after a lost connection.

        With `is_latched` programs that subscribe later get the last message.

        Raises:
            HostlinkError: at the begin of the block, there is no connection. The next `publish` raises for an
                unknown type.
        """
        return Opened(self._loop, self._inner.advertise(topic, type_name, is_latched=is_latched), topic)

    def serve(self, service: str, type_name: TypeName, answer: PlainAnswer) -> Opened:
        """Provide a service until the end of the block or `close`. It is provided again after a lost connection.

        `answer` is called in its own thread with the request, and returns the response, both as dicts. None is an
        empty response. A HostlinkError that it raises fails the call.

        Raises:
            HostlinkError: at the begin of the block, there is no connection.
        """
        return Opened(self._loop, self._inner.serve(service, type_name, in_thread(answer)), service)

    def watch_graph(self) -> Messages[dict[str, Any]]:
        """Return an iteration over the topics, services and robots outside of this connection's group.

        The first value is the present graph; another one follows after each change (docs/api.md has the fields). The
        iteration lasts as long as the reader keeps it, and continues after a lost connection.

        Raises:
            HostlinkError: at the begin, there is no connection.
        """
        return Messages(self._loop, contextlib.nullcontext(self._loop.run(self._inner.watch_graph())))

    def connection(self) -> Messages[ConnectionChange]:
        """Return an iteration over losses and returns of the connection, with the robots whose drive ended."""
        return Messages(self._loop, contextlib.nullcontext(self._loop.call(self._inner.connection)))

    def close(self) -> None:
        """Close the connection. The robots that it drives stop.

        Raises:
            HostlinkError: a published message was refused, and the refusal was not reported yet.
        """
        self._loop.close()

    def __enter__(self) -> "BlockingHost":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the connection. An error in the block takes precedence over one that `close` raises."""
        try:
            self.close()
        except HostlinkError:
            if kind is None:
                raise

    def __repr__(self) -> str:
        return repr(self._inner).replace("Host", "BlockingHost", 1)


def connect_blocking(
    url: str = DEFAULT_URL,
    *,
    token: str | None = None,
    ssl: ssl.SSLContext | None = None,
    reconnect: bool = True,
    group: str = "",
    idle_timeout_s: float = IDLE_TIMEOUT_S,
    name: str = "",
) -> BlockingHost:
    """Connect to hostlink from a program without asyncio: `with connect_blocking() as host:`.

    Without `with` the connection stays open until `close()`, also between the cells of a notebook. Every robot that it
    drives stops at the end of the block or the program, after an error or Ctrl-C in a cell, and when the last reference
    to the connection is deleted. The arguments are those of `connect`.

    Raises:
        HostlinkError: there is no hostlink at `url`, or it refuses.
    """
    connecting = connect(
        url, token=token, ssl=ssl, reconnect=reconnect, group=group, idle_timeout_s=idle_timeout_s, name=name
    )
    return BlockingHost(LoopThread(connecting))
