"""Connections of this node: listening ports, and TCPROS wires that read in turns and send from a bounded queue."""

import asyncio
import contextlib
import ipaddress
import socket
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hostlink.components.ros1.local_node import Ros1Counts
from hostlink.components.ros1.tcpros import MAX_HEADER_BYTES, Header, MessageStream, encode_header
from hostlink.core.host import Host, Queue, Spawn
from hostlink.core.runtime.acceptor import Acceptor, bind
from hostlink.core.runtime.listening import close_all
from hostlink.core.transport.connection import BufferedConnection, set_options

BATCH_BYTES = 64 * 1024  # that one write passes to the system
PIECE_BYTES = 512  # of small messages, between two of which others may have their turn
SYSTEM_BYTES = 64 * 1024  # in the kernel, each way: what waits there cannot be replaced
CLOSE_TIMEOUT_S = 1.0
USER_TIMEOUT_MS = 30_000  # a subscriber in a debugger may come back


class Admitted(Protocol):
    """The protocol of a connection."""

    @property
    def is_replaceable(self) -> bool:
        """Whether another one may have its place."""


MakeProtocol = Callable[[], Admitted]


class Port:
    """Listening port: admits a bounded number of connections from allowed networks. Call `bind`, then `accept`."""

    def __init__(self, counts: Ros1Counts, *, allow: Sequence[str], max_connections: int) -> None:
        """`allow`: networks that may connect; all if empty."""
        self._counts = counts
        self._networks = [ipaddress.ip_network(network) for network in allow]
        self._max_connections = max_connections
        self._opening = 0
        self._open: dict[asyncio.Transport, Admitted] = {}  # oldest first
        self._listening: list[socket.socket] = []
        self._acceptor: Acceptor | None = None
        self._is_closed = False

    async def bind(self, host: str, port: int) -> int:
        """Listen; returns the number of the port.

        Raises:
            OSError: the port is not free, or the address is not of this host.
        """
        self._listening = await bind(host, port)
        return int(self._listening[0].getsockname()[1])

    def accept(self, make_protocol: MakeProtocol, spawn: Spawn) -> None:
        """Serve connections from now on."""

        def accepted(connection: socket.socket, address: str, _since_s: float) -> None:
            if not self.admits(address):
                self._counts.refused_connections += 1
                connection.close()
                return
            self._opening += 1
            spawn(self._begin(connection, make_protocol), name=f"ROS 1 connection of {address}")

        self._acceptor = Acceptor(self._listening, accepted, on_exhausted=self._note_refused)

    def close(self) -> None:
        self._is_closed = True
        if self._acceptor is not None:
            self._acceptor.close()
        close_all(self._listening)
        for transport in self._open:
            transport.close()

    def admits(self, address: str) -> bool:
        """Whether a connection of this address may be served. A replaceable one gives its place to it."""
        if self._networks and not any(ipaddress.ip_address(address) in each for each in self._networks):
            return False
        self._open = {each: protocol for each, protocol in self._open.items() if not each.is_closing()}
        if len(self._open) + self._opening < self._max_connections:
            return True
        oldest = next((each for each, protocol in self._open.items() if protocol.is_replaceable), None)
        if oldest is None:
            return False
        self._note_refused()
        oldest.abort()
        del self._open[oldest]
        return True

    async def _begin(self, connection: socket.socket, make_protocol: MakeProtocol) -> None:
        is_open = False
        make: Any = make_protocol
        try:
            with contextlib.suppress(OSError):  # it has reset the connection already
                transport, protocol = await asyncio.get_running_loop().connect_accepted_socket(make, connection)
                is_open = True
                if self._is_closed:  # in the same turn of the loop
                    transport.abort()
                else:
                    self._open[transport] = protocol
        finally:
            self._opening -= 1
            if not is_open:
                connection.close()

    def _note_refused(self) -> None:
        self._counts.refused_connections += 1


Receive = Callable[[list[bytes]], None]


class Wire(BufferedConnection):
    """TCPROS connection. Calls `receive` with the messages of each read, and `on_end` once."""

    def __init__(self, host: Host, receive: Receive, on_end: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self.receive, self.on_end = receive, on_end
        self.stream = MessageStream(MAX_HEADER_BYTES)
        self.outgoing: Queue[bytes] = Queue(len, asyncio.get_running_loop().time, host.share("queues"))
        self.peer = ""  # for people
        self.is_closed = False
        self.is_replaceable = True  # until it has sent a header
        self._host, self._turns = host, host.turns()
        self._is_flush_due = False
        self._reader = self._turns.reader(self, self._read, self.close)
        self.on_readable = self._reader.receive

    def close(self) -> None:
        """Close the connection when sent data has left, after CLOSE_TIMEOUT_S at the latest."""
        if self.is_closed:
            return
        self.is_closed = True
        self.outgoing.clear()
        self._reader.stop()
        if hasattr(self, "transport"):
            self.transport.close()
            asyncio.get_running_loop().call_later(CLOSE_TIMEOUT_S, self.transport.abort)
        self.on_end()

    # -- to the peer --------------------------------------------------------------------------------------------------

    def send_header(self, fields: Header) -> None:
        self.transport.write(encode_header(fields))

    def refuse(self, reason: str) -> None:
        """Answer a header with an error, and end."""
        self.send_header({"error": reason})
        self.close()

    def send(self, data: bytes, *, is_answer: bool = False) -> None:
        """Queue a message or an answer. A slow peer loses its oldest messages; one that reads no answers is cut off."""
        if self.is_closed:
            return
        if is_answer:
            self.outgoing.put_result(data)
        else:
            self.outgoing.put_message("", data)
        if self.outgoing.is_too_slow:
            self.close()
        elif not self._is_flush_due and not self.is_writing_paused:
            self._is_flush_due = True
            asyncio.get_running_loop().call_soon(self._flush)

    def _flush(self) -> None:
        """Write the messages of one turn of the loop at once."""
        self._is_flush_due = False
        while not self.is_writing_paused and not self.is_closed and (batch := self._pop_batch()):
            self.transport.write(batch)

    def _pop_batch(self) -> bytes:
        """Return the oldest messages: BATCH_BYTES, or a little more."""
        batch: list[bytes] = []
        size_bytes = 0
        while size_bytes < BATCH_BYTES and (waiting := self.outgoing.pop()) is not None:
            batch.append(waiting.item)
            size_bytes += waiting.size_bytes
        return b"".join(batch)

    # -- from the peer ------------------------------------------------------------------------------------------------

    @property
    def came_s(self) -> float:
        """Earliest arrival of the messages that are received now."""
        return self._reader.came_s

    def _read(self) -> None:
        """Read one piece; of a large message all available bytes."""
        began_s = asyncio.get_running_loop().time()
        is_done = False
        with self._host.around("ros1", peer=self.peer):
            messages = list(self.stream.feed(self.read(max(PIECE_BYTES, self.stream.missing_bytes))))
            if messages:
                self.receive(messages)
            is_done = True
        if not is_done:  # a fault of hostlink ends this connection alone
            self.close()
        self._turns.end(began_s)

    # -- what asyncio calls -------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self.peer = "{}:{}".format(*(transport.get_extra_info("peername") or ("", ""))[:2])
        self.transport.set_write_buffer_limits(SYSTEM_BYTES)
        set_options(
            transport.get_extra_info("socket"),
            send_bytes=SYSTEM_BYTES,
            receive_bytes=SYSTEM_BYTES,
            user_timeout_ms=USER_TIMEOUT_MS,
        )

    def resume_writing(self) -> None:
        super().resume_writing()
        self._flush()
