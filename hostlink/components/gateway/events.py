"""Server-sent events: the state of robots, links and clients as it changes, and log lines.

A state that is not sent yet is replaced by a newer one, so a slow reader receives fewer states. Of log lines the
newest MAX_LINES are kept; the others are counted. A reader that reconnects sends the id of its last line
(`Last-Event-ID`, as in the HTML standard) and gets the lines since then.
"""

import asyncio
import contextlib
import fcntl
import math
import re
import secrets
import sys
import termios
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from itertools import islice
from typing import NamedTuple

import msgspec
from aiohttp import web

from hostlink.components.gateway.access import GRANT
from hostlink.components.gateway.clients import Backlog, Client, Clients
from hostlink.components.gateway.recordings import recording_view
from hostlink.components.gateway.rosbridge import encode_json
from hostlink.components.gateway.routes import Route
from hostlink.components.gateway.views import Slices, links_view
from hostlink.components.recorder.recordings import Recordings
from hostlink.core.host import Host, Message, Role
from hostlink.core.robot.state_views import odometry_view, robot_view
from hostlink.core.robot.views import RobotView
from hostlink.errors import BadPayload

MOST_BYTES = 4096  # smaller amounts arrive at once, or wait for a delayed acknowledgement
CHECK_S = 0.02

TICK_S = 0.1  # poses arrive ten times a second
REFRESH_S = 9.5 * TICK_S  # for ages and counters: every tenth tick
SHARE = 0.03  # of the processor, for one kind of event: a large fleet is sent less often
BYTE_COST_S = 2e-9  # of sending to one reader
MAX_LINES = 64
LINGER_S = 10.0  # lines are kept for so long after the last reader, who may reconnect
LAST_ID_HEADER = "Last-Event-ID"

HEARTBEAT_S = 0.3  # a reader without three of them knows that the daemon is gone
SEND_TIMEOUT_S = 5.0
ROLE_HEADER = "Hostlink-Role"  # role of the reader's token: read or drive
HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no", "Content-Type": "text/event-stream"}


def unread_bytes(transport: asyncio.WriteTransport) -> int:
    """Return the bytes that the receiver has not acknowledged: in the process and, on Linux, in the kernel.

    Raises:
        OSError: the connection is closed.
    """
    if transport.is_closing():
        raise ConnectionResetError
    count = transport.get_write_buffer_size()
    if sys.platform == "linux":
        queued = fcntl.ioctl(transport.get_extra_info("socket").fileno(), termios.TIOCOUTQ, bytes(4))
        count += int.from_bytes(queued, sys.byteorder)
    return count


async def until_read(transport: asyncio.WriteTransport | None, timeout_s: float) -> None:
    """Wait until all but MOST_BYTES have arrived.

    Raises:
        TimeoutError: nothing arrived for timeout_s seconds.
        OSError: the connection is closed.
    """
    if transport is None:
        raise ConnectionResetError
    loop = asyncio.get_running_loop()
    least, since_s = math.inf, loop.time()
    while (unread := unread_bytes(transport)) > MOST_BYTES:
        if unread < least:
            least, since_s = unread, loop.time()
        elif loop.time() - since_s > timeout_s:
            raise TimeoutError
        await asyncio.sleep(CHECK_S)


class Reader:
    """Position of one reader in the feed."""

    def __init__(self, feed: "StateFeed", last_id: str = "") -> None:
        """`last_id`: id of the last line that the reader had in an earlier stream; other texts mean none."""
        self.dropped = 0  # log lines dropped because this reader was too slow
        self.news = asyncio.Event()
        self.oldest_s: float | None = None  # Backlog protocol: a newer state replaces an older one, so none grows old
        self._feed = feed
        self._version = 0
        self._lines = feed.count_at(last_id)

    @property
    def waiting_messages(self) -> int:
        """Number of events not sent yet."""
        return len(self._newer()) + min(self._feed.line_count - self._lines, MAX_LINES)

    @property
    def waiting_bytes(self) -> int:
        """Bytes of states not sent yet."""
        return sum(len(wire) for wire in self._newer())

    def pop(self) -> list[bytes]:
        """Return the events not sent yet."""
        events = self._newer()
        lines = self._feed.lines_since(self._lines)
        first = self._feed.line_count - len(lines) + 1
        self.dropped += first - 1 - self._lines
        self._version, self._lines = self._feed.version, self._feed.line_count
        for number, line in enumerate(lines, first):
            try:
                events.append(encode_event("log", line.made("json", encode_json), self._feed.id_of(number)))
            except BadPayload:  # a client published an invalid log message
                self.dropped += 1
        return events

    def _newer(self) -> list[bytes]:
        return [state.wire for state in self._feed.states if state.version > self._version]


@dataclass(slots=True, kw_only=True)
class _State:
    """One kind of event: its encoder, and the newest event."""

    name: str
    interval_s: float
    encode: Callable[[], Awaitable[bytes | None]]  # None: nothing has changed
    is_repeated: bool = True  # also sent when unchanged
    due_s: float = 0.0
    version: int = 0
    wire: bytes = b""


