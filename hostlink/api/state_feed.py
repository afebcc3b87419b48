"""StateFeed: what GET /api/events sends, made once for all readers, and not at all while there are none.

Robots, links, clients and recordings are states: a reader gets the newest, and fewer of them when it is slow. Log
lines are not: the newest MAX_LINES are kept for it, and the others counted.
"""

import asyncio
import contextlib
from collections import deque
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import msgspec

from hostlink.api.client_subscriptions import encode_json
from hostlink.api.clients import Clients
from hostlink.api.recordings import recording_view
from hostlink.api.slices import Slices
from hostlink.api.views import RobotView, links_view, robot_view
from hostlink.errors import BadPayload
from hostlink.hub.hub import Hub
from hostlink.hub.message import Message
from hostlink.hub.node import Role
from hostlink.recording.recordings import Recordings

TICK_S = 0.1  # poses come ten times a second
REFRESH_S = 9.5 * TICK_S  # every tenth tick: ages and counters
SHARE = 0.03  # of the processor, for one kind of event: a large fleet is sent less often
BYTE_COST_S = 2e-9  # of sending to one reader
MAX_LINES = 64


class Reader:
    """What one reader of the feed has been sent."""

    def __init__(self, feed: "StateFeed") -> None:
        self.dropped = 0  # log lines that this reader was too slow for
        self.news = asyncio.Event()
        self.oldest_s: float | None = None  # a state replaces the one before: nothing of it grows old
        self._feed = feed
        self._version = 0
        self._lines = feed.line_count

    @property
    def waiting_messages(self) -> int:
        """Events that were not sent yet."""
        return len(self._newer()) + min(self._feed.line_count - self._lines, MAX_LINES)

    @property
    def waiting_bytes(self) -> int:
        """Of the states among them."""
        return sum(len(wire) for wire in self._newer())

    def pop(self) -> list[bytes]:
        """The events that were not sent yet."""
        events = self._newer()
        lines = self._feed.lines_since(self._lines)
        self.dropped += self._feed.line_count - self._lines - len(lines)
        self._version, self._lines = self._feed.version, self._feed.line_count
        for line in lines:
            try:
                events.append(encode_event("log", line.made("json", encode_json)))
            except BadPayload:  # what a client published as a line is none
                self.dropped += 1
        return events

    def _newer(self) -> list[bytes]:
        return [state.wire for state in self._feed.states if state.version > self._version]


@dataclass(slots=True, kw_only=True)
class _State:
    """One kind of event: how it is made, and the newest."""

    name: str
    interval_s: float
    encode: Callable[[], Awaitable[bytes | None]]  # None: nothing has changed
    is_repeated: bool = True  # also when it has not changed
    due_s: float = 0.0
    version: int = 0
    wire: bytes = b""


class _RobotPiece(NamedTuple):
    essence: object
    json: msgspec.Raw


class StateFeed:
    """The states and log lines for all readers.

    A state that costs more to encode and to send comes less often, so that it takes SHARE of the processor at most. It
    is encoded in slices; commands and devices have their turns in between.
    """

    def __init__(self, hub: Hub, clients: Clients, recordings: Recordings) -> None:
        self.is_running = False  # not: its reader's stream ends
        self.version = 0
        self.line_count = 0  # so far
        self.states = (
            _State(name="robots", interval_s=0.0, encode=self._encode_robots),
            _State(name="links", interval_s=REFRESH_S, encode=self._encode_links),
            _State(name="clients", interval_s=REFRESH_S, encode=self._encode_clients),
            _State(name="recordings", interval_s=REFRESH_S, encode=self._encode_recordings, is_repeated=False),
        )
        self._hub, self._clients, self._recordings = hub, clients, recordings
        self._slices = Slices(hub)
        self._readers: set[Reader] = set()
        self._lines: deque[Message] = deque(maxlen=MAX_LINES)
        self._pieces: dict[str, _RobotPiece] = {}
        self._refresh_at_s = 0.0

    @contextlib.contextmanager
    def reading(self, reader: Reader) -> Iterator[None]:
        """Send to the reader for the length of the block."""
        self._readers.add(reader)
        if not self.is_running:
            self.is_running = True
            self._hub.spawn(self._run(), name="events")
        try:
            yield
        finally:
            self._readers.discard(reader)

    def lines_since(self, count: int) -> list[Message]:
        """The log lines that came after the first `count`, as far as they are kept."""
        return list(islice(self._lines, max(0, len(self._lines) - (self.line_count - count)), None))

    async def _run(self) -> None:
        """While there are readers."""
        participant = self._hub.join("events", role=Role.READ)
        participant.subscribe("/rosout", self._add_line)
        announced = (self.version, self.line_count)
        try:
            while self._readers:
                await self._renew_states()
                if announced != (self.version, self.line_count):
                    announced = (self.version, self.line_count)
                    self._wake()
                await asyncio.sleep(TICK_S)
        finally:
            participant.leave()
            self.is_running, self._refresh_at_s = False, 0.0
            for state in self.states:
                state.version, state.due_s = 0, 0.0  # whoever comes next gets none that is old
            self._wake()

    async def _renew_states(self) -> None:
        for state in self.states:
            if state.due_s <= asyncio.get_running_loop().time():
                await self._renew(state)

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
        views = map(robot_view, self._hub.robots.all())
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
        return msgspec.json.encode(await links_view(self._hub, self._slices))

    async def _encode_clients(self) -> bytes:
        return msgspec.json.encode({"clients": self._clients.views(), "refused": self._clients.refused})

    async def _encode_recordings(self) -> bytes:
        box = self._recordings.black_box
        incidents = {"pending": len(box.pending), "saved": box.saved, "missed": box.missed}
        under_way = [recording_view(each) for each in self._recordings.under_way()]
        news = {"recordings": under_way, "changes": self._recordings.changes, "incidents": incidents}
        return msgspec.json.encode(news)


def _essence(view: RobotView) -> object:
    """What makes a view worth sending at once: not that its pose has grown older.

    A robot without poses shows by its frames that it lives.
    """
    odometry = view["odometry"]
    frames = view["frames"] if odometry is None else None
    return {**view, "odometry": odometry and odometry["count"], "frames": frames}


def encode_event(name: str, json: bytes) -> bytes:
    """One server-sent event."""
    return b"event: %b\ndata: %b\n\n" % (name.encode(), json)
