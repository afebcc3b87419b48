"""WebSocket to the daemon, opened again whenever it is lost. Requests and answers are known here, robots are not."""

import asyncio
import contextlib
import itertools
import random
import socket
import struct
from collections import defaultdict
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Iterator, Mapping
from typing import Any

import aiohttp
import cbor2
import msgspec
from aiohttp import WSMsgType

from hostlink.client.http_client import REQUEST_TIMEOUT_S, EventStream, HttpClient, encode
from hostlink.client.views import Event
from hostlink.errors import HostlinkError, Refused

PING_INTERVAL_S = 0.2
SILENCE_S = 0.6  # three pings without an answer; the robot's lease is 0.5 s, so it has stopped by then
SECOND_CHANCE_S = 0.25  # for a pong when it was this program that did not run
LATE_S = 0.1  # a timer that is later: this program did not run
FIRST_WAIT_S = 0.05
LONGEST_WAIT_S = 1.0
ATTEMPT_TIMEOUT_S = 1.0
_NO_LINGER = struct.pack("ii", 1, 0)

Message = dict[str, Any]


class HostConnection:
    """WebSocket with reconnection. `run` must run while it is used.

    | state     | event                               | next      | then                                             |
    |-----------|-------------------------------------|-----------|--------------------------------------------------|
    | connected | closed by the other side, an error  | lost      | `on_lost`; who waits for an answer gets an error |
    | connected | nothing heard for SILENCE_S         | lost      | the same; what was not sent yet is thrown away   |
    | lost      | a WebSocket is open                 | connected | `on_open`                                        |
    | lost      | `send`, `request`                   | lost      | HostlinkError                                    |
    """

    def __init__(self, http: HttpClient, *, reconnects: bool, group: str = "", name: str = "") -> None:
        self.is_connected = False
        self.handlers: defaultdict[str, list[Callable[[Message], None]]] = defaultdict(
            list
        )  # by op, for messages that do not answer a `request`
        self.on_open: list[Callable[[], Awaitable[None]]] = []
        self.on_lost: list[Callable[[HostlinkError], None]] = []
        # Requests of blocks by key, the newest last. After each reconnection the newest of each key is sent again.
        self._kept: dict[str, dict[object, Mapping[str, Any]]] = {}
        self.callers = http.callers
        self._http = http
        self._reconnects, self._group, self._name = reconnects, group, name
        self._socket: aiohttp.ClientWebSocketResponse | None = None
        self._reason = "not open yet"
        self._numbers = itertools.count(1)
        self._answers: dict[str, asyncio.Future[Message | None]] = {}
        self._is_open = asyncio.Event()

    async def open(self) -> None:
        """Connect.

        Raises:
            HostlinkError: that cannot be done.
        """
        self._socket = await self._http.open_socket(self._group, self._name)
        self.is_connected = True
        await self.send({"op": "set_level", "level": "error"})  # so that refusals are reported
        for key in list(self._kept):
            if key in self._kept:  # else it has ended meanwhile
                await self.send(_newest(self._kept[key]))
        for restore in self.on_open:
            await restore()
        self._is_open.set()

    async def run(self) -> None:
        """Read; connect again when the connection is lost. Ends by cancellation, or with the connection if not."""
        while True:
            reason = await self._serve()
            await self._lose(reason)
            if not self._reconnects:
                return
            await self._reopen()

    async def send(self, request: Mapping[str, Any]) -> None:
        """Send one operation.

        Raises:
            HostlinkError: there is no connection, or something in it has no JSON.
        """
        self.callers.note()
        if self._socket is None or not self.is_connected:
            raise self.lost()
        text = encode(request).decode()
        try:
            await self._socket.send_str(text)
        except (aiohttp.ClientError, OSError) as error:  # `run` notices it too
            raise self.lost(str(error)) from error

    @contextlib.asynccontextmanager
    async def keeping(self, key: str, request: Mapping[str, Any], withdrawal: Mapping[str, Any]) -> AsyncIterator[None]:
        """Send a request, also after each reconnection, for the length of the block; then send its withdrawal.

        Of several blocks with one key, the newest that lasts is in force; the last one to end sends the withdrawal.

        Raises:
            HostlinkError: there is no connection.
        """
        block = object()
        self._kept.setdefault(key, {})[block] = request
        try:
            await self.send(request)
            yield
        finally:
            kept = self._kept[key]
            is_in_force = _newest(kept) is request
            del kept[block]
            if not kept:
                del self._kept[key]
            if not kept or is_in_force:
                with contextlib.suppress(HostlinkError):  # with the connection gone, so is what was requested
                    await self.send(_newest(kept) if kept else withdrawal)

    async def request(self, request: Mapping[str, Any], *, timeout_s: float = REQUEST_TIMEOUT_S) -> Message:
        """Send an operation that is answered.

        Raises:
            HostlinkError: it is refused, or not answered within timeout_s seconds.
        """
        key = f"{request['op']}:{next(self._numbers)}"
        waiting: asyncio.Future[Message | None] = asyncio.get_running_loop().create_future()
        self._answers[key] = waiting
        try:
            async with asyncio.timeout(timeout_s):
                await self.send({**request, "id": key})
                answer = await waiting
        except TimeoutError:
            raise HostlinkError(f"hostlink at {self._http.url} did not answer within {timeout_s:g} s") from None
        finally:
            del self._answers[key]
            self.callers.note()
        if answer is None:
            raise self.lost()
        if answer["op"] == "status":
            raise refused_by(answer)
        return answer

    async def events(self, path: str) -> AsyncGenerator[Event, None]:
        """The events of a stream of the REST API; one that has begun and is lost is opened again.

        Raises:
            HostlinkError: the daemon refuses it, or the connection is lost for good.
        """
        has_begun, pauses_s, stream = False, waits(), EventStream()
        while True:
            try:
                async for event in self._http.events(path, stream):
                    has_begun, pauses_s = True, waits()
                    yield event
            except HostlinkError:
                if not has_begun:
                    raise
            await asyncio.sleep(next(pauses_s))
            await self.back()

    async def aclose(self) -> None:
        """Close the WebSocket; messages that were sent earlier arrive first."""
        if self._socket is not None and self.is_connected:
            self.is_connected = False
            await self._socket.close()

    async def back(self) -> None:
        """Wait until it is there.

        Raises:
            HostlinkError: it is lost for good.
        """
        if not self._reconnects and not self.is_connected:
            raise self.lost()
        await self._is_open.wait()

    def lost(self, reason: str = "") -> HostlinkError:
        """The error of everything that needs the connection while there is none."""
        what_next = "; it is made again by itself" if self._reconnects else ""
        cause = reason or self._reason
        return HostlinkError(f"the connection to hostlink at {self._http.url} is lost: {cause}{what_next}")

    # -- reading ------------------------------------------------------------------------------------------------------

    async def _serve(self) -> str:
        """Read until the connection is lost; returns why."""
        assert self._socket is not None  # noqa: S101 - `open` came before
        async with asyncio.TaskGroup() as tasks:
            pings = tasks.create_task(self._ping(self._socket), name="pings")
            try:
                return await self._read(self._socket)
            finally:
                pings.cancel()

    async def _ping(self, socket_: aiohttp.ClientWebSocketResponse) -> None:
        with contextlib.suppress(aiohttp.ClientError, OSError):  # the reader notices it too
            while True:
                await socket_.ping()
                await asyncio.sleep(PING_INTERVAL_S)

    async def _read(self, socket_: aiohttp.ClientWebSocketResponse) -> str:
        while True:
            try:
                message = await _receive(socket_)
            except TimeoutError:
                return f"nothing was heard from it for {SILENCE_S:g} s"
            except (aiohttp.ClientError, OSError) as error:
                return str(error)
            if message.type is WSMsgType.TEXT:
                self._dispatch(msgspec.json.decode(message.data))
            elif message.type is WSMsgType.BINARY:
                self._dispatch(cbor2.loads(message.data))
            elif message.type is WSMsgType.PING:
                with contextlib.suppress(aiohttp.ClientError, OSError):
                    await socket_.pong(message.data)
            elif message.type is not WSMsgType.PONG:
                return _closing_text(socket_, message)

    def _dispatch(self, message: Message) -> None:
        waiting = self._answers.get(str(message.get("id")))
        if waiting is not None:
            if not waiting.done():
                waiting.set_result(message)
        else:
            for handler in self.handlers.get(str(message.get("op")), ()):
                handler(message)

    # -- losing it and coming back ------------------------------------------------------------------------------------

    async def _lose(self, reason: str) -> None:
        """Fail every pending request, and discard what was not sent yet."""
        self.is_connected = False
        self._is_open.clear()
        self._reason = reason
        for waiting in self._answers.values():
            if not waiting.done():
                waiting.set_result(None)
        for notify in self.on_lost:
            notify(self.lost())
        await self._discard()

    async def _discard(self) -> None:
        self.is_connected = False
        if self._socket is not None:
            _cut(self._socket)
            await self._socket.close()
            self._socket = None

    async def _reopen(self) -> None:
        for wait_s in waits():
            await asyncio.sleep(wait_s)
            try:
                async with asyncio.timeout(ATTEMPT_TIMEOUT_S):
                    await self.open()
            except HostlinkError as error:
                self._reason = str(error)
            except TimeoutError:
                self._reason = f"no answer within {ATTEMPT_TIMEOUT_S:g} s"
            else:
                return
            await self._discard()


