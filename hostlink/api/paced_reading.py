"""PacedReading: what is read of one connection to the API, and when. Requests and their bodies come in turns."""

import asyncio
from collections.abc import Callable

from hostlink.hub.byte_budget import Share
from hostlink.link.fair_share import Turns
from hostlink.transport.base import READ_BYTES

REQUEST_BYTES = 2 * READ_BYTES  # at once, while it speaks HTTP
SOCKET_BYTES = 64 * 1024  # at once, of a WebSocket: what a driver sends in seconds
CONTROL_FRAME_BYTES = 6  # of a client's ping or pong, without its payload
LARGE_BYTES = SOCKET_BYTES  # a message above it needs room in the budget before it is read on

_INTO = memoryview(bytearray(SOCKET_BYTES))  # of all connections: what came is copied out of it before the next reads


class PacedReading(asyncio.BufferedProtocol):
    """The protocol of one connection, around the one that understands it.

    | it speaks   | what is read                                                                                       |
    |-------------|----------------------------------------------------------------------------------------------------|
    | HTTP        | a piece in its turn (FairShare); nothing of a body that nobody reads any more (`refuse_body`)      |
    | a WebSocket | all that is there, whenever something is: a newer command may be behind it. The rest of a large    |
    |             | message waits in the socket until there is room for it                                             |
    """

    def __init__(
        self,
        inner: asyncio.Protocol,
        turns: Turns,
        share: Share,
        came_s: Callable[[float], float],
        *,
        max_message_bytes: int,
        timeout_s: float,
        behind_since_s: float | None = None,
    ) -> None:
        """`share`: of messages that are not whole; `came_s`: since when something may have waited that is read now.

        `behind_since_s`: since when the connection may have waited to be accepted, and its first bytes with it.
        """
        self._inner = inner
        self.came_s = behind_since_s or 0.0  # when what was read last came, at the earliest
        self.request_came_s = 0.0  # the request that is being answered
        self._turns, self._share, self._came = turns, share, came_s
        self._room_bytes = min(max_message_bytes, share.max_bytes)  # one that may be larger than all has all the room
        self._timeout_s = timeout_s
        self._loop = asyncio.get_running_loop()
        self._transport: asyncio.Transport
        self._held = b""  # read, and not passed on: then nothing more is read
        self._is_behind = behind_since_s is not None  # there may be more than what was read last
        self._next_request_came_s: float | None = None
        self._is_web_socket = self._is_refusing = self._is_lost = self._has_room = False
        self._on_read = self._on_writable = _call_nothing  # of the owner of a WebSocket
        self.is_writing_paused = False  # the transport's buffer is full
        self._unread_bytes = 0  # of a message that is not whole
        self._deadline: asyncio.TimerHandle | None = None

    # -- what the API says --------------------------------------------------------------------------------------------

    def begin_request(self) -> None:
        """A request is whole but for its body. One that came before its predecessor was answered is as old as that."""
        if self._next_request_came_s is not None:
            self.request_came_s = self._next_request_came_s

    def end_request(self) -> None:
        """It is answered."""
        self._next_request_came_s = None

    def refuse_body(self) -> None:
        """Read nothing more: the answer is known, and the connection is closed when its sender had time to read it."""
        self._is_refusing = True

    def become_web_socket(self, *, on_read: Callable[[], None], on_writable: Callable[[], None]) -> None:
        """Read messages from now on. `on_read` is called after each read, `on_writable` when writing may go on."""
        self._is_web_socket = True
        self._on_read, self._on_writable = on_read, on_writable

    def leave_web_socket(self) -> None:
        """Call the WebSocket's owner no more."""
        self._on_read = self._on_writable = _call_nothing

    def receive_message(self) -> None:
        """A whole message has come, and was worked on if it was large."""
        self._unread_bytes = 0
        if self._has_room:
            self._give_room()

    def receive_control(self, payload_bytes: int) -> None:
        """A ping or a pong has come, which belongs to no message: a client may send nothing else for days."""
        self._unread_bytes = max(0, self._unread_bytes - payload_bytes - CONTROL_FRAME_BYTES)

    # -- what asyncio calls -------------------------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport  # type: ignore[assignment]  # uvloop's is no subclass of asyncio's
        self._inner.connection_made(transport)

    def get_buffer(self, sizehint: int) -> memoryview:  # noqa: ARG002 - asyncio's signature
        return _INTO[: SOCKET_BYTES if self._is_web_socket else REQUEST_BYTES]

    def buffer_updated(self, nbytes: int) -> None:
        data = bytes(_INTO[:nbytes])
        self._note(nbytes)
        if self._held or self._is_refusing:
            self._hold(data)
        elif self._is_web_socket:
            self._receive(data)
        elif nbytes < READ_BYTES and self._turns.is_free(is_flooding=False):
            self._pass_on(data)
        else:
            self._hold(data)
            self._turns.call(self._release, is_flooding=nbytes >= READ_BYTES)

    def connection_lost(self, exc: Exception | None) -> None:
        self._is_lost, self._held = True, b""
        self._give_room()
        self._inner.connection_lost(exc)

    def eof_received(self) -> bool | None:
        return self._inner.eof_received()

    def pause_writing(self) -> None:
        self.is_writing_paused = True
        self._inner.pause_writing()

    def resume_writing(self) -> None:
        self.is_writing_paused = False
        self._inner.resume_writing()
        self._on_writable()

    # -- its parts ----------------------------------------------------------------------------------------------------

    def _note(self, nbytes: int) -> None:
        """When it came: after the turn of the loop before this one, unless there was more than that turn has read."""
        if not self._is_behind:
            self.came_s = self._came(self._loop.time())
        self._is_behind = nbytes == (SOCKET_BYTES if self._is_web_socket else REQUEST_BYTES)
        if self._next_request_came_s is None:
            self._next_request_came_s = self.came_s

    def _hold(self, data: bytes) -> None:
        self._held = b"" if self._is_refusing else self._held + data
        self._is_behind = True
        self._transport.pause_reading()

    def _release(self) -> None:
        """It may be passed on. Reading goes on before: what it is passed to may stop it again."""
        data, self._held = self._held, b""
        if self._is_lost or self._is_refusing:
            return
        if not self._transport.is_closing():
            self._transport.resume_reading()
        self._pass_on(data)

    def _pass_on(self, data: bytes) -> None:
        began_s = self._loop.time()
        self._inner.data_received(data)
        self._turns.end(began_s)

    def _receive(self, data: bytes) -> None:
        """Pass on a part of a WebSocket's messages, if it is not of a large one for which there is no room."""
        self._unread_bytes += len(data)
        if self._unread_bytes > LARGE_BYTES and not self._has_room:
            if not self._share.take(self._room_bytes):
                self._hold(data)
                self._share.wait(self._try_again)
                return
            self._has_room = True
            self._deadline = self._loop.call_later(self._timeout_s, self._transport.abort)
        self._inner.data_received(data)
        self._on_read()
        if not self._is_lost and not self._transport.is_reading():
            self._is_behind = True

    def _try_again(self) -> None:
        if self._is_lost:
            return
        data, self._held = self._held, b""
        self._unread_bytes -= len(data)
        if not self._transport.is_closing():
            self._transport.resume_reading()
        self._receive(data)

    def _give_room(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None
        if self._has_room:
            self._has_room = False
            self._share.give(self._room_bytes)


def _call_nothing() -> None:
    """Replace the callbacks of a connection that is not a WebSocket."""
