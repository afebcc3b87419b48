"""Relay: the shell of `faults`: it connects devices and a host, and changes their bytes as the script says."""

import asyncio
import contextlib
import random
import socket
import struct
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any, Protocol

from hostlink.core.transport.base import Transport
from hostlink.core.transport.connection import StreamTransport
from tools.faults import OF_BYTES, Direction, Fault, FaultyLine, Kind, Schedule, Script, boot_noise

MAX_WAITING_BYTES = 1 << 20  # on a line; then the sender's TCP stops it
SOON_S = 1e-5  # a timer's grain: what is due within it is due


class End(Transport, Protocol):
    """One connection of the relay's."""

    def break_off(self) -> None:
        """Reset it."""
        ...


class TcpEnd(StreamTransport):
    """A TCP connection that can be reset."""

    __slots__ = ("_on_made",)

    def __init__(self, on_made: Callable[["TcpEnd"], None] = lambda _: None) -> None:
        super().__init__()
        self._on_made = on_made

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Frames pass at once, as they come."""
        super().connection_made(transport)
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.address, port = (transport.get_extra_info("peername") or ("gone", 0))[:2]
        self.peer = f"{self.address}:{port}"
        self._on_made(self)

    def break_off(self) -> None:
        """Reset the connection: both ends get an error, and what was not read is gone."""
        transport = self.transport
        if not transport.is_closing():
            linger = struct.pack("ii", 1, 0)
            transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            transport.abort()


async def connect_tcp(host: str, port: int) -> TcpEnd:
    """Open a connection."""
    _, made = await asyncio.get_running_loop().create_connection(TcpEnd, host, port)
    return made


async def listen_tcp(on_connection: Callable[[TcpEnd], None], host: str, port: int) -> asyncio.Server:
    """Accept connections."""
    return await asyncio.get_running_loop().create_server(lambda: TcpEnd(on_connection), host, port)


class Relay:
    """All connections through it. `log(what, facts)` is called for each fault and connection."""

    def __init__(
        self, script: Script, connect: Callable[[], Awaitable[End]], log: Callable[[str, dict[str, Any]], None]
    ) -> None:
        """`connect` opens a connection to the host."""
        self.counts: Counter[str] = Counter()
        self._script, self._connect, self._log = script, connect, log
        self._schedule = Schedule(script)
        self._began_s = asyncio.get_running_loop().time()
        self._passages: list[_Passage] = []
        self._still_until_s = self._away_until_s = float("-inf")
        self._comes_with_noise = False

    async def run(self) -> None:
        """Let the faults happen, until the script ends if it does; a cancel ends it too."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._script.length_s):
                while (due_s := self._schedule.next_s()) is not None:
                    await asyncio.sleep(max(0.0, due_s - self._now_s()))
                    for fault in self._schedule.pop_due(max(due_s, self._now_s())):
                        self.inflict(fault)
                await asyncio.get_running_loop().create_future()

    async def serve(self, device: End) -> None:
        """Carry one device's connection to the host, until either end closes or a fault ends it; then close both."""
        async with contextlib.aclosing(device):
            if self._now_s() < self._away_until_s:  # the device that connects is not there yet
                device.break_off()
                return
            self.counts["connections"] += 1
            number = self.counts["connections"]
            try:
                host = await self._connect()
            except OSError as error:
                self._log("no host", {"connection": number, "cause": str(error)})
                device.break_off()
                return
            async with contextlib.aclosing(host):
                await self._carry(device, host, number)

    async def _carry(self, device: End, host: End, number: int) -> None:
        passage = _Passage(device, host, self._script, number)
        passage.stand_still(self._loop_s(self._still_until_s))
        if self._comes_with_noise:
            self._comes_with_noise = False
            dice = random.Random(f"{self._script.seed} boot {number}")  # noqa: S311 - can be repeated
            passage.lines[Direction.FROM_DEVICE].send(boot_noise(dice), asyncio.get_running_loop().time())
        self._passages.append(passage)
        self._log("connected", {"connection": number, "device": device.peer})
        try:
            await passage.run()
        finally:
            self._passages.remove(passage)
            for way, line in passage.lines.items():
                self.counts[f"bytes {way.value}"] += passage.passed[way]
                self.counts.update({f"{kind.value} bytes": count for kind, count in line.harmed.items() if count})
            self._log("ended", {"connection": number})

    def heal(self) -> None:
        """Bytes that were to be harmed will not be."""
        for passage in self._passages:
            for line in passage.lines.values():
                line.heal()

    def inflict(self, fault: Fault) -> None:
        """Let a fault happen now."""
        self.counts[fault.kind.value] += 1
        facts: dict[str, Any] = {"connections": len(self._passages)}
        if fault.amount:
            facts["bytes" if fault.kind in OF_BYTES else "seconds"] = round(fault.amount, 3)
        if fault.direction is not None:
            facts["direction"] = fault.direction.value
        self._log(fault.kind.value, facts)
        now_s = self._now_s()
        if fault.kind is Kind.BLACKOUT:
            self._still_until_s = max(self._still_until_s, now_s + fault.amount)
        elif fault.kind is Kind.REBOOT:
            self._away_until_s, self._comes_with_noise = now_s + fault.amount, True
        for passage in list(self._passages):
            passage.inflict(fault, asyncio.get_running_loop().time())

    def _now_s(self) -> float:
        return asyncio.get_running_loop().time() - self._began_s

    def _loop_s(self, time_s: float) -> float:
        return time_s + self._began_s


