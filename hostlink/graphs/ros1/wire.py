"""Wire: one TCPROS connection. What comes is read in its turns; what leaves waits in a bounded queue."""

import asyncio
import socket
from collections.abc import Callable

from hostlink.graphs.ros1.outgoing import Outgoing
from hostlink.graphs.ros1.tcpros import MAX_HEADER_BYTES, Header, MessageStream, encode_header
from hostlink.hub.hub import Hub
from hostlink.transport.base import READ_BYTES
from hostlink.transport.connection import Connection

PIECE_BYTES = 512  # of small messages, between two of which others may have their turn
SYSTEM_BYTES = 64 * 1024  # in the kernel, each way: what waits there cannot be replaced
CLOSE_TIMEOUT_S = 1.0
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}  # seconds, seconds, probes: found within 11 s
USER_TIMEOUT_MS = 30_000  # a subscriber in a debugger may come back

Receive = Callable[[list[bytes]], None]


class Wire(Connection):
    """The owner of one connection; `receive` is called with the messages of each piece, `on_end` once."""

    def __init__(self, hub: Hub, receive: Receive, on_end: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self.receive, self.on_end = receive, on_end
        self.stream = MessageStream(MAX_HEADER_BYTES)
        self.outgoing = Outgoing()
        self.peer = ""  # for people
        self.is_closed = False
        self._isolation, self._turns = hub.isolation, hub.turns()
        self._is_read_due = self._is_flush_due = self._is_flooding = False
        self.on_readable = self._readable

    def close(self) -> None:
        """End it, after what was sent has left, if that is soon."""
        if self.is_closed:
            return
        self.is_closed = True
        if hasattr(self, "transport"):
            self.transport.close()
            asyncio.get_running_loop().call_later(CLOSE_TIMEOUT_S, self.transport.abort)
        self.on_end()

    # -- to the peer --------------------------------------------------------------------------------------------------

    def send_header(self, fields: Header) -> None:
        """The first that leaves."""
        self.transport.write(encode_header(fields))

    def refuse(self, reason: str) -> None:
        """Answer a header with an error, and end."""
        self.send_header({"error": reason})
        self.close()

    def send(self, data: bytes) -> None:
        """Queue a message."""
        self.outgoing.put(data)
        if not self._is_flush_due and not self.is_writing_paused:
            self._is_flush_due = True
            asyncio.get_running_loop().call_soon(self._flush)

    def _flush(self) -> None:
        """What came in one turn of the loop leaves in one write."""
        self._is_flush_due = False
        while self.outgoing and not self.is_writing_paused and not self.is_closed:
            self.transport.write(self.outgoing.pop_batch())

    # -- from the peer ------------------------------------------------------------------------------------------------

    def _readable(self) -> None:
        """Read at once while it is this connection's turn, else later."""
        if self._is_read_due or self.is_closed:
            return
        while self.unread_bytes and not self.is_closed:
            self._is_flooding = self._is_flooding or self.unread_bytes >= READ_BYTES
            if not self._turns.is_free(is_flooding=self._is_flooding):
                self._is_read_due = True
                self._turns.call(self._read_due, is_flooding=self._is_flooding)
                return
            self._read()
        self._is_flooding = False
        if self.is_ended:
            self.close()

    def _read_due(self) -> None:
        self._is_read_due = False
        if self.unread_bytes and not self.is_closed:
            self._read()
        self._readable()

    def _read(self) -> None:
        """One piece; of a large message all that is there."""
        began_s = asyncio.get_running_loop().time()
        is_done = False
        with self._isolation.around("ros1", peer=self.peer):
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
        _set_options(transport.get_extra_info("socket"))

    def resume_writing(self) -> None:
        super().resume_writing()
        self._flush()


def _set_options(connection: socket.socket) -> None:
    """Messages leave at once, dead peers are found, little waits in the kernel."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SYSTEM_BYTES)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SYSTEM_BYTES)
    for name, value in {**KEEPALIVE, "TCP_USER_TIMEOUT": USER_TIMEOUT_MS}.items():
        option = getattr(socket, name, None)  # not every system has each of them
        if option is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
