"""Link: one device connection, from its first byte to a named end."""

import asyncio
import contextvars
import dataclasses
import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import structlog

from hostlink.core.config import LinkConfig
from hostlink.core.link.capture_buffer import CaptureBuffer, Captured, CaptureRoom, captured
from hostlink.core.link.fair_share import FairShare, Turns
from hostlink.core.link.serving import Authenticate, Helper, LinkEnd, drain, serve, trust
from hostlink.core.protocol.clock import ClockReading
from hostlink.core.protocol.endpoint import DeviceEndpoint
from hostlink.core.protocol.events import Event
from hostlink.core.protocol.session import DeviceSession, SessionCounts
from hostlink.core.runtime.host_pauses import HostPauses, never_paused
from hostlink.core.runtime.latency import Latency
from hostlink.core.transport.base import Transport

# -- piece size -------------------------------------------------------------------------------------------------------

MOST_BYTES = 4096  # four frames of 1 KiB: reading one in parts costs twice as much
FIRST_BYTES = 512  # the cost of the first piece is unknown; a robot mostly sends less at once
LEAST_BYTES = 64  # the read itself costs as much as the smallest frames in it
PIECE_S = 0.0005  # limit for one piece before others have their turn; a piece of refused requests took 3 ms
# Limit for more than FIRST_BYTES: half a turn of all links, so that a flood delays no other link.
LARGE_PIECE_S = 0.0001

TROUBLE_INTERVAL_S = 10.0  # damage on the wire is counted and logged at this interval

SOON_S = 0.001  # granularity of a timer: work due within it is done
AGAIN_S = 0.1  # retry interval for work that was postponed