class _Passage:
    """One device's connection and the one to the host that belongs to it."""

    def __init__(self, device: End, host: End, script: Script, number: int) -> None:
        self.passed = dict.fromkeys(Direction, 0)
        self.lines = {way: FaultyLine(script.habits, f"{script.seed} {number} {way.value}") for way in Direction}
        self._device, self._host = device, host
        self._ends = {Direction.TO_DEVICE: (host, device), Direction.FROM_DEVICE: (device, host)}
        self._changed = {way: asyncio.Event() for way in Direction}  # something is on the line, or its time is another
        self._gave = {way: asyncio.Event() for way in Direction}
        self._is_ended = asyncio.Event()
        self._is_half_open = False

    async def run(self) -> None:
        """Until one end closes, breaks, or a fault ends it."""
        async with asyncio.TaskGroup() as tasks:
            pumps = [tasks.create_task(pump(way)) for way in Direction for pump in (self._receive, self._send)]
            await self._is_ended.wait()
            for pump in pumps:
                pump.cancel()

    def stand_still(self, until_s: float, direction: Direction | None = None) -> None:
        for way in Direction:
            if direction in (None, way):
                self.lines[way].stand_still(until_s)
                self._changed[way].set()

    def inflict(self, fault: Fault, now_s: float) -> None:
        """Apply the fault to this connection."""
        if fault.kind in (Kind.LOSE, Kind.BLACKOUT):
            self.stand_still(now_s + fault.amount, fault.direction)
        elif fault.kind in OF_BYTES:
            for way in Direction:
                if fault.direction in (None, way):
                    self.lines[way].harm(fault.kind, round(fault.amount))
        elif fault.kind is Kind.HALF_OPEN:
            self._is_half_open = True
            self._device.break_off()
            self._cut_lines()
        else:
            if fault.kind is not Kind.CLOSE:
                self._device.break_off()
                self._host.break_off()
            self._cut_lines()
            self._is_ended.set()

    def _cut_lines(self) -> None:
        for way, line in self.lines.items():
            line.cut()
            self._gave[way].set()

    async def _receive(self, way: Direction) -> None:
        """Bytes in."""
        source, _ = self._ends[way]
        line = self.lines[way]
        with contextlib.suppress(OSError):
            while data := await source.receive():
                if self._is_half_open:
                    continue
                line.send(data, asyncio.get_running_loop().time())
                self.passed[way] += len(data)
                self._changed[way].set()
                await self._come_down(way, MAX_WAITING_BYTES)
        await self._come_down(way, 0)  # what was sent before the end still arrives
        if source is self._host or not self._is_half_open:
            self._is_ended.set()

    async def _come_down(self, way: Direction, limit_bytes: int) -> None:
        """Wait until no more than so much waits on the line."""
        while self.lines[way].waiting_bytes > limit_bytes:
            self._gave[way].clear()
            await self._gave[way].wait()

    async def _send(self, way: Direction) -> None:
        """Bytes out, each when it is due."""
        _, sink = self._ends[way]
        line = self.lines[way]
        loop = asyncio.get_running_loop()
        with contextlib.suppress(OSError):
            while True:
                self._changed[way].clear()
                for piece in line.pop_due(loop.time() + SOON_S):
                    await sink.send(piece)
                self._gave[way].set()
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout_at(line.next_s()):
                        await self._changed[way].wait()
        if not self._is_half_open:
            self._is_ended.set()