class _RobotPiece(NamedTuple):
    essence: object
    json: msgspec.Raw


class StateFeed:
    """States and log lines for all readers.

    The more CPU time a state takes to encode and to send, the less often it is sent: it takes at most SHARE of the
    processor. It is encoded in slices, between which commands and devices have their turns.
    """

    def __init__(self, host: Host, clients: Clients) -> None:
        self.is_running = False  # when it ends, the streams of its readers end
        self.version = 0
        self.line_count = 0  # since the start
        self.states = (
            _State(name="robots", interval_s=0.0, encode=self._encode_robots),
            _State(name="links", interval_s=REFRESH_S, encode=self._encode_links),
            _State(name="clients", interval_s=REFRESH_S, encode=self._encode_clients),
            _State(name="recordings", interval_s=REFRESH_S, encode=self._encode_recordings, is_repeated=False),
        )
        self._host, self._clients = host, clients
        self._slices = Slices(host.turns())
        self._name = secrets.token_hex(4)  # the ids of another daemon's lines are others
        self._readers: set[Reader] = set()
        self._left_s = 0.0  # end of the last reader
        self._lines: deque[Message] = deque(maxlen=MAX_LINES)
        self._pieces: dict[str, _RobotPiece] = {}
        self._refresh_at_s = 0.0

    @contextlib.contextmanager
    def reading(self, reader: Reader) -> Iterator[None]:
        """Add a reader for the length of the block."""
        self._readers.add(reader)
        if not self.is_running:
            self.is_running = True
            self._host.spawn(self._run(), name="events", is_vital=False)
        try:
            yield
        finally:
            self._readers.discard(reader)
            if not self._readers:
                self._left_s = asyncio.get_running_loop().time()
                self._forget_states()

    def id_of(self, number: int) -> str:
        """Return the id of the line with this number, from 1."""
        return f"{self._name}-{number}"

    def count_at(self, last_id: str) -> int:
        """Return the number of lines until the one with this id; all lines so far if it is not one of this feed."""
        name, _, number = last_id.partition("-")
        if name != self._name or not re.fullmatch("[0-9]{1,15}", number):
            return self.line_count
        return min(int(number), self.line_count)

    def lines_since(self, count: int) -> list[Message]:
        """Return the log lines after the first `count`, as far as they are kept."""
        return list(islice(self._lines, max(0, len(self._lines) - (self.line_count - count)), None))

    async def _run(self) -> None:
        """Renew the states while there are readers, and keep lines until LINGER_S after the last one."""
        participant = self._host.join("events", role=Role.READ)
        participant.subscribe("/rosout", self._add_line)
        announced = (self.version, self.line_count)
        try:
            while self._readers or asyncio.get_running_loop().time() < self._left_s + LINGER_S:
                for state in self.states if self._readers else ():
                    if state.due_s <= asyncio.get_running_loop().time():
                        await self._renew(state)
                if announced != (self.version, self.line_count):
                    announced = (self.version, self.line_count)
                    self._wake()
                await asyncio.sleep(TICK_S)
        finally:
            participant.leave()
            self.is_running = False
            self._forget_states()
            self._wake()

    def _forget_states(self) -> None:
        """Let later readers not get an old state."""
        self._refresh_at_s = 0.0
        for state in self.states:
            state.version, state.due_s = 0, 0.0

    def _wake(self) -> None:
        for reader in self._readers:
            reader.news.set()

    def _add_line(self, message: Message) -> None:
        self._lines.append(message)
        self.line_count += 1

    async def _renew(self, state: _State) -> None:
        self._slices.spent_s = 0.0
        json = await state.encode()
        wire = state.wire if json is None else encode_event(state.name, json)
        if json is not None and (state.is_repeated or state.version == 0 or wire != state.wire):
            self.version += 1
            state.version, state.wire = self.version, wire
            self._slices.spent_s += len(state.wire) * len(self._readers) * BYTE_COST_S
        state.due_s = asyncio.get_running_loop().time() + max(state.interval_s, self._slices.spent_s / SHARE)

    async def _encode_robots(self) -> bytes | None:
        now_s = asyncio.get_running_loop().time()
        is_refresh = now_s >= self._refresh_at_s
        before, self._pieces = self._pieces, {}
        known = {} if is_refresh else before
        views = map(robot_view, self._host.states())
        await self._slices.run(views, lambda view: self._encode_robot(view, known))
        if is_refresh:
            self._refresh_at_s = now_s + REFRESH_S
        elif self._pieces == before:
            return None
        return msgspec.json.encode({"robots": [piece.json for piece in self._pieces.values()]})

    def _encode_robot(self, view: RobotView, known: dict[str, _RobotPiece]) -> None:
        piece, essence = known.get(view["name"]), _essence(view)
        if piece is None or piece.essence != essence:
            piece = _RobotPiece(essence, msgspec.Raw(msgspec.json.encode(view)))
        self._pieces[view["name"]] = piece

    async def _encode_links(self) -> bytes:
        return msgspec.json.encode(await links_view(self._host.devices, self._slices))

    async def _encode_clients(self) -> bytes:
        return msgspec.json.encode({"clients": self._clients.views(), "refused": self._clients.refused})

    async def _encode_recordings(self) -> bytes:
        recordings = self._host.offered(Recordings)
        if recordings is None:
            return _NO_RECORDINGS
        box = recordings.black_box
        incidents = {"pending": len(box.pending), "saved": box.saved, "missed": box.missed}
        under_way = [recording_view(each) for each in recordings.under_way()]
        news = {"recordings": under_way, "changes": recordings.changes, "incidents": incidents}
        return msgspec.json.encode(news)