def _newest(kept: dict[object, Mapping[str, Any]]) -> Mapping[str, Any]:
    return next(reversed(kept.values()))


def refused_by(status: Message) -> Refused:
    """The error of a `status`; that of an older daemon has no kind."""
    return Refused(str(status.get("kind", Refused.kind)), str(status["msg"]))


def waits() -> Iterator[float]:
    """Seconds before each attempt: doubling, and up to half shorter by chance: many clients must not come at once."""
    wait_s = FIRST_WAIT_S
    while True:
        yield wait_s * random.uniform(0.5, 1.0)  # noqa: S311 - not for security
        wait_s = min(2 * wait_s, LONGEST_WAIT_S)


async def _receive(socket_: aiohttp.ClientWebSocketResponse) -> aiohttp.WSMessage:
    """The next message of any kind; TimeoutError when the other side is silent, but not when this program slept."""
    loop = asyncio.get_running_loop()
    deadline_s = loop.time() + SILENCE_S
    try:
        async with asyncio.timeout_at(deadline_s):
            return await socket_.receive()
    except TimeoutError:
        if loop.time() < deadline_s + LATE_S:
            raise
    await socket_.ping()
    async with asyncio.timeout(SECOND_CHANCE_S):
        return await socket_.receive()


def _closing_text(socket_: aiohttp.ClientWebSocketResponse, message: aiohttp.WSMessage) -> str:
    if message.type is WSMsgType.ERROR:
        return f"what came is no WebSocket: {message.data}"
    if message.type is WSMsgType.CLOSE and message.extra:
        return f"it said: {message.extra}"
    return "it was closed" if socket_.close_code else "it broke off"


def _cut(socket_: aiohttp.ClientWebSocketResponse) -> None:
    """Throw away what the kernel still holds: it would reach the daemon when the network is back, as a late command."""
    raw = socket_.get_extra_info("socket")
    if raw is not None:
        with contextlib.suppress(OSError):  # it is closed already
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGER)
            raw.shutdown(socket.SHUT_RDWR)
