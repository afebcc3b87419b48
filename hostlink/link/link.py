"""Link: one Session on one Transport, from connect to a named end. It moves bytes and reads the clock, nothing else."""

import asyncio
import contextlib
import dataclasses
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import structlog

from hostlink.cancellation import expire, raise_if_cancelled
from hostlink.config import LinkConfig
from hostlink.latency import Latency
from hostlink.link.capture_buffer import CaptureBuffer, Captured, captured
from hostlink.link.fair_share import FairShare, Turns
from hostlink.protocol.clock import ClockReading
from hostlink.protocol.control import TopicInfo
from hostlink.protocol.events import Event
from hostlink.protocol.session import Session, SessionCounts
from hostlink.transport.base import READ_BYTES, Transport

log = structlog.get_logger()

TROUBLE_INTERVAL_S = 10.0  # damage on the wire is counted, and logged this often
PIECE_BYTES = 512  # between two pieces others may have their turn; what a robot sends at once is mostly less
LAST_FRAME_TIMEOUT_S = 0.2
SOON_S = 0.001  # a timer's grain: what is due within it is due


class LinkEnd(Enum):
    """Why a link is no more."""

    PEER_CLOSED = "peer_closed"
    IDLE = "idle"
    REPLACED = "replaced"
    REFUSED = "refused"
    EVICTED = "evicted"
    UNAUTHENTICATED = "unauthenticated"
    STOPPED = "stopped"
    BROKEN = "broken"
    CRASHED = "crashed"
    UNANSWERABLE = "unanswerable"  # the device waits for an answer that it could not take


@dataclass(frozen=True, slots=True)
class LinkFacts:
    """What a link has seen so far."""

    seconds: float
    counts: SessionCounts
    replaced: int
    rejected: dict[str, int]
    slowest_wait_s: float
    oldest_waiting_s: float
    clock: ClockReading | None