_NO_INCIDENTS = {"pending": 0, "saved": 0, "missed": 0}
_NO_RECORDINGS = msgspec.json.encode({"recordings": [], "changes": 0, "incidents": _NO_INCIDENTS})


def _essence(view: RobotView) -> object:
    """Return the part of a view whose change is sent at once. The age of a pose is not.

    The frame counter shows that a robot without poses is connected.
    """
    odometry = view["odometry"]
    frames = view["frames"] if odometry is None else None
    return {**view, "odometry": odometry and odometry["count"], "frames": frames}


def encode_event(name: str, json: bytes, event_id: str = "") -> bytes:
    """Encode one server-sent event."""
    id_line = f"id: {event_id}\n" if event_id else ""
    return b"%bevent: %b\ndata: %b\n\n" % (id_line.encode(), name.encode(), json)


Send = Callable[[bytes], Awaitable[None]]


class Events:
    """The event streams."""

    def __init__(self, host: Host, clients: Clients) -> None:
        self._host = host
        self._clients = clients
        self._feed = StateFeed(host, clients)

    def routes(self) -> list[Route]:
        """Return the routes of both streams."""
        stream = partial(Route, response=None, media_type="text/event-stream", fails=(HTTPStatus.SERVICE_UNAVAILABLE,))
        return [stream("/api/events", self._state), stream("/api/robots/{name}/odometry/events", self._odometry)]

    async def _state(self, request: web.Request) -> web.StreamResponse:
        """Events `robots`, `links` and `clients`: the JSON of their GETs; `recordings`: running ones, how often their
        folder has changed, how many incidents are pending, saved, missed; `log`: a log line, whose id continues it.
        """
        reader = Reader(self._feed, request.headers.get(LAST_ID_HEADER, ""))
        async with self._stream(request, reader) as (response, send, _):
            with self._feed.reading(reader):
                while self._feed.is_running:
                    await until_read(request.transport, SEND_TIMEOUT_S)
                    now_s = asyncio.get_running_loop().time()
                    events = reader.pop()
                    if events:
                        events[-1] += b": sent %.3f\n\n" % now_s  # so that a reader sees the delay
                    for event in events:
                        await send(event)
                    await _wait(reader.news, response)
        return response

    async def _odometry(self, request: web.Request) -> web.StreamResponse:
        """An event `odometry` for each new pose: the JSON of its GET."""
        robot = self._host.find(request.match_info["name"])
        news = asyncio.Event()
        async with self._stream(request) as (response, send, client):
            participant = self._host.join(client.name, role=Role.READ, on_end=news.set)
            try:
                robot.follow(participant, news.set)
                news.set()  # send the known pose first
                while robot.is_known and not participant.has_left:  # ends when the robot is forgotten
                    odometry = robot.odometry() if await _wait(news, response) else None
                    if odometry is not None:
                        await send(encode_event("odometry", msgspec.json.encode(odometry_view(odometry))))
            finally:
                participant.leave()
        return response

    @contextlib.asynccontextmanager
    async def _stream(
        self, request: web.Request, backlog: Backlog | None = None
    ) -> AsyncIterator[tuple[web.StreamResponse, Send, Client]]:
        """Open a response for the length of the block. A disconnected reader ends the block."""
        role = request[GRANT].role.name.lower()
        response = web.StreamResponse(headers={**HEADERS, ROLE_HEADER: role})
        client = self._clients.enter("events", request, backlog)

        async def send(event: bytes) -> None:
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await response.write(event)
            client.messages_to_client += 1
            client.bytes_to_client += len(event)

        try:
            try:
                await response.prepare(request)
            except OSError as error:
                raise web.HTTPBadRequest(reason="the client disconnected before the first event") from error
            with contextlib.suppress(OSError):  # the reader left, or does not read (TimeoutError is an OSError)
                yield response, send, client
        finally:
            self._clients.leave(client)


async def _wait(news: asyncio.Event, response: web.StreamResponse) -> bool:
    """Wait for news, at most until a comment is due. Comments let both sides notice a lost connection.

    Returns whether there is news.
    """
    try:
        async with asyncio.timeout(HEARTBEAT_S):
            await news.wait()
    except TimeoutError:
        async with asyncio.timeout(SEND_TIMEOUT_S):
            await response.write(b": alive\n\n")
        return False
    news.clear()
    return True