class PieceSize:
    """Size of the next piece of one link. It is halved after an expensive piece and doubled after a cheap one."""

    __slots__ = ("size_bytes",)

    def __init__(self) -> None:
        self.size_bytes = FIRST_BYTES

    def update(self, cost_s: float) -> None:
        """Note the cost of the last piece."""
        is_large = self.size_bytes > FIRST_BYTES
        if cost_s > (LARGE_PIECE_S if is_large else PIECE_S):
            self.size_bytes = max(LEAST_BYTES, self.size_bytes // 2)
        elif cost_s < (LARGE_PIECE_S / 2 if self.size_bytes >= FIRST_BYTES else PIECE_S / 4):
            self.size_bytes = min(MOST_BYTES, self.size_bytes * 2)


# -- trouble ----------------------------------------------------------------------------------------------------------

log = structlog.get_logger()


class Trouble:
    """Logger of damage on the wire: at most one line per TROUBLE_INTERVAL_S, with the counts since the last one."""

    __slots__ = ("_logged", "due_s")

    def __init__(self, now_s: float) -> None:
        self.due_s = now_s + TROUBLE_INTERVAL_S  # time of the next report
        self._logged: Counter[str] = Counter()

    def report(self, session: DeviceSession, now_s: float) -> None:
        """Log the new counts, if there are any. Call it when it is due."""
        self.due_s = now_s + TROUBLE_INTERVAL_S
        counts = session.counts
        total = Counter(
            skipped_bytes=counts.skipped_bytes,
            unknown_ids=counts.unknown_ids,
            refused_frames=counts.refused_frames,
            malformed=counts.malformed,
            **session.rejected,
        )
        new = total - self._logged
        self._logged = total
        if new:
            log.warning("link.trouble", **new)


# -- link -------------------------------------------------------------------------------------------------------------

_NO_CONTEXT = contextvars.Context()


@dataclass(frozen=True, slots=True)
class LinkFacts:
    """Counts and times of a link so far."""

    seconds: float
    counts: SessionCounts
    replaced: int
    rejected: dict[str, int]
    slowest_wait_s: float
    oldest_waiting_s: float
    clock: ClockReading | None


class Link:
    """Owner of one connection's transport and session."""

    __slots__ = (
        "_config", "_context", "_drained", "_end", "_failure", "_finished", "_from_device", "_helper", "_idle_limit_s",
        "_is_behind", "_is_write_due", "_now_s", "_on_event", "_pauses", "_piece", "_reader",
        "_regular_limit_s", "_timer", "_timer_s", "_to_device", "_transport", "_trouble", "_turns", "_wall_ns",
        "address", "came_s", "command_latency", "kind", "last_frames", "number", "opened_at_s", "peer", "received_at_s",
        "session",
    )  # fmt: skip

    def __init__(
        self,
        transport: Transport,
        session: DeviceSession,
        config: LinkConfig,
        *,
        number: int,
        on_event: Callable[["Link", Event], None],
        share: FairShare | None = None,
        room: CaptureRoom | None = None,
        wall_ns: Callable[[], int] = time.time_ns,
        pauses: Callable[[float], HostPauses] = never_paused,
    ) -> None:
        """`share` divides the event loop among all links, and `room` the memory for their captures.

        `wall_ns` is the time that devices get.

        `pauses` returns when the host itself did not run, up to its argument. It is called before frames are written,
        because the host replaces a velocity that waited through a pause.
        """
        self.number = number
        self.kind, self.peer = transport.kind, transport.peer
        self.address = transport.address
        self.session = session
        self.last_frames: tuple[bytes, ...] = ()  # writes that stop a robot; empty for other devices
        self.command_latency = Latency()  # from a velocity's command to the transport
        room = CaptureRoom() if room is None else room
        self._from_device, self._to_device = CaptureBuffer(room), CaptureBuffer(room)
        self._now_s = asyncio.get_running_loop().time
        self.opened_at_s = self.received_at_s = self._now_s()
        self.came_s = self.opened_at_s  # earliest arrival of the bytes that were read last
        self._transport = transport
        self._config = config
        self._on_event, self._wall_ns = on_event, wall_ns
        self._pauses = pauses
        self._turns = Turns(FairShare() if share is None else share)
        self._reader = self._turns.reader(transport, self._read_guarded, self._read_end)
        self._piece = PieceSize()
        self._drained: asyncio.Event | None = None  # while a caller waits until every queued frame was sent
        # Nothing may be written: not open yet, the device is behind, or the link has ended.
        self._is_behind = True
        self._is_write_due = False
        self._timer: asyncio.TimerHandle | None = None
        self._timer_s = math.inf
        self._context = _NO_CONTEXT  # set by `run`
        self._finished: asyncio.Future[LinkEnd] = asyncio.get_running_loop().create_future()
        self._helper = Helper(f"link {number} writer", self._end_broken)
        self._failure: Exception | None = None
        self._end: LinkEnd | None = None
        self._trouble = Trouble(self.opened_at_s)
        self._idle_limit_s = math.inf if config.idle_timeout_s is None else config.idle_timeout_s
        silence_s = math.inf if config.silence_timeout_s is None else config.silence_timeout_s
        self._regular_limit_s = min(self._idle_limit_s, silence_s)

    def __repr__(self) -> str:
        return f"link {self.number} ({self.peer})"

    async def run(self, authenticate: Authenticate = trust) -> LinkEnd:
        """Serve the connection until it ends. Return the reason.

        `authenticate` returns when the protocol may begin, or raises ConnectionRefusedError.
        """
        self._context = contextvars.copy_context()  # log lines have the caller's bound keys
        opening = partial(self._open, authenticate)
        end = await serve(self._wait_for_end(), self._helper, opening, self._transport, self._close)
        return self._end or end

    async def _wait_for_end(self) -> LinkEnd:
        end = await self._finished
        if self._failure is not None:
            raise self._failure
        return end

    def _close(self) -> tuple[bytes, ...]:
        """Stop reading and writing. Return the final zero velocities; empty if none are to be sent."""
        self._is_behind = True
        self._note_drained()
        self._reader.stop()
        if not self._finished.done():
            self._finished.cancel()
        if self._timer is not None:
            self._timer.cancel()
        return () if self.session.outbox.is_stopped else self.last_frames

    def end(self, reason: LinkEnd) -> None:
        """End the link. `run` returns the reason."""
        if self._end is None:
            self._end = reason
            self._finish(reason)

    def wake(self) -> None:
        """Write newly queued frames in the next turn of the loop."""
        if self._finished.done():
            return
        loop = asyncio.get_running_loop()
        self.session.outbox.begin_waiting(loop.time())  # also while the device is behind
        if not self._is_write_due:
            self._is_write_due = True
            loop.call_soon(self._write_due, context=self._context)

    def write_now(self, now_s: float) -> None:
        """Write newly queued frames at once, for velocities. They wait for a write that is due anyway.

        The caller has looked for a pause of the host. Events of the session wait for the next turn of the loop, because
        the caller is at work in the hub.
        """
        if self._finished.done():
            return
        if self._is_write_due:
            self.session.outbox.begin_waiting(now_s)
            return
        try:
            if self._write_frames(now_s) or not self.session.is_steady:  # something may be due earlier now
                self._expect(now_s)
        except Exception as error:  # noqa: BLE001 - raised by `run`
            self._crash(error)

    async def drained(self) -> None:
        """Wait until every queued frame was sent, or the link ends."""
        if self._finished.done():
            return
        if self._drained is None:
            self._drained = asyncio.Event()
            self.wake()  # the next write notes it
        await self._drained.wait()

    def _note_drained(self) -> None:
        if self._drained is not None:
            self._drained.set()
            self._drained = None

    def descriptor(self) -> int | None:
        """File descriptor of the connection; None when it has none or is closed."""
        return self._transport.descriptor()

    @property
    def topics(self) -> tuple[DeviceEndpoint, ...]:
        """Topics that the device has announced."""
        return self.session.topics

    @property
    def silent_s(self) -> float:
        """Seconds since the last byte from the device."""
        return self._now_s() - self.received_at_s

    def facts(self) -> LinkFacts:
        """Counts and times of the link, for its last log line and for the API."""
        now_s = self._now_s()
        return LinkFacts(
            seconds=now_s - self.opened_at_s,
            counts=dataclasses.replace(self.session.counts),
            replaced=self.session.outbox.replaced,
            rejected=dict(self.session.rejected),
            slowest_wait_s=self.session.outbox.slowest_wait_s,
            oldest_waiting_s=self.session.outbox.oldest_s(now_s),
            clock=self.session.device_clock.reading(self._transport.round_trip_s()),
        )

    def captured(self, since: tuple[int, int] = (0, 0)) -> Captured:
        """Captured traffic after the first `since` bytes from the device and to it, as far as it is kept."""
        return captured(self._from_device, self._to_device, since, self.session.rest_of_frame_bytes)

    # -- from the device ----------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Open the session and start reading."""
        now_s = self._now_s()
        self._dispatch(self.session.open(now_s=now_s), now_s, is_timer_right=False)
        self._transport.start(self._reader.receive)

    def _read_guarded(self) -> None:
        try:
            self._context.run(self._read)
        except Exception as error:  # noqa: BLE001 - raised by `run`
            self._crash(error)

    def _read(self) -> None:
        """Read one piece, so that others have their turn between two pieces."""
        now_s, last_s = self._now_s(), self.received_at_s
        self.received_at_s = now_s
        session, reader = self.session, self._reader
        self.came_s = reader.came_s
        data = reader.rest or self._transport.read(self._piece.size_bytes)
        reader.rest = b""
        if len(data) > FIRST_BYTES and session.is_crowded(data):
            data, reader.rest = data[:FIRST_BYTES], data[FIRST_BYTES:]
        self._from_device.add(data, now_s)
        was_steady = session.is_steady
        if not was_steady and (paused_s := self._pauses(now_s).paused_s(last_s)):
            session.note_host_pause(paused_s)
        found = session.receive(data, now_s=now_s)
        if found and (session.outbox.answers or session.outbox.is_time_due):  # some devices wait for 10 ms only
            self._pauses(now_s)
            self._write_frames(now_s)
        self._dispatch(found, now_s, is_timer_right=was_steady and session.is_steady)
        ended_s = self._turns.end(now_s)
        self._piece.update(ended_s - now_s)
        if ended_s >= self._trouble.due_s:
            self._trouble.report(session, ended_s)

    @property
    def unread_bytes(self) -> int:
        """Number of received and unread bytes."""
        return len(self._reader.rest) + self._transport.unread_bytes

    def _read_end(self) -> None:
        try:
            self._transport.read(1)  # raises the error that broke the connection
        except Exception as error:  # noqa: BLE001 - raised by `run`
            self._crash(error)
        else:
            self._finish(LinkEnd.PEER_CLOSED)

    def _silent_at_s(self) -> float:
        """Time at which silence ends the link; earlier for a device that sends something regularly."""
        limit_s = self._regular_limit_s if self.session.is_regular else self._idle_limit_s
        return self.received_at_s + limit_s

    def _dispatch(self, found: list[Event], now_s: float, *, is_timer_right: bool) -> None:
        """React to events. `is_timer_right`: nothing is due earlier than before."""
        self._is_write_due = True  # answers to the events are written together
        for event in found:
            self._on_event(self, event)
        if self.session.outbox.has_waiting or not (is_timer_right or self._timer_s <= self._due_s()):
            self._write(now_s)
        else:
            self._is_write_due = False

    def _due_s(self) -> float:
        """Time of the next `_write` without a frame to the device."""
        return min(self.session.deadline_s(), self._silent_at_s())

    def _crash(self, error: Exception) -> None:
        """End the link because a callback of the event loop failed. `run` raises the error, unless it is an OSError."""
        if isinstance(error, OSError):
            self._end_broken(error)
            return
        if self._failure is None:
            self._failure = error
        self._finish(LinkEnd.CRASHED)

    def _end_broken(self, error: OSError) -> bool:
        """End the link because its connection is lost, unless it ends already. False: it has not proven its key."""
        if self._finished.done():
            return True
        if isinstance(error, ConnectionRefusedError):
            return False
        log.debug("link.broken", cause=str(error))
        self._finish(LinkEnd.BROKEN)
        return True

    def _finish(self, end: LinkEnd) -> None:
        self._reader.stop()
        if not self._finished.done():
            self._finished.set_result(end)

    # -- to the device ------------------------------------------------------------------------------------------------

    async def _open(self, authenticate: Authenticate) -> None:
        """Authenticate the device, and begin."""
        await authenticate()
        self._is_behind = False
        self._begin()
        await self._catch_up()

    async def _catch_up(self) -> None:
        """Wait while the device is behind, and write again."""
        while self._is_behind:
            await drain(self._transport, self._config.write_timeout_s, self._pauses)
            self._is_behind = False
            self._write(self._now_s())

    def _write_due(self) -> None:
        try:
            if self._is_write_due:
                self._write(self._now_s())
        except Exception as error:  # noqa: BLE001 - raised by `run`
            self._crash(error)

    def _write(self, now_s: float) -> None:
        """Write the frames that may be sent now, do what is due, and set the timer."""
        self._is_write_due = False
        session = self.session
        if session.outbox.has_waiting:
            self._pauses(now_s)  # a pause that has just ended replaces velocities by zero
            self._write_frames(now_s)
        while session.deadline_s() <= now_s + SOON_S and not self._is_behind and self._is_settled(now_s):
            for event in session.tick(now_s=now_s + SOON_S):
                self._on_event(self, event)
            self._write_frames(now_s)
        if self._silent_at_s() <= now_s + SOON_S and self._is_silent(now_s):
            self.end(LinkEnd.IDLE)
        else:
            self._expect(now_s)

    def _write_frames(self, now_s: float) -> bool:
        """Write the frames that may be sent now, until the device is behind. Look for a pause of the host before.

        Return whether frames wait.
        """
        session = self.session
        outbox = session.outbox
        while outbox.has_waiting:
            if self._is_behind:
                outbox.begin_waiting(now_s)
                return True
            wall_ns = self._wall_ns() if outbox.is_time_due else 0
            outgoing = session.pop_frame(now_s=now_s, wall_ns=wall_ns)
            if outgoing is None:  # the device's UART is busy
                return True
            if not self._transport.write(outgoing.frame):
                self._is_behind = True
                self._helper.start(self._catch_up, self._context.copy())
            if outgoing.waiting_since_s is not None:
                self.command_latency.add(self._now_s() - outgoing.waiting_since_s)
            self._to_device.add(outgoing.frame, now_s)
        return False

    def _is_settled(self, now_s: float) -> bool:
        """Whether due work may be done.

        After a pause of the host, waiting bytes are read first, which may change it.
        """
        return self._pauses(now_s).is_settled(now_s)

    def _is_silent(self, now_s: float) -> bool:
        """Whether the host ran during all of the silence, and no byte waits to be read."""
        if not self._is_settled(now_s) or self.unread_bytes:
            return False
        limit_s = self._silent_at_s() - self.received_at_s
        return self._pauses(now_s).awake_s(self.received_at_s, now_s + SOON_S) >= limit_s

    def _expect(self, now_s: float) -> None:
        """Set the timer for the next `_write`."""
        next_s, wait_s = self._silent_at_s(), None
        if not self._is_behind:
            wait_s = self.session.outbox.wait_s(now_s)
            next_s = min(next_s, self.session.deadline_s())
            if wait_s is None and self._drained is not None:
                self._note_drained()
        if next_s <= now_s + SOON_S:  # due work was postponed: waiting bytes are read first
            next_s = now_s + AGAIN_S
        if wait_s is not None:
            next_s = min(next_s, now_s + wait_s)
        if next_s < self._timer_s:
            if self._timer is not None:
                self._timer.cancel()
            self._timer_s = next_s
            loop = asyncio.get_running_loop()
            self._timer = loop.call_at(next_s, self._timer_due, context=self._context)

    def _timer_due(self) -> None:
        self._timer, self._timer_s = None, math.inf
        if not self._finished.done():
            self._is_write_due = True
            self._write_due()