class Link:
    """The owner of one connection's transport and session."""

    def __init__(
        self,
        transport: Transport,
        session: Session,
        config: LinkConfig,
        *,
        number: int,
        on_event: Callable[["Link", Event], None],
        share: FairShare | None = None,
    ) -> None:
        """`share`: of the event loop, with all other links."""
        self.number = number
        self.peer = transport.peer
        self.address = transport.address
        self.session = session
        self.last_frame = b""  # of a robot: its zero
        self.command_latency = Latency()  # from a velocity's command to the transport
        self._from_device, self._to_device = CaptureBuffer(), CaptureBuffer()
        self.opened_at_s = self.heard_at_s = asyncio.get_running_loop().time()
        self._transport = transport
        self._config = config
        self._on_event = on_event
        self._turns = Turns(FairShare() if share is None else share)
        self._wake = asyncio.Event()
        self._is_drained = asyncio.Event()
        self._sleeps_until_s = 0.0
        self._deadline: asyncio.Timeout | None = None
        self._end: LinkEnd | None = None
        self._trouble = _Trouble(self.opened_at_s)
        self._idle_limit_s = math.inf if config.idle_timeout_s is None else config.idle_timeout_s
        silence_s = math.inf if config.silence_timeout_s is None else config.silence_timeout_s
        self._asking_limit_s = min(self._idle_limit_s, silence_s)

    def __repr__(self) -> str:
        return f"link {self.number} ({self.peer})"

    async def run(self) -> LinkEnd:
        """Serve the connection until it ends; returns why."""
        end = LinkEnd.BROKEN
        try:
            async with asyncio.TaskGroup() as tasks:
                writer = tasks.create_task(self._write(), name=f"link {self.number} writer")
                try:
                    end = await self._read()
                finally:
                    writer.cancel()
        except* ConnectionRefusedError:  # by the transport: the device has no key
            end = LinkEnd.UNAUTHENTICATED
        except* OSError as broken:
            log.debug("link.broken", cause=str(broken.exceptions[0]))
        finally:
            self._is_drained.set()  # nothing more will leave
            if end is not LinkEnd.PEER_CLOSED:
                await self._send_last()
            await self._transport.aclose()
        raise_if_cancelled()
        return self._end or end

    async def _send_last(self) -> None:
        """A link that ends from here leaves a standing robot; a connection that takes nothing is not waited for."""
        if self.last_frame and not self.session.is_stopped:
            with contextlib.suppress(OSError):  # a TimeoutError is one
                async with asyncio.timeout(LAST_FRAME_TIMEOUT_S):
                    await self._transport.send(self.last_frame)

    def end(self, reason: LinkEnd) -> None:
        """End the link soon; `run` returns the reason."""
        if self._end is None:
            self._end = reason
            if self._deadline is not None:
                expire(self._deadline)

    def wake(self) -> None:
        """Something was put into the session's outbox."""
        self._is_drained.clear()
        self.session.begin_waiting(asyncio.get_running_loop().time())  # also while the writer is stuck
        self._wake.set()

    async def drained(self) -> None:
        """Wait until everything that was queued has left."""
        await self._is_drained.wait()

    def descriptor(self) -> int | None:
        """The connection's, as long as it is open; None where it has none."""
        return self._transport.descriptor()

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """What the device has announced."""
        return self.session.topics

    @property
    def silent_s(self) -> float:
        """Since the last byte of the device."""
        return asyncio.get_running_loop().time() - self.heard_at_s

    def facts(self) -> LinkFacts:
        """The counts and times of the link: for its last log line and for the API."""
        now_s = asyncio.get_running_loop().time()
        return LinkFacts(
            seconds=now_s - self.opened_at_s,
            counts=dataclasses.replace(self.session.counts),
            replaced=self.session.replaced,
            rejected=dict(self.session.rejected),
            slowest_wait_s=self.session.slowest_wait_s,
            oldest_waiting_s=self.session.oldest_waiting_s(now_s),
            clock=self.session.device_clock.reading(self._transport.round_trip_s()),
        )

    def captured(self, since: tuple[int, int] = (0, 0)) -> Captured:
        """What passed after the first `since` bytes from the device and to it, as far as it is kept."""
        return captured(self._from_device, self._to_device, since)

    async def _read(self) -> LinkEnd:
        loop = asyncio.get_running_loop()
        try:
            async with asyncio.timeout(None) as self._deadline:  # `end` sets it
                if self._end is not None:
                    return self._end
                now_s = loop.time()
                self._dispatch(self.session.open(now_s=now_s), now_s)
                while data := await self._transport.receive():
                    now_s = self.heard_at_s = loop.time()
                    self._from_device.add(data, now_s)
                    is_flooding = len(data) >= READ_BYTES
                    for at in range(0, len(data), PIECE_BYTES):
                        if not self._turns.is_free(is_flooding=is_flooding):
                            now_s = await self._turns.begin(is_flooding=is_flooding)
                        self._dispatch(self.session.receive(data[at : at + PIECE_BYTES], now_s=now_s), now_s)
                        now_s = self._turns.end(now_s)
                        if self._end is not None:
                            return self._end
                    self._trouble.report(self.session, now_s)
        except TimeoutError:
            return LinkEnd.STOPPED  # never seen: `end` has set the reason
        finally:
            self._deadline = None
        return LinkEnd.PEER_CLOSED

    def _silent_at_s(self) -> float:
        """When the link ends if not a byte comes; sooner for a device that requests the time regularly."""
        limit_s = self._asking_limit_s if self.session.is_asking_time else self._idle_limit_s
        return self.heard_at_s + limit_s

    def _dispatch(self, found: list[Event], now_s: float) -> None:
        for event in found:
            self._on_event(self, event)
        self.session.begin_waiting(now_s)
        if self.session.wait_s(now_s) is not None or self._next_s() < self._sleeps_until_s:
            self._wake.set()

    def _next_s(self) -> float:
        """When something is due without a byte from the device."""
        return min(self.session.deadline_s(), self._silent_at_s())

    async def _write(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            self._wake.clear()
            now_s = loop.time()
            while taken := self.session.take(now_s=now_s, wall_ns=time.time_ns()):
                async with asyncio.timeout(self._config.write_timeout_s):  # a TimeoutError is an OSError: broken
                    await self._transport.send(taken.frame)
                now_s = loop.time()
                if taken.waiting_since_s is not None:
                    self.command_latency.add(now_s - taken.waiting_since_s)
                self._to_device.add(taken.frame, now_s)
            if self._silent_at_s() <= now_s + SOON_S:
                self.end(LinkEnd.IDLE)
                return
            deadline_s = self.session.deadline_s()
            if deadline_s <= now_s + SOON_S:
                self._dispatch(self.session.tick(now_s=now_s + SOON_S), now_s)
                continue
            wait_s = self.session.wait_s(now_s)
            if wait_s is None:
                self._is_drained.set()
            next_s = min(deadline_s, self._silent_at_s())
            self._sleeps_until_s = next_s if wait_s is None else min(next_s, now_s + wait_s)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(self._sleeps_until_s):
                    await self._wake.wait()


class _Trouble:
    """Logs damage on the wire: at most one line in TROUBLE_INTERVAL_S, with what came since the last one."""

    def __init__(self, now_s: float) -> None:
        self._logged_at_s = now_s
        self._logged: dict[str, int] = {}

    def report(self, session: Session, now_s: float) -> None:
        if now_s < self._logged_at_s + TROUBLE_INTERVAL_S:
            return
        self._logged_at_s = now_s
        counts = session.counts
        total = {
            "skipped_bytes": counts.skipped_bytes,
            "unknown_ids": counts.unknown_ids,
            "refused_frames": counts.refused_frames,
            "malformed": counts.malformed,
            **session.rejected,
        }
        before = self._logged
        new = {name: count - before.get(name, 0) for name, count in total.items() if count > before.get(name, 0)}
        self._logged = total
        if new:
            log.warning("link.trouble", **new)
