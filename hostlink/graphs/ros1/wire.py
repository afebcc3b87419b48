"""Wire: one TCPROS connection. What comes is read in its turns; what leaves waits in a bounded queue."""

import asyncio
from collections import deque
from collections.abc import Callable

from hostlink.graphs.ros1.tcpros import MAX_HEADER_BYTES, Header, MessageStream, encode_header
from hostlink.hub.hub import Hub
from hostlink.transport.connection import Connection, set_options

MAX_MESSAGES = 256
MAX_BYTES = 8 * 1024 * 1024
BATCH_BYTES = 64 * 1024  # that one write passes to the system
PIECE_BYTES = 512  # of small messages, between two of which others may have their turn
SYSTEM_BYTES = 64 * 1024  # in the kernel, each way: what waits there cannot be replaced
CLOSE_TIMEOUT_S = 1.0
USER_TIMEOUT_MS = 30_000  # a subscriber in a debugger may come back

Receive = Callable[[list[bytes]], None]


class Outgoing:
    """What waits for one subscriber, in order; of too much the oldest is dropped and counted. The newest stays."""

    def __init__(self) -> None:
        self.dropped = 0
        self._waiting: deque[bytes] = deque()
        self._bytes = 0

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def put(self, data: bytes) -> None:
        """One more message."""
        self._waiting.append(data)
        self._bytes += len(data)
        while len(self._waiting) > MAX_MESSAGES or (self._bytes > MAX_BYTES and len(self._waiting) > 1):
            self._bytes -= len(self._waiting.popleft())
            self.dropped += 1

    def pop_batch(self) -> bytes:
        """The oldest messages, BATCH_BYTES or a little more of them."""
        batch: list[bytes] = []
        size = 0
        while self._waiting and size < BATCH_BYTES:
            batch.append(self._waiting.popleft())
            size += len(batch[-1])
        self._bytes -= size
        return batch[0] if len(batch) == 1 else b"".join(batch)


class Wire(Connection):
    """The owner of one connection; `receive` is called with the messages of each piece, `on_end` once."""

    def __init__(self, hub: Hub, receive: Receive, on_end: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self.receive, self.on_end = receive, on_end
        self.stream = MessageStream(MAX_HEADER_BYTES)
        self.outgoing = Outgoing()
        self.peer = ""  # for people
        self.is_closed = False
        self.is_replaceable = True  # until it has sent a header
        self._isolation, self._turns = hub.isolation, hub.turns()
        self._is_flush_due = False
        self._reader = self._turns.reader(self, self._read, self.close)
        self.on_readable = self._reader.receive

    def close(self) -> None:
        """End it, after what was sent has left, if that is soon."""
        if self.is_closed:
            return
        self.is_closed = True
        self._reader.stop()
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
        set_options(
            transport.get_extra_info("socket"),
            send_bytes=SYSTEM_BYTES,
            receive_bytes=SYSTEM_BYTES,
            user_timeout_ms=USER_TIMEOUT_MS,
        )

    def resume_writing(self) -> None:
        super().resume_writing()
        self._flush()
